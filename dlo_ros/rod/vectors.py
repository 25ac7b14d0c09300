"""Compiled algebra of vectors in space, as tuples: they live in registers, arrays would not."""

from __future__ import annotations

import numpy as np
from numba import njit

# The flags of all compiled functions of the rod. Sums may be fused with products, but keep their
# order, and infinities and NaN keep their meaning; a division by zero gives them.
FLAGS = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}
INLINE = {**FLAGS, "forceinline": True}  # for what is cheaper than its call


@njit(**INLINE)
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INLINE)
def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@njit(**INLINE)
def times(x, a):
    """The multiple x a."""
    return x * a[0], x * a[1], x * a[2]


@njit(**INLINE)
def mix(x, a, y, b):
    """The combination x a + y b."""
    return x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]


@njit(**INLINE)
def mix3(x, a, y, b, z, c):
    """The combination x a + y b + z c."""
    return (
        x * a[0] + y * b[0] + z * c[0],
        x * a[1] + y * b[1] + z * c[1],
        x * a[2] + y * b[2] + z * c[2],
    )


@njit(**INLINE)
def row(array, i):
    """Row i of an array (m, 3)."""
    return array[i, 0], array[i, 1], array[i, 2]


@njit(**INLINE)
def put(array, i, a):
    """Write a vector to row i of an array (m, 3)."""
    array[i, 0], array[i, 1], array[i, 2] = a


@njit(**INLINE)
def unit(a):
    return times(1.0 / np.sqrt(dot(a, a)), a)


@njit(**INLINE)
def add(a, b):
    """The sum of two matrices, tuples of three rows."""
    return mix(1.0, a[0], 1.0, b[0]), mix(1.0, a[1], 1.0, b[1]), mix(1.0, a[2], 1.0, b[2])


@njit(**INLINE)
def outer(a, b):
    """The matrix a b^T."""
    return times(a[0], b), times(a[1], b), times(a[2], b)


@njit(**INLINE)
def both(a, b):
    """The symmetric matrix a b^T + b a^T."""
    return mix(a[0], b, b[0], a), mix(a[1], b, b[1], a), mix(a[2], b, b[2], a)


@njit(**INLINE)
def diagonal(x):
    """The matrix x I."""
    return (x, 0.0, 0.0), (0.0, x, 0.0), (0.0, 0.0, x)


@njit(**INLINE)
def crossing(a):
    """The matrix of x . (y x a) in rows x and columns y."""
    return (0.0, a[2], -a[1]), (-a[2], 0.0, a[0]), (a[1], -a[0], 0.0)
