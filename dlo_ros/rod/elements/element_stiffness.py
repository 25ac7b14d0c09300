# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled element stiffness: the stiffness matrix of one knot span, in space and in the plane.

A span has four control points with `dof` coordinates each. Its stiffness is first gathered in a
dense block that stands coordinate by coordinate: the 16 numbers of a pair of coordinates (c, d),
d <= c, couple c of control point i to d of control point j at 4 i + j. So a second derivative at a
quadrature point, by whatever coordinates, multiplies the same 16 products of basis functions, which
is one vector operation.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.rod.elements.strains import MIDDLE, OUTER
from dlo_ros.rod.simd.four_lanes import lane, lanes, quad
from dlo_ros.rod.simd.row_operations import add_outer, add_rows, set_outer, set_rows
from dlo_ros.rod.simd.vector_algebra import INLINE

BLOCK = 16  # numbers of a pair of coordinates
FIRST = 16  # numbers of a span's first derivatives: c of control point i at 4 c + i
# Rows of 16 products of basis functions of i and j, at three points by (1, 1), (1, 2), (2, 1),
# (2, 2) derivatives; at three points by (0, 1), (0, 2); at three points by (0, 0).
SLOPES, TURNS, TURN_SQUARES = 0, 192, 288
PRODUCTS = 336
TILT = np.sqrt(2.0 * OUTER) * 0.5


@njit(**INLINE)
def slope_products(rule, e, out):
    """Products of derivatives of the basis functions at the points of a span."""
    b1, b2 = rule.b1, rule.b2
    for k in range(3):
        i, at = 4 * (e + k), SLOPES + 64 * k
        set_outer(out, at, b1, i, b1, i)
        set_outer(out, at + 16, b1, i, b2, i)
        set_outer(out, at + 32, b2, i, b1, i)
        set_outer(out, at + 48, b2, i, b2, i)


@njit(**INLINE)
def turn_products(rule, e, out):
    """Products of the basis functions at the points of a span, also with their derivatives."""
    b, b1, b2 = rule.b, rule.b1, rule.b2
    for k in range(3):
        i = 4 * (e + k)
        set_outer(out, TURNS + 32 * k, b, i, b1, i)
        set_outer(out, TURNS + 32 * k + 16, b, i, b2, i)
        set_outer(out, TURN_SQUARES + 16 * k, b, i, b, i)


@njit(**INLINE)
def couple(block, pair, pp, ps, sp, ss, products):
    """Write second derivatives by a pair of positions: of p and p, p and s, s and p, s and s."""
    set_rows(
        block, pair,
        (lane(pp, 0), lane(ps, 0), lane(sp, 0), lane(ss, 0),
         lane(pp, 1), lane(ps, 1), lane(sp, 1), lane(ss, 1),
         lane(pp, 2), lane(ps, 2), lane(sp, 2), lane(ss, 2)),
        products, SLOPES, 16,
    )  # fmt: skip


@njit(**INLINE)
def derive(out, at, slow, b, fast, b1, e):
    """Write first derivatives by one coordinate, given those by two of its derivatives.

    Args:
        out, at: output, and where the derivatives by the four control points begin.
        slow, b: derivatives at the points, and the table of basis functions that belongs to it.
        fast, b1: the same for the next derivative.
        e: first point of the span.
    """
    set_rows(out, at, lanes(slow), b, 4 * e, 4)
    add_rows(out, at, lanes(fast), b1, 4 * e, 4)


@njit(**INLINE)
def means(middle):
    """Weights of a span's points in the mean, or those that count the middle one alone."""
    if middle:
        return quad(0.0, 1.0, 0.0)
    return quad(OUTER, MIDDLE, OUTER)


@njit(**INLINE)
def tilts():
    """Weights of a span's points in the root mean square of their line about the mean."""
    return quad(-TILT, 0.0, TILT)


@njit(**INLINE)
def add_squares(block, dof, modulus, gradient, line):
    """Add the square of a span's stretch or twist to the block.

    Args:
        dof: coordinates that it depends on, the first ones.
        modulus: factor, integrated over the span.
        gradient: gradient of the span's mean, and behind it of its `tilt`, shape (2 FIRST,).
        line: whether the tilt counts.
    """
    for c in range(dof):
        for d in range(c + 1):
            at = BLOCK * (c * (c + 1) // 2 + d)
            add_outer(block, at, modulus, gradient, 4 * c, gradient, 4 * d)
            if line:
                add_outer(block, at, modulus, gradient, FIRST + 4 * c, gradient, FIRST + 4 * d)


@njit(**INLINE)
def add_block(block, dof, span, band):
    """Add the block of a span to the lower rows of a banded matrix, (dof n, 4 dof)."""
    last = 4 * dof - 1
    first = last + 4 * dof * dof * span  # where the block's first diagonal entry stands
    for c in range(dof):
        for d in range(c + 1):
            pair, at = BLOCK * (c * (c + 1) // 2 + d), first + last * c + d
            for i in range(4):
                for j in range(i + 1):
                    to = at + dof * (last * i + j)
                    add_rows(band, to, (1.0,), block, pair + 4 * i + j, 1)
            if d < c:
                at = first + last * d + c
                for i in range(1, 4):
                    for j in range(i):
                        to = at + dof * (last * i + j)
                        add_rows(band, to, (1.0,), block, pair + 4 * j + i, 1)


@njit(**INLINE)
def add_forces(forces, dof, span, gradient):
    """Add a span's forces to the gradient (dof n,)."""
    for i in range(4):
        for c in range(dof):
            gradient[dof * (span + i) + c] += forces[4 * c + i]
