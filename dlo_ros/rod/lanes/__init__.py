# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod's equations in the lanes of a vector: eight rods at once, or eight knot spans of one.

The vector type is `dlo_ros.rod.simd.eight_lanes`; `simd_kernels` has strains and assembly in the
plane, `spatial_kernels` in space, `simd_solver` the banded solution. Where all lanes hold one rod,
`span_lanes` has eight of its knot spans assembled at once, and `common_matrix` their matrix.
"""
