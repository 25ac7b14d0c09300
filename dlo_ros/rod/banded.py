"""Compiled LDL^T factorisation of a symmetric banded matrix, with its inertia.

Storage: lower rows, band[i, w - i + j] = A[i, j] for j <= i, with w the half bandwidth.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def factorise(band, diagonal):
    """Factorise in place, A = L D L^T.

    Args:
        band: shape (N, w + 1), overwritten with L (unit diagonal not stored).
        diagonal: output, D, shape (N,).

    Returns:
        Number of negative pivots, which is the number of negative eigenvalues (Sylvester); -1
        where a pivot vanishes or is not finite.
    """
    size, w = band.shape[0], band.shape[1] - 1
    negative = 0
    scaled = np.empty(w + 1)
    for i in range(size):
        first = max(0, i - w)
        d = band[i, w]
        for j in range(first, i):
            x = band[i, w - i + j]
            start = max(first, j - w)
            for k in range(start, j):
                x -= scaled[k - first] * band[j, w - j + k]
            scaled[j - first] = x  # L[i, j] * D[j]
            x_l = x / diagonal[j]
            band[i, w - i + j] = x_l
            d -= x * x_l
        if not np.isfinite(d) or d == 0.0:
            return -1
        if d < 0.0:
            negative += 1
        diagonal[i] = d
    return negative


@njit(cache=True, nogil=True)
def solve(band, diagonal, x):
    """Solve L D L^T x = b in place for the right-hand side x of shape (N,)."""
    size, w = band.shape[0], band.shape[1] - 1
    for i in range(size):
        s = x[i]
        for j in range(max(0, i - w), i):
            s -= band[i, w - i + j] * x[j]
        x[i] = s
    for i in range(size):
        x[i] /= diagonal[i]
    for i in range(size - 1, -1, -1):
        s = x[i]
        for j in range(max(0, i - w), i):
            x[j] -= band[i, w - i + j] * s


@njit(cache=True, nogil=True)
def multiply(band, x, out):
    """Write A x to out (N,), for a symmetric banded matrix that is not factorised."""
    size, w = band.shape[0], band.shape[1] - 1
    out[:] = 0.0
    for i in range(size):
        for j in range(max(0, i - w), i):
            a = band[i, w - i + j]
            out[i] += a * x[j]
            out[j] += a * x[i]
        out[i] += band[i, w] * x[i]
