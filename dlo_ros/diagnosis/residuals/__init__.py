# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Residuals of a fitted model: patterns, dependence on inputs, the missing force."""
