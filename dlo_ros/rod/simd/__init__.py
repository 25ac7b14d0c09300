# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Vector types of compiled code: three, four or eight numbers in a processor register (SIMD).

These are the types and their arithmetic alone. The SIMD kernels that simulate eight parameter sets
at once are in `dlo_ros.rod.lanes`; `dlo_ros.rod.elements` uses four lanes for one rod in space.
"""
