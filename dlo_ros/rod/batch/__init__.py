# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Batches of parameter sets, simulated eight at once in the lanes of a vector (SIMD)."""
