# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Boundary conditions: imposed motion over time, and the degrees of freedom that it holds."""
