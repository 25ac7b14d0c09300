# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled algebra of vectors in space, as tuples: they live in registers, arrays would not."""

from __future__ import annotations

from typing import Any

import numpy as np

from dlo_ros.kernel_cache import njit

# The flags of all compiled functions of the rod. Sums may be fused with products, but keep their
# order, and infinities and NaN keep their meaning; a division by zero gives them.
FLAGS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}
# A turn, whose multiples are exact, and the rest of 2 pi; and what rounds when it is added.
TURN = float(np.float32(2.0 * np.pi))
TURN_REST = 2.0 * np.pi - TURN
ROUNDED = 1.5 * 2.0**52
# For what is cheaper than its call; only compiled code calls it.
INLINE: dict[str, Any] = {**FLAGS, "forceinline": True, "from_python": False}


@njit(**INLINE)
def dot(a, b):
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INLINE)
def cross(a, b):
    """The vector product."""
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
def unit(a):
    """The vector of length 1 along a."""
    return times(1.0 / np.sqrt(dot(a, a)), a)


@njit(**INLINE)
def _series(z, a, b, c, d, e, f, g):
    """The alternating series a - b z + c z^2 - ... by Horner's rule."""
    return a - z * (b - z * (c - z * (d - z * (e - z * (f - z * g)))))


@njit(**INLINE)
def cos_sin(x):
    """Cosine and sine of an angle, a number or a vector of such, to a few units of rounding.

    Taylor series of a quarter of the angle within half a turn, whose double angle is taken twice.
    """
    turns = (x * (0.5 / np.pi) + ROUNDED) - ROUNDED
    y = 0.25 * ((x - turns * TURN) - turns * TURN_REST)
    z = y * y
    cos = 1.0 - z * (0.5 - z * _series(
        z, 1.0 / 24.0, 1.0 / 720.0, 1.0 / 40320.0, 1.0 / 3628800.0, 1.0 / 479001600.0,
        1.0 / 87178291200.0, 1.0 / 20922789888000.0,
    ))  # fmt: skip
    sin = y - y * z * _series(
        z, 1.0 / 6.0, 1.0 / 120.0, 1.0 / 5040.0, 1.0 / 362880.0, 1.0 / 39916800.0,
        1.0 / 6227020800.0, 1.0 / 1307674368000.0,
    )  # fmt: skip
    cos, sin = 1.0 - 2.0 * (sin * sin), 2.0 * (sin * cos)
    return 1.0 - 2.0 * (sin * sin), 2.0 * (sin * cos)


@njit(**INLINE)
def _plus(x, a, y):
    return x[0] + a * y[0], x[1] + a * y[1], x[2] + a * y[2]


@njit(**INLINE)
def add_outer(m, a, b):
    """The matrix m + a b^T; matrices are tuples of three rows."""
    return _plus(m[0], a[0], b), _plus(m[1], a[1], b), _plus(m[2], a[2], b)


@njit(**INLINE)
def add_both(m, a, b):
    """The matrix m + a b^T + b a^T."""
    return add_outer(add_outer(m, a, b), b, a)


@njit(**INLINE)
def outer(a, b):
    """The matrix a b^T."""
    return times(a[0], b), times(a[1], b), times(a[2], b)


@njit(**INLINE)
def add_diagonal(m, x):
    """The matrix m + x I."""
    a, b, c = m
    return (a[0] + x, a[1], a[2]), (b[0], b[1] + x, b[2]), (c[0], c[1], c[2] + x)


@njit(**INLINE)
def add_cross(m, a):
    """The matrix m + A, where x . A y is the triple product x . (y x a)."""
    x, y, z = m
    return (
        (x[0], x[1] + a[2], x[2] - a[1]),
        (y[0] - a[2], y[1], y[2] + a[0]),
        (z[0] + a[1], z[1] - a[0], z[2]),
    )
