# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The planar rod's equations for eight parameter sets at once; formulas: `planar_assembly`.

What is common to the sets are numbers, what differs are vectors (`eight_lanes`), stored as rows.
Degree of freedom 2 i + c is coordinate c (x, z) of control point i. Only control points lo to
hi - 1 are free. A symmetric matrix is stored by columns: row 8 k + m holds A[k + m, k].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.strains import MIDDLE, OUTER
from dlo_ros.rod.lanes import common_matrix
from dlo_ros.rod.lanes.simd_tables import PAIRS, local_tables
from dlo_ros.rod.lanes.span_lanes import gather, scatter
from dlo_ros.rod.simd.eight_lanes import (
    LANES,
    entry,
    load,
    root,
    row_address,
    somewhere,
    spread,
    store,
)  # fmt: skip
from dlo_ros.spline import FloatArray

COLUMN = 8  # stored entries of a column


class BatchLaw(NamedTuple):
    """Stiffness with weights and rest strains of one step; arrays (..., LANES)."""

    stretch: FloatArray  # (nb,)
    stretch_rest: FloatArray
    bend: FloatArray  # (nb,); in space (3 nb,), of kappa_1, kappa_2 and twist
    bend_rest: FloatArray


class Scratch(NamedTuple):
    """Room for the linear system; arrays (..., LANES)."""

    gradient: FloatArray  # (d n,)
    step: FloatArray  # (d (n + 4) - 1,) right-hand side and solution
    band: FloatArray  # (8 (2 n + 7),) or (64 n,) matrix, then its factors; see `common_matrix`
    point: FloatArray  # (3 * 14,) or (3 * 42,) forces and second derivatives at a span's points
    line: FloatArray  # (16,) or (85,) derivatives of a span's mean stretch, of its tilt and so on
    tangent: FloatArray  # (2 nb,) or (3 nb,) unit tangents when last assembled


class Frame(NamedTuple):
    """Reference frame in space; arrays (..., LANES), empty in the plane."""

    tangent: FloatArray  # (3 nb,)
    rate: FloatArray  # (3 nb,) [1/m]
    director: FloatArray  # (3 nb,)
    twist: FloatArray  # (nb,) [rad/m]


