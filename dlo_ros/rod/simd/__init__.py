# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Vectors in processor registers (SIMD) for compiled code: of three, four, eight numbers."""
