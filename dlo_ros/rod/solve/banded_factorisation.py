# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled factorisation of a symmetric banded matrix, with its inertia.

Storage: lower rows, band[i, w - i + j] = A[i, j] for j <= i, with w the half bandwidth, and zeros
where j would be negative. Unknowns are eliminated from the last to the first, so that each takes
its own contiguous row off the rows before it: A = L^T D L.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.simd.row_operations import add_rows, set_rows
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE

SPACE, PLANE = 16, 8  # widths of the band, w + 1, of a rod
SEVERAL = 8  # right-hand sides that are solved for side by side


@njit(constants=True, **INLINE)
def _factorise(band, diagonal, width):
    last = width - 1
    row = np.zeros(2 * width)  # zeros, then the row of an unknown
    negative = 0
    for i in range(band.shape[0] - 1, -1, -1):
        d = band[i, last]
        if not np.isfinite(d) or d == 0.0:
            return -1
        if d < 0.0:
            negative += 1
        diagonal[i] = d
        share = 1.0 / d
        set_rows(row, width, (1.0,), band, i * width, width)
        set_rows(band, i * width, (share,), row, width, width)
        for back in range(1, min(last, i) + 1):
            x = row[width + last - back]
            if x != 0.0:  # where no unknowns meet, or one is imposed
                add_rows(band, (i - back) * width, (-share * x,), row, width - back, width)
    return negative


@linked(**FLAGS)
def factorise(band, diagonal):
    """Factorise in place, A = L^T D L.

    Args:
        band: shape (N, 16) or (N, 8), overwritten with L.
        diagonal: output, D, shape (N,).

    Returns:
        Number of negative pivots, which is the number of negative eigenvalues (Sylvester); -1
        where a pivot vanishes or is not finite.
    """
    if band.shape[1] == SPACE:
        return _factorise(band, diagonal, SPACE)
    if band.shape[1] == PLANE:
        return _factorise(band, diagonal, PLANE)
    raise ValueError("a rod's matrix has rows of 16 or 8 numbers")


@njit(constants=True, **INLINE)
def _solve(band, diagonal, x, width):
    size, last = band.shape[0], width - 1
    full = min(last, size)  # rows before this one are shorter than the band
    for i in range(size - 1, full - 1, -1):
        y = x[i]
        add_rows(x, i - last, (-y,), band, i * width, width)
        x[i] = y  # the row's last number is 1
    for i in range(full - 1, -1, -1):
        for j in range(i):
            x[j] -= band[i, last - i + j] * x[i]
    for i in range(full):
        s = x[i] / diagonal[i]
        for j in range(i):
            s -= band[i, last - i + j] * x[j]
        x[i] = s
    for i in range(full, size):
        # In four sums, which wait less for each other than one.
        a, b = band[i, last - 3] * x[i - 3], band[i, last - 2] * x[i - 2]
        c, d = band[i, last - 1] * x[i - 1], 0.0
        for m in range(0, last - 3, 4):
            a += band[i, m] * x[i - last + m]
            b += band[i, m + 1] * x[i - last + m + 1]
            c += band[i, m + 2] * x[i - last + m + 2]
            d += band[i, m + 3] * x[i - last + m + 3]
        x[i] = x[i] / diagonal[i] - ((a + b) + (c + d))


@linked(**FLAGS)
def solve(band, diagonal, x):
    """Solve L^T D L x = b in place for the right-hand side x of shape (N,)."""
    if band.shape[1] == SPACE:
        _solve(band, diagonal, x, SPACE)
    else:
        _solve(band, diagonal, x, PLANE)


@linked(**FLAGS)
def solve_several(band, diagonal, x):
    """Solve L^T D L x = b in place for right-hand sides x of shape (P, N), `SEVERAL` at a time.

    They stand side by side, so that each number of L multiplies a row of numbers.
    """
    size, last = band.shape[0], band.shape[1] - 1
    rows = np.empty((size, SEVERAL))
    for first in range(0, x.shape[0], SEVERAL):
        count = min(SEVERAL, x.shape[0] - first)
        for i in range(size):
            for a in range(SEVERAL):
                rows[i, a] = x[first + a, i] if a < count else 0.0
        for i in range(size - 1, -1, -1):
            for j in range(max(0, i - last), i):
                add_rows(rows, SEVERAL * j, (-band[i, last - i + j],), rows, SEVERAL * i, SEVERAL)
        for i in range(size):
            set_rows(rows, SEVERAL * i, (1.0 / diagonal[i],), rows, SEVERAL * i, SEVERAL)
            for j in range(max(0, i - last), i):
                add_rows(rows, SEVERAL * i, (-band[i, last - i + j],), rows, SEVERAL * j, SEVERAL)
        for a in range(count):
            for i in range(size):
                x[first + a, i] = rows[i, a]