@njit(inline="always")
def slopes(q, tables, e):
    """First and second derivative along u at point e."""
    at = 2 * (e // 3)
    u, v, x, z = entry(tables.b1, 4 * e), entry(tables.b2, 4 * e), load(q, at), load(q, at + 1)
    px, pz, sx, sz = u * x, u * z, v * x, v * z
    for i in range(1, 4):
        u, v = entry(tables.b1, 4 * e + i), entry(tables.b2, 4 * e + i)
        x, z = load(q, at + 2 * i), load(q, at + 2 * i + 1)
        px += u * x
        pz += u * z
        sx += v * x
        sz += v * z
    return px, pz, sx, sz


@linked()
def strains(q, tables, stretch, bend):
    """Write stretch of whole spans and curvature, (nb, LANES); of one rod eight spans at a time."""
    lanes, numbers = tables.together, tables.together.numbers
    own, long, bent = (
        row_address(lanes.work, 0), row_address(lanes.work, 8), row_address(lanes.work, 11),
    )  # fmt: skip
    for group in range(lanes.groups):
        spans = min(LANES, lanes.size - LANES * group)
        gather(numbers, group, q, 2, 8, own)
        _strains(own, local_tables(tables, group), long, bent)
        scatter(numbers, group, spans, long, 3, 3, 0, 3 * tables.spans, stretch)
        scatter(numbers, group, spans, bent, 3, 3, 0, 3 * tables.spans, bend)
    if lanes.groups == 0:
        _strains(q, tables, stretch, bend)


@njit(from_python=False)
def _strains(q, tables, stretch, bend):
    """`strains` of all rods in lanes, or of all spans in them."""
    for e in range(3 * tables.spans):
        px, pz, sx, sz = slopes(q, tables, e)
        square = px * px + pz * pz
        n = root(square)
        store(bend, e, (pz * sx - px * sz) / (square * n))
        store(stretch, e, n - 1.0)
        if e % 3 == 2:
            span_stretch(stretch, e - 2, entry(tables.linear, e // 3))


@njit(inline="always")
def span_stretch(stretch, first, linear):
    """`strains.span_stretch` of a span whose first point is given; `linear` is 1 or 0."""
    a, b, c = load(stretch, first), load(stretch, first + 1), load(stretch, first + 2)
    mean = linear * (OUTER * (a + c) + MIDDLE * b) + (1.0 - linear) * b
    tilt = linear * (0.5 * (c - a))
    store(stretch, first, mean - tilt)
    store(stretch, first + 1, mean)
    store(stretch, first + 2, mean + tilt)


@linked()
def assemble(q, tables, law, scratch, matrix, tension, first):
    """Gradient of the elastic energy, and `matrix` plus its Hessian in the free ones.

    A sideways move of size d stretches the DLO by d^2, and the tension of that false stretch is
    large: in the Hessian it would hold the next move back. So the Hessian has the tension that
    the last linear solution promised, while the gradient is exact: Newton's method with tensions
    as unknowns of their own (Magisano, Leonetti and Garcea, 2017), which converges as fast at the
    end and in far fewer iterations before.

    Args:
        matrix: basis matrix for x and for z alike, lower rows (4 n, LANES).
        tension: tension times weights, for the Hessian where there was no linear solution yet, (nb,
            LANES).
        first: whether that is so.
    """
    lo, hi = tables.lo, tables.hi
    gradient, band, zero = scratch.gradient, scratch.band, spread(0.0)
    for i in range(2 * hi):
        store(gradient, i, zero)
    if tables.together.groups > 0:
        common_matrix.begin(tables, matrix, band)
        for group in range(tables.together.groups):
            _add_group(q, tables, law, scratch, group, tension, first)
        return
    for j in range(lo, hi):
        for i in range(j, j + 4):
            inside = i < hi
            x = load(matrix, 4 * i + 3 - i + j) if inside else zero
            at, m = COLUMN * 2 * j, 2 * (i - j)
            store(band, at + m, x)
            store(band, at + m + 1, zero)
            store(band, at + COLUMN + m, x)
            store(band, at + COLUMN + m + 1, zero)
    for span in range(tables.spans):
        _add_span(q, tables, law, scratch, span, tension, first)


@linked()
def _add_span(q, tables, law, scratch, span, tension, first):
    """Add a span to gradient and Hessian."""
    lo, hi = tables.lo, tables.hi
    gradient, band, point = scratch.gradient, scratch.band, scratch.point
    linear = entry(tables.linear, span)
    _points(q, tables, law, scratch, span, linear, tension, first)
    for i in range(4):
        if lo <= span + i < hi:
            at = 2 * (span + i)
            x, z = load(gradient, at), load(gradient, at + 1)
            for g in range(3):
                k, at_point = 14 * g, 4 * (3 * span + g) + i
                u, v = entry(tables.b1, at_point), entry(tables.b2, at_point)
                x += u * load(point, k) + v * load(point, k + 2)
                z += u * load(point, k + 1) + v * load(point, k + 3)
            store(gradient, at, x)
            store(gradient, at + 1, z)
    if somewhere(linear):
        _add_line(scratch, law, linear, span, lo, hi)
    pair = 0
    for i in range(4):
        for j in range(i + 1):
            if lo <= span + j and span + i < hi:
                _add_block(point, tables.products, PAIRS * span + pair, band, span + j, i - j)
            pair += 1


@linked()
def gathered_law(lanes, group, law, first, bends):
    """Law of a group's spans in lanes, at rows of `SpanLanes.work` from the given one on.

    Args:
        bends: numbers of bending (and twist) of a span.
    """
    work, numbers = lanes.work, lanes.numbers
    own = BatchLaw(
        row_address(work, first), row_address(work, first + 3), row_address(work, first + 6),
        row_address(work, first + 6 + bends),
    )  # fmt: skip
    gather(numbers, group, law.stretch, 3, 3, own.stretch)
    gather(numbers, group, law.stretch_rest, 3, 3, own.stretch_rest)
    gather(numbers, group, law.bend, bends, bends, own.bend)
    gather(numbers, group, law.bend_rest, bends, bends, own.bend_rest)
    return own


@linked()
def _add_group(q, tables, law, scratch, group, tension, first):
    """Add a group of spans in lanes to gradient and Hessian; rows: `span_lanes.work_rows`."""
    lanes = tables.together
    numbers, work, spans = lanes.numbers, lanes.work, min(LANES, lanes.size - LANES * group)
    tense, tangent = row_address(work, 20), row_address(work, 23)
    gradient, band = row_address(work, 29), row_address(work, 37)
    gather(numbers, group, q, 2, 8, row_address(work, 0))
    own = gathered_law(lanes, group, law, 8, 3)
    gather(numbers, group, tension, 3, 3, tense)
    gather(numbers, group, scratch.tangent, 6, 6, tangent)
    for k in range(29, 29 + 8 + 64):
        store(work, k, spread(0.0))
    local = Scratch(gradient, scratch.step, band, scratch.point, scratch.line, tangent)
    _add_span(row_address(work, 0), local_tables(tables, group), own, local, 0, tense, first)
    low, high = 2 * tables.lo, 2 * tables.hi
    scatter(numbers, group, spans, tangent, 6, 6, 0, 6 * tables.spans, scratch.tangent)
    scatter(numbers, group, spans, gradient, -2, 8, low, high, scratch.gradient)
    common_matrix.add_columns(tables, group, spans, band, scratch.band)


@njit(from_python=False)
def _points(q, tables, law, scratch, span, linear, tension, first):
    """Forces on p and s (4 rows) and second derivatives (10 rows) at a span's three points.

    Args:
        linear: 1 where the straight line through a span's stretches counts, or 0, a number or one
            for each lane.
    """
    point, line, zero = scratch.point, scratch.line, spread(0.0)
    lines, single = somewhere(linear), 1.0 - linear
    # Where a straight line counts: lengths at all points first, and those promised.
    mean, tilt, next_mean, next_tilt = zero, zero, zero, zero
    if lines:
        mean, tilt = _lengths(q, tables, span, scratch.tangent, False)
        next_mean, next_tilt = _lengths(q, tables, span, scratch.tangent, True)
        for k in range(16):
            store(line, k, zero)
    for g in range(3):
        e = 3 * span + g
        px, pz, sx, sz = slopes(q, tables, e)
        square = px * px + pz * pz
        r2 = 1.0 / square
        n = root(square)
        r = n * r2
        f0, tx, tz = r2 * r, px * r, pz * r
        kappa = (pz * sx - px * sz) * f0
        bend = load(law.bend, e)
        stress = bend * (kappa - load(law.bend_rest, e))
        f = 3.0 * kappa * r2
        kpx, kpz = zero - sz * f0 - f * px, sx * f0 - f * pz
        ksx, ksz = pz * f0, zero - px * f0
        m = 3.0 * f0 * r2 * stress
        q15, fs = 5.0 * f * r2 * stress, f * stress
        hxx = bend * kpx * kpx + 2.0 * m * sz * px - fs + q15 * px * px
        hxz = bend * kpx * kpz + m * (sz * pz - sx * px) + q15 * px * pz
        hzz = bend * kpz * kpz - 2.0 * m * sx * pz - fs + q15 * pz * pz
        fx, fz = stress * kpx, stress * kpz
        if lines or g == 1:
            stiff = counts(linear, single, g) * load(law.stretch, e)
            rest = load(law.stretch_rest, e) + 1.0
            long, next_long = n, _along(scratch.tangent, e, px, pz)
            if lines:
                long = single * n + linear * (mean + float(g - 1) * tilt)
                next_long = single * next_long + linear * (next_mean + float(g - 1) * next_tilt)
            pull = stiff * (long - rest)
            promised = stiff * (next_long - rest)
            firm = single * stiff
            hxx += firm * tx * tx
            hxz += firm * tx * tz
            hzz += firm * tz * tz
            if first:
                promised = load(tension, e)
            fx += pull * tx
            fz += pull * tz
            soft = promised * r
            hxx += soft * tz * tz
            hxz -= soft * tx * tz
            hzz += soft * tx * tx
            store(scratch.tangent, 2 * e, tx)
            store(scratch.tangent, 2 * e + 1, tz)
        if lines:
            share = MIDDLE if g == 1 else OUTER
            slope = np.sqrt(2.0 * OUTER) * 0.5 * float(g - 1)
            for i in range(4):
                u = entry(tables.b1, 4 * e + i)
                for half in range(2):
                    w, k = (share * u if half == 0 else slope * u), 8 * half + 2 * i
                    store(line, k, load(line, k) + w * tx)
                    store(line, k + 1, load(line, k + 1) + w * tz)
        k = 14 * g
        store(point, k, fx)
        store(point, k + 1, fz)
        store(point, k + 2, stress * ksx)
        store(point, k + 3, stress * ksz)
        store(point, k + 4, hxx)
        store(point, k + 5, hxz)
        store(point, k + 6, hzz)
        store(point, k + 7, bend * kpx * ksx - m * px * pz)
        store(point, k + 8, bend * kpx * ksz - f0 * stress + m * px * px)
        store(point, k + 9, bend * kpz * ksx + f0 * stress - m * pz * pz)
        store(point, k + 10, bend * kpz * ksz + m * pz * px)
        store(point, k + 11, bend * ksx * ksx)
        store(point, k + 12, bend * ksx * ksz)
        store(point, k + 13, bend * ksz * ksz)


@njit(inline="always")
def counts(linear, single, g):
    """How often the stretch at point g of a span counts: that of its middle stands for all, unless
    the straight line counts.
    """
    return linear + (1.0 / MIDDLE) * single if g == 1 else linear


@njit(inline="always")
def _along(tangent, e, px, pz):
    """Length of p to first order about its last value: its share along that one's direction."""
    return load(tangent, 2 * e) * px + load(tangent, 2 * e + 1) * pz


@njit(from_python=False)
def _lengths(q, tables, span, tangent, promised):
    """Mean and tilt of the straight line through |p| at a span's points; see `_along`."""
    a, b, c = spread(0.0), spread(0.0), spread(0.0)
    for g in range(3):
        e = 3 * span + g
        px, pz, _, _ = slopes(q, tables, e)
        a, b = b, c
        c = _along(tangent, e, px, pz) if promised else root(px * px + pz * pz)
    return OUTER * (a + c) + MIDDLE * b, 0.5 * (c - a)


@linked()
def tensions(stretch, law, tables, out):
    """Write the tensions that `assemble` takes, from stretches of whole spans (nb, LANES)."""
    for e in range(3 * tables.spans):
        linear = entry(tables.linear, e // 3)
        stiff = counts(linear, 1.0 - linear, e % 3) * load(law.stretch, e)
        store(out, e, stiff * (load(stretch, e) - load(law.stretch_rest, e)))


@njit(inline="always")
def _add_block(point, products, row, band, j, apart):
    """Add the second derivatives for control points j and j + apart."""
    at, m = COLUMN * 2 * j, 2 * apart
    xx, zx = load(band, at + m), load(band, at + m + 1)
    zz = load(band, at + COLUMN + m)
    xz = load(band, at + COLUMN + m - 1) if apart > 0 else zx
    for g in range(3):
        k = 14 * g
        c = 4 * (3 * row + g)
        uu, uv = entry(products, c), entry(products, c + 1)
        vu, vv = entry(products, c + 2), entry(products, c + 3)
        axz, azx = load(point, k + 8), load(point, k + 9)
        xx += uu * load(point, k + 4) + (uv + vu) * load(point, k + 7) + vv * load(point, k + 11)
        zz += uu * load(point, k + 6) + (uv + vu) * load(point, k + 10) + vv * load(point, k + 13)
        both = uu * load(point, k + 5) + vv * load(point, k + 12)
        xz += both + uv * axz + vu * azx
        zx += both + uv * azx + vu * axz
    store(band, at + m, xx)
    store(band, at + m + 1, zx)
    store(band, at + COLUMN + m, zz)
    if apart > 0:
        store(band, at + COLUMN + m - 1, xz)


@njit(from_python=False)
def _add_line(scratch, law, linear, span, lo, hi):
    """Add the square of a span's linear stretch, see `element_stiffness.add_squares`."""
    line, band = scratch.line, scratch.band
    # law.stretch has the points' weights, which sum to the span's length.
    stiff = (load(law.stretch, 3 * span) + load(law.stretch, 3 * span + 1)
             + load(law.stretch, 3 * span + 2)) * linear  # fmt: skip
    first, last = max(0, 2 * (lo - span)), min(8, 2 * (hi - span))
    for b in range(first, last):
        mean, tilt = stiff * load(line, b), stiff * load(line, 8 + b)
        for a in range(first, b + 1):
            at = COLUMN * (2 * span + a) + b - a
            store(band, at, load(band, at) + mean * load(line, a) + tilt * load(line, 8 + a))
