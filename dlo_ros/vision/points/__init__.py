# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Observed splines from points in space that another tracker gives."""
