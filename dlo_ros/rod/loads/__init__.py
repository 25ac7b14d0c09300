# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Loads of a simulated rod: stress resultants, external forces, grip reactions and their limits."""
