"""Compiled assembly of the stiffness of one knot span, in space and in the plane.

A span has four control points with `dof` coordinates each. Its stiffness is first gathered in a
dense block that stands coordinate by coordinate: the 16 numbers of a pair of coordinates (c, d),
d <= c, couple c of control point i to d of control point j at 4 i + j. So a second derivative at a
quadrature point, by whatever coordinates, multiplies the same 16 products of basis functions, which
is one vector operation.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod.kernels import MIDDLE, OUTER
from dlo_ros.rod.lanes import add_rows, set_rows
from dlo_ros.rod.vectors import INLINE

BLOCK = 16  # numbers of a pair of coordinates
POINT = 16  # numbers of a span's first derivatives: c of control point i at 4 c + i
SHAPES = 12  # basis functions: no, first, second derivatives of four
SHAPE = 4  # where first derivatives stand, followed by second ones
# Products of basis functions of i and j, by number of derivatives: 11 12 21 22, 01 02 00.
PRODUCTS = 112
SLOPE, VALUE = 0, 64
TILT = np.sqrt(2.0 * OUTER) * 0.5


@njit(**INLINE)
def shapes(rule, e, out):
    """Basis functions and their derivatives at point e."""
    set_rows(out, 0, (1.0,), rule.b, 4 * e, 4)
    set_rows(out, 4, (1.0,), rule.b1, 4 * e, 4)
    set_rows(out, 8, (1.0,), rule.b2, 4 * e, 4)


@njit(**INLINE)
def slope_products(rule, e, out):
    """Products of first and second derivatives of the basis functions at point e."""
    for i in range(4):
        set_rows(out, 4 * i, (rule.b1[e, i],), rule.b1, 4 * e, 4)
        set_rows(out, 16 + 4 * i, (rule.b1[e, i],), rule.b2, 4 * e, 4)
        set_rows(out, 32 + 4 * i, (rule.b2[e, i],), rule.b1, 4 * e, 4)
        set_rows(out, 48 + 4 * i, (rule.b2[e, i],), rule.b2, 4 * e, 4)


@njit(**INLINE)
def value_products(rule, e, out):
    """Products of the basis functions at point e with their derivatives and themselves."""
    for i in range(4):
        set_rows(out, VALUE + 4 * i, (rule.b[e, i],), rule.b1, 4 * e, 4)
        set_rows(out, VALUE + 16 + 4 * i, (rule.b[e, i],), rule.b2, 4 * e, 4)
        set_rows(out, VALUE + 32 + 4 * i, (rule.b[e, i],), rule.b, 4 * e, 4)


@njit(**INLINE)
def mean(point, middle):
    """Weight of one of three points in the mean, or the weight that counts the middle alone."""
    if middle:
        return 1.0 if point == 1 else 0.0
    return MIDDLE if point == 1 else OUTER


@njit(**INLINE)
def tilt(point):
    """Weight of one of three points in the root mean square of the line about its mean."""
    return TILT * (point - 1)


@njit(**INLINE)
def add_squares(block, dof, modulus, gradient, line):
    """Add the square of a span's stretch or twist to the block.

    Args:
        dof: coordinates that it depends on, the first ones.
        modulus: factor, integrated over the span.
        gradient: of its mean, and behind it of its `tilt`, shape (2 POINT,).
        line: whether the tilt counts.
    """
    for c in range(dof):
        for d in range(c + 1):
            at = BLOCK * (c * (c + 1) // 2 + d)
            for i in range(4):
                f = modulus * gradient[4 * c + i]
                add_rows(block, at + 4 * i, (f,), gradient, 4 * d, 4)
                if line:
                    f = modulus * gradient[POINT + 4 * c + i]
                    add_rows(block, at + 4 * i, (f,), gradient, POINT + 4 * d, 4)


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
