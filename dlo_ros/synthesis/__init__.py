# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulated experiments of known truth, made by another rod model than the package's own."""
