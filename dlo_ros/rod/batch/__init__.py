# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""SIMD kernels: batches of parameter sets, simulated eight at once in the lanes of a vector.

The vector type is `dlo_ros.rod.simd.eight_lanes`; `simd_kernels` has strains and assembly in the
plane, `spatial_kernels` in space, `simd_solver` the banded solution, `simd_step` and
`simd_integration` a step and a motion, for both, `simd_sensitivity` a step's derivatives by eight
parameters at once, with `planar_sensitivity` and `spatial_sensitivity`. Where all lanes hold one
rod, `span_lanes` has eight of its knot spans assembled at once.
"""
