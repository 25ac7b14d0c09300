# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The matrix of one rod that all lanes hold: numbers instead of rows, an eighth of the memory.

It is symmetric and banded, and stored by columns: with 4 d numbers to a column for d degrees of
freedom to a control point, number 4 d k + m is A[k + m, k]. So a register of LANES holds as many
entries of a column. Behind the last column there is room for 4 d - 1 more.
"""

from __future__ import annotations

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.simd.eight_lanes import (
    LANES,
    entry,
    load,
    number_address,
    put_entry,
    row_address,
    spread,
    store,
)  # fmt: skip
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE


@linked()
def begin(tables, matrix, band):
    """Write the basis matrix to the columns of the free control points.

    Args:
        matrix: for positions, then in space for theta, lower rows (4 n, LANES) each.
        band: output.
    """
    n, lo, hi, dof = tables.n, tables.lo, tables.hi, tables.dof
    width = 4 * dof
    for k in range(dof * lo * (width // LANES), (dof * hi + width - 1) * (width // LANES)):
        store(band, k, spread(0.0))
    for j in range(lo, hi):
        for o in range(min(4, hi - j)):
            row = 4 * (j + o) + 3 - o
            for c in range(dof):
                x = entry(matrix, LANES * (row + (4 * n if c == 3 else 0)))
                put_entry(band, width * (dof * j + c) + dof * o, x)


@linked()
def add_columns(tables, group, spans, source, band):
    """Add the stiffness of a group of spans in lanes.

    Args:
        spans: how many spans the group has.
        source: rows of the four control points of each, stored as for several rods.
    """
    for lane in range(spans):
        first = int(entry(tables.together.numbers, LANES * group + lane))
        low, high = max(tables.lo - first, 0), min(4, tables.hi - first)
        if tables.dof == 4:
            to = 64 * first
            for j in range(low, high):
                for o in range(high - j):
                    for c in range(4):
                        for r in range(c if o == 0 else 0, 4):
                            x = entry(source, LANES * (64 * j + 16 * o + 4 * r + c) + lane)
                            at = to + 64 * j + 15 * c + 4 * o + r
                            put_entry(band, at, entry(band, at) + x)
        else:
            to = 16 * first
            for k in range(2 * low, 2 * high):
                for m in range(2 * high - k):
                    x = entry(source, LANES * (8 * k + m) + lane)
                    put_entry(band, to + 8 * k + m, entry(band, to + 8 * k + m) + x)


@linked()
def hold(tables, band, first, last):
    """Make rows and columns `first` to `last` - 1 of what is imposed those of the unit matrix."""
    width = 4 * tables.dof
    for k in range(first, last):
        if entry(tables.fixed, k) == 0.0:
            continue
        put_entry(band, width * k, 1.0)
        for m in range(1, width):
            put_entry(band, width * k + m, 0.0)
            if k - m >= first:
                put_entry(band, width * (k - m) + m, 0.0)


@linked()
def subtract_imposed(tables, band, increments, right):
    """Subtract the forces of what is imposed from right-hand sides, rows (d n, LANES)."""
    size, width = tables.dof * tables.n, 4 * tables.dof
    for j in range(size):
        if entry(tables.fixed, j) == 0.0:
            continue
        x = load(increments, j)
        for i in range(max(0, j - width + 1), min(size, j + width)):
            at = width * j + i - j if i >= j else width * i + j - i
            store(right, i, load(right, i) - entry(band, at) * x)


@linked(**FLAGS)
def factorise(tables, band, work):
    """Factorise the free part in place.

    Args:
        work: room for 32 numbers.

    Returns:
        The smallest pivot.
    """
    if tables.dof == 4:
        return _factorise(band, work, 4 * tables.lo, 4 * tables.hi, 16)
    return _factorise(band, work, 2 * tables.lo, 2 * tables.hi, 8)


@njit(**INLINE)
def _factorise(band, work, first, last, width):
    halves = width // LANES
    for b in range(halves, 2 * halves):
        store(work, b, spread(0.0))  # behind the end of a column
    lowest = entry(band, width * first)
    for k in range(first, last):
        pivot = entry(band, width * k)
        lowest, inverse = min(lowest, pivot), 1.0 / pivot
        for b in range(halves):
            store(work, b, load(band, halves * k + b))
        put_entry(band, width * k, inverse)
        for a in range(1, width):
            factor, column = entry(work, a) * inverse, number_address(work, a)
            to = row_address(band, halves * (k + a))
            for b in range(halves):
                store(to, b, load(to, b) - factor * load(column, b))
    return lowest


@linked(**FLAGS)
def substitute(tables, band, right):
    """Replace right-hand sides by the solutions, given the factors.

    Args:
        right: rows, of which the 4 d - 1 behind the free part are zero.
    """
    if tables.dof == 4:
        _substitute(band, right, 4 * tables.lo, 4 * tables.hi, 16)
    else:
        _substitute(band, right, 2 * tables.lo, 2 * tables.hi, 8)


@njit(**INLINE)
def _substitute(band, right, first, last, width):
    for k in range(first, last):
        at = width * k
        y = load(right, k) * entry(band, at)
        for a in range(1, width):
            store(right, k + a, load(right, k + a) - entry(band, at + a) * y)
    for k in range(last - 1, first - 1, -1):
        x, at = load(right, k), width * k
        for a in range(width - 1, 0, -1):
            x -= entry(band, at + a) * load(right, k + a)
        store(right, k, x * entry(band, at))
