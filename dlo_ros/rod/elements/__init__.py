# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The elements of the rod: strains, constitutive law, stiffness, contact and friction."""
