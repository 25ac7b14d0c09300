# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""SIMD kernels: batches of parameter sets, simulated eight at once in the lanes of a vector.

The equations are those of `dlo_ros.rod.lanes`. `simd_step` and `simd_integration` have a step and a
motion, in the plane and in space, `simd_sensitivity` a step's derivatives by eight parameters at
once, with `planar_sensitivity` and `spatial_sensitivity`.
"""
