# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Linear equations of eight parameter sets: residual, factorisation, solution.

For the layout of matrices see `simd_kernels`.
"""

from __future__ import annotations

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch.simd_kernels import COLUMN
from dlo_ros.rod.simd.eight_lanes import largest, load, smaller, spread, store


@linked()
def residual(q, matrix, rhs, scratch, n, lo, hi):
    """Write rhs - matrix q - gradient of the free degrees of freedom to scratch.step."""
    zero = spread(0.0)
    for i in range(lo, hi):
        x = load(rhs, 2 * i) - load(scratch.gradient, 2 * i)
        z = load(rhs, 2 * i + 1) - load(scratch.gradient, 2 * i + 1)
        for j in range(max(0, i - 3), min(n, i + 4)):
            a = load(matrix, 4 * i + 3 - i + j if j <= i else 4 * j + 3 - j + i)
            x -= a * load(q, 2 * j)
            z -= a * load(q, 2 * j + 1)
        store(scratch.step, 2 * i, x)
        store(scratch.step, 2 * i + 1, z)
    for i in range(2 * hi, 2 * hi + 7):
        store(scratch.step, i, zero)


@linked()
def solve(scratch, lo, hi):
    """Factorise the free part of the matrix and replace the right-hand side by the solution.

    Returns:
        The smallest pivot of all sets.
    """
    band, step = scratch.band, scratch.step
    lowest = load(band, COLUMN * 2 * lo)
    zero = spread(0.0)
    for i in range(COLUMN * 2 * hi, COLUMN * (2 * hi + 7)):
        store(band, i, zero)
    for k in range(2 * lo, 2 * hi):
        at = COLUMN * k
        pivot = load(band, at)
        lowest = smaller(pivot, lowest)
        inverse = 1.0 / pivot
        y = load(step, k)
        for a in range(1, 8):
            factor = load(band, at + a) * inverse
            to = at + COLUMN * a - a
            for b in range(a, 8):
                store(band, to + b, load(band, to + b) - factor * load(band, at + b))
            store(step, k + a, load(step, k + a) - factor * y)
        store(band, at, inverse)
    for k in range(2 * hi - 1, 2 * lo - 1, -1):
        x = load(step, k)
        at = COLUMN * k
        for a in range(7, 0, -1):
            x -= load(band, at + a) * load(step, k + a)
        store(step, k, x * load(band, at))
    return 0.0 - largest(0.0 - lowest)
