# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Linear equations of eight parameter sets: residual, factorisation, solution.

For the layout of matrices see `simd_kernels` and, in space, `spatial_kernels`; for that of a rod
which all lanes hold, `common_matrix`.
"""

from __future__ import annotations

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.lanes import common_matrix
from dlo_ros.rod.lanes.simd_kernels import COLUMN
from dlo_ros.rod.lanes.spatial_kernels import BLOCKS
from dlo_ros.rod.simd.eight_lanes import (
    entry,
    largest,
    load,
    smaller,
    spread,
    store,
)  # fmt: skip
from dlo_ros.rod.simd.vector_algebra import INLINE


@linked()
def residual(q, matrix, rhs, scratch, tables):
    """Write rhs - matrix q - gradient of the free degrees of freedom to scratch.step."""
    n, lo, hi = tables.n, tables.lo, tables.hi
    for i in range(tables.dof * hi, tables.dof * (hi + 4) - 1):
        store(scratch.step, i, spread(0.0))
    if tables.dof == 4:
        _residual_in_space(q, matrix, rhs, scratch, tables)
        return
    for i in range(lo, hi):
        x = load(rhs, 2 * i) - load(scratch.gradient, 2 * i)
        z = load(rhs, 2 * i + 1) - load(scratch.gradient, 2 * i + 1)
        for j in range(max(0, i - 3), min(n, i + 4)):
            a = load(matrix, 4 * i + 3 - i + j if j <= i else 4 * j + 3 - j + i)
            x -= a * load(q, 2 * j)
            z -= a * load(q, 2 * j + 1)
        store(scratch.step, 2 * i, x)
        store(scratch.step, 2 * i + 1, z)


@njit(**INLINE)
def _residual_in_space(q, matrix, rhs, scratch, tables):
    """`residual` with four degrees of freedom to a control point; zero where one is imposed."""
    n, step = tables.n, scratch.step
    for i in range(tables.lo, tables.hi):
        at = 4 * i
        x, y = load(rhs, at) - load(scratch.gradient, at), load(rhs, at + 1)
        y -= load(scratch.gradient, at + 1)
        z, t = load(rhs, at + 2) - load(scratch.gradient, at + 2), load(rhs, at + 3)
        t -= load(scratch.gradient, at + 3)
        for j in range(max(0, i - 3), min(n, i + 4)):
            k = 4 * i + 3 - i + j if j <= i else 4 * j + 3 - j + i
            a = load(matrix, k)
            x -= a * load(q, 4 * j)
            y -= a * load(q, 4 * j + 1)
            z -= a * load(q, 4 * j + 2)
            t -= load(matrix, 4 * n + k) * load(q, 4 * j + 3)
        store(step, at, x)
        store(step, at + 1, y)
        store(step, at + 2, z)
        store(step, at + 3, t)
        for k in range(at, at + 4):
            if entry(tables.fixed, k) > 0.0:
                store(step, k, spread(0.0))


@linked()
def solve(scratch, tables):
    """Factorise the free part of the matrix and replace the right-hand side by the solution.

    Returns:
        The smallest pivot of all sets.
    """
    lo, hi = tables.lo, tables.hi
    if tables.together.groups > 0:
        pivot = common_matrix.factorise(tables, scratch.band, scratch.line)
        common_matrix.substitute(tables, scratch.band, scratch.step)
        return pivot
    if tables.dof == 4:
        return _solve_blocks(scratch.band, scratch.step, lo, hi)
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
    _substitute_back(band, step, lo, hi)
    return 0.0 - largest(0.0 - lowest)


@njit(**INLINE)
def _substitute_back(band, step, lo, hi):
    """The second half of `solve` in the plane."""
    for k in range(2 * hi - 1, 2 * lo - 1, -1):
        x = load(step, k)
        at = COLUMN * k
        for a in range(7, 0, -1):
            x -= load(band, at + a) * load(step, k + a)
        store(step, k, x * load(band, at))


@njit(**INLINE)
def _solve_blocks(band, step, lo, hi):
    """`solve` in space: control point by control point, whose four columns go together.

    Four columns are taken off what is behind them at once: each entry there is loaded and stored
    once instead of four times.
    """
    lowest = load(band, BLOCKS * lo)
    for k in range(lo, hi):
        last, at = min(3, hi - 1 - k), BLOCKS * k
        for c in range(4):
            pivot = load(band, at + 5 * c)
            lowest = smaller(pivot, lowest)
            inverse = 1.0 / pivot
            store(band, at + 5 * c, inverse)
            y = load(step, 4 * k + c)
            for d in range(c + 1, 4):
                factor = load(band, at + 4 * d + c) * inverse
                store(step, 4 * k + d, load(step, 4 * k + d) - factor * y)
                for r in range(d, 4 * (last + 1)):
                    row = at + 4 * r
                    store(band, row + d, load(band, row + d) - factor * load(band, row + c))
        y1, y2, y3, y4 = (load(step, 4 * k), load(step, 4 * k + 1), load(step, 4 * k + 2),
                          load(step, 4 * k + 3))  # fmt: skip
        for column in range(4, 4 * (last + 1)):
            row = at + 4 * column
            f1, f2 = load(band, row) * load(band, at), load(band, row + 1) * load(band, at + 5)
            f3 = load(band, row + 2) * load(band, at + 10)
            f4 = load(band, row + 3) * load(band, at + 15)
            y = load(step, 4 * k + column)
            store(step, 4 * k + column, y - f1 * y1 - f2 * y2 - f3 * y3 - f4 * y4)
            # Row r of this block is row r - 4 o of block r // 4 - o of the control point behind.
            o, d = column // 4, column % 4
            to = BLOCKS * (k + o) - 16 * o + d
            for r in range(column, 4 * (last + 1)):
                row = at + 4 * r
                x = load(band, to + 4 * r)
                x -= f1 * load(band, row) + f2 * load(band, row + 1)
                x -= f3 * load(band, row + 2) + f4 * load(band, row + 3)
                store(band, to + 4 * r, x)
    _substitute_back_blocks(band, step, lo, hi)
    return 0.0 - largest(0.0 - lowest)


@njit(**INLINE)
def _substitute_back_blocks(band, step, lo, hi):
    """The second half of `solve` in space."""
    for k in range(hi - 1, lo - 1, -1):
        last, at = min(3, hi - 1 - k), BLOCKS * k
        x1, x2, x3, x4 = (load(step, 4 * k), load(step, 4 * k + 1), load(step, 4 * k + 2),
                          load(step, 4 * k + 3))  # fmt: skip
        x1 *= load(band, at)
        x2 *= load(band, at + 5)
        x3 *= load(band, at + 10)
        x4 *= load(band, at + 15)
        a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
        for r in range(4, 4 * (last + 1)):
            row, y = at + 4 * r, load(step, 4 * k + r)
            a += load(band, row) * y
            b += load(band, row + 1) * y
            c += load(band, row + 2) * y
            d += load(band, row + 3) * y
        x4 -= d * load(band, at + 15)
        x3 -= (c + load(band, at + 14) * x4) * load(band, at + 10)
        x2 -= (b + load(band, at + 9) * x3 + load(band, at + 13) * x4) * load(band, at + 5)
        x1 -= (a + load(band, at + 4) * x2 + load(band, at + 8) * x3
               + load(band, at + 12) * x4) * load(band, at)  # fmt: skip
        store(step, 4 * k, x1)
        store(step, 4 * k + 1, x2)
        store(step, 4 * k + 2, x3)
        store(step, 4 * k + 3, x4)
