# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Identification from whole recordings: the fit, its posterior, and measured forces."""
