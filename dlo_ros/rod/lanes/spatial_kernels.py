# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The equations of the rod in space for eight parameter sets at once.

The layout is that of `simd_kernels`, with degrees of freedom 4 i + c for x, y, z, theta, and three
rows of bending and twist to a point. Formulas: `strain_derivatives`, the same functions as for one
rod. A symmetric matrix is stored by blocks: row BLOCKS j + 16 o + 4 r + c couples coordinate r of
control point j + o to coordinate c of control point j.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.strain_derivatives import Stress, first_at, second
from dlo_ros.rod.elements.strains import (
    MIDDLE,
    OUTER,
    carried_twist,
    curvatures,
    turned,
)  # fmt: skip
from dlo_ros.rod.lanes import common_matrix
from dlo_ros.rod.lanes.simd_kernels import Scratch, counts, gathered_law
from dlo_ros.rod.lanes.simd_tables import PAIRS, local_tables
from dlo_ros.rod.lanes.span_lanes import gather, scatter
from dlo_ros.rod.lanes.spatial_strains import gathered_rod, get, line, put, slopes
from dlo_ros.rod.simd.eight_lanes import LANES, entry, load, row_address, somewhere, spread, store
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE, dot, mix, mix3, times

BLOCKS = 64  # stored entries of a control point's columns
# Rows of a point: forces by p, s, theta, theta' (8), then second derivatives by p and p, p and s, s
# and s (9 each, row by row), p and theta, s and theta (3 each), theta and theta.
PP, PS, SS, P_THETA, S_THETA, THETA, POINT = 8, 17, 26, 35, 38, 41, 42
TILT = np.sqrt(2.0 * OUTER) * 0.5
# Rows of a span: slopes p, s and theta of its points, then the derivatives by its 16 numbers of the
# mean twist, of its tilt, of the mean stretch and of its tilt.
SLOPES, TURN, TURN_TILT, LINE, LINE_TILT, SPAN = 0, 21, 37, 53, 69, 85


@linked(**FLAGS)
def assemble(q, tables, frame, law, scratch, matrix, tension, first):
    """Gradient of the elastic energy, and `matrix` plus its Hessian in the free control points.

    Tensions in the Hessian are those that the last linear solution promised, see
    `simd_kernels.assemble`. Rows and columns of what is imposed become those of the unit matrix.

    Args:
        frame: reference frame.
        matrix: basis matrix for positions, then for theta, lower rows (8 n, LANES).
    """
    lo, hi = tables.lo, tables.hi
    gradient, band, zero = scratch.gradient, scratch.band, spread(0.0)
    for i in range(4 * hi):
        store(gradient, i, zero)
    if tables.together.groups > 0:
        common_matrix.begin(tables, matrix, band)
        for group in range(tables.together.groups):
            _add_group(q, tables, frame, law, scratch, group, tension, first)
        common_matrix.hold(tables, band, 4 * lo, 4 * hi)
        return
    theta = 4 * tables.n
    for j in range(lo, hi):
        for k in range(BLOCKS):
            store(band, BLOCKS * j + k, zero)
        for o in range(min(4, hi - j)):
            at, row = BLOCKS * j + 16 * o, 4 * (j + o) + 3 - o
            for c in range(3):
                store(band, at + 5 * c, load(matrix, row))
            store(band, at + 15, load(matrix, theta + row))
    for span in range(tables.spans):
        _add_span(q, tables, frame, law, scratch, span, tension, first)
    _hold(tables, band)


@linked(**FLAGS)
def _add_span(q, tables, frame, law, scratch, span, tension, first):
    """Add a span to gradient and Hessian."""
    lo, hi = tables.lo, tables.hi
    _points(q, tables, frame, law, scratch, span, tension, first)
    _add_forces(tables, scratch, span, lo, hi)
    pair = 0
    for i in range(4):
        for j in range(i + 1):
            if lo <= span + j and span + i < hi:
                at = BLOCKS * (span + j) + 16 * (i - j)
                _add_block(tables, scratch, law, span, PAIRS * span + pair, i, j, at)
            pair += 1


@linked(**FLAGS)
def _add_group(q, tables, frame, law, scratch, group, tension, first):
    """Add a group of spans in lanes to gradient and Hessian; rows: `span_lanes.work_rows`."""
    lanes = tables.together
    numbers, work, spans = lanes.numbers, lanes.work, min(LANES, lanes.size - LANES * group)
    tense, tangent = row_address(work, 40), row_address(work, 43)
    gradient, band = row_address(work, 82), row_address(work, 98)
    carried, own = gathered_rod(q, tables, frame, group), gathered_law(lanes, group, law, 16, 9)
    gather(numbers, group, tension, 3, 3, tense)
    gather(numbers, group, scratch.tangent, 9, 9, tangent)
    for k in range(82, 82 + 16 + 256):
        store(work, k, spread(0.0))
    local = Scratch(gradient, scratch.step, band, scratch.point, scratch.line, tangent)
    _add_span(
        row_address(work, 0), local_tables(tables, group), carried, own, local, 0, tense, first
    )
    low, high = tables.lo, tables.hi
    scatter(numbers, group, spans, tangent, 9, 9, 0, 9 * tables.spans, scratch.tangent)
    scatter(numbers, group, spans, gradient, -4, 16, 4 * low, 4 * high, scratch.gradient)
    common_matrix.add_columns(tables, group, spans, band, scratch.band)


@linked()
def _hold(tables, band):
    """Make rows and columns of what is imposed those of the unit matrix."""
    lo, hi, zero, one = tables.lo, tables.hi, spread(0.0), spread(1.0)
    for k in range(4 * lo, 4 * hi):
        if entry(tables.fixed, k) == 0.0:
            continue
        i, c = k // 4, k % 4
        for o in range(4):
            for d in range(4):
                store(band, BLOCKS * i + 16 * o + 4 * d + c, zero)
                if i - o >= lo:
                    store(band, BLOCKS * (i - o) + 16 * o + 4 * c + d, zero)
        store(band, BLOCKS * i + 5 * c, one)


@njit(from_python=False, **FLAGS)
def _points(q, tables, frame, law, scratch, span, tension, first):
    """Forces and second derivatives at a span's three points, see `_keep`; and its `SPAN` rows."""
    work, zero = scratch.line, spread(0.0)
    linear, twisted = entry(tables.linear, span), entry(tables.twist_linear, span)
    lines, twist_lines, single = somewhere(linear), somewhere(twisted), 1.0 - linear
    a, b, c = zero, zero, zero  # twist at the three points
    x1, x2, x3 = zero, zero, zero  # |p|
    y1, y2, y3 = zero, zero, zero  # |p| that was promised
    for g in range(3):
        e = 3 * span + g
        p, s, theta, rate = slopes(q, tables, e)
        put(work, SLOPES + 7 * g, p)
        put(work, SLOPES + 7 * g + 3, s)
        store(work, SLOPES + 7 * g + 6, theta)
        size = np.sqrt(dot(p, p))
        added = carried_twist(p, s, 1.0 / size, get(frame.tangent, 3 * e), get(frame.rate, 3 * e))
        a, b, c = b, c, rate + load(frame.twist, e) + added
        x1, x2, x3 = x2, x3, size
        y1, y2, y3 = y2, y3, dot(p, get(scratch.tangent, 3 * e))
    twist, twist_tilt = line(a, b, c, twisted)
    long, long_tilt = line(x1, x2, x3, linear)
    promised, promised_tilt = line(y1, y2, y3, linear)
    long, promised = linear * long + single * x2, linear * promised + single * y2
    for k in range(TURN, SPAN if lines or twist_lines else TURN_TILT):
        store(work, k, zero)
    for g in range(3):
        e, side = 3 * span + g, float(g - 1)
        p, s = get(work, SLOPES + 7 * g), get(work, SLOPES + 7 * g + 3)
        r, t0 = 1.0 / np.sqrt(dot(p, p)), get(frame.tangent, 3 * e)
        t = times(r, p)
        d1 = turned(get(frame.director, 3 * e), load(work, SLOPES + 7 * g + 6), t0, t)
        kappa1, kappa2 = curvatures(s, r, t, d1)
        x = first_at(p, s, r, t, t0, get(frame.rate, 3 * e), d1, kappa1, kappa2)
        share = MIDDLE if g == 1 else OUTER
        stiff1, stiff2, stiff3 = get(law.bend, 3 * e)
        rest1, rest2, rest3 = get(law.bend_rest, 3 * e)
        bend1, bend2 = stiff1 * (kappa1 - rest1), stiff2 * (kappa2 - rest2)
        torque = stiff3 * (twist + side * twist_tilt - rest3)
        drawn, pull, firm = zero, zero, zero
        if lines or g == 1:
            stiff = counts(linear, single, g) * load(law.stretch, e)
            rest = load(law.stretch_rest, e) + 1.0
            drawn = stiff * (long + side * long_tilt - rest)
            pull = stiff * (promised + side * promised_tilt - rest)
            if first:
                pull = load(tension, e)
            firm = single * stiff
        put(scratch.tangent, 3 * e, t)
        f = Stress(drawn, bend1, bend2, torque, stiff1, zero, stiff2, pull)
        _keep(scratch.point, POINT * g, x, f, second(x, kappa1, kappa2, f), firm, kappa1, kappa2)
        for i in range(4):
            u1, u2 = entry(tables.b1, 4 * e + i), entry(tables.b2, 4 * e + i)
            by = mix(u1, x.twist_p, u2, x.a)
            at = TURN + 4 * i
            put(work, at, mix(1.0, get(work, at), share, by))
            store(work, at + 3, load(work, at + 3) + share * u1)
            if twist_lines:
                at = TURN_TILT + 4 * i
                put(work, at, mix(1.0, get(work, at), side * TILT, by))
                store(work, at + 3, load(work, at + 3) + (side * TILT) * u1)
            if lines:
                at = LINE + 4 * i
                put(work, at, mix(1.0, get(work, at), share * u1, t))
                at = LINE_TILT + 4 * i
                put(work, at, mix(1.0, get(work, at), side * TILT * u1, t))


@njit(**INLINE)
def _keep(point, k, x, f, h, firm, kappa1, kappa2):
    """Write a point's rows, see `PP`."""
    bent = mix3(f.bend1, x.kappa1_p, f.bend2, x.kappa2_p, f.torque, x.twist_p)
    put(point, k, mix(1.0, bent, f.tension, x.t))
    put(point, k + 3, mix3(f.bend1, x.kappa1_s, f.bend2, x.kappa2_s, f.torque, x.a))
    store(point, k + 6, f.bend1 * kappa2 - f.bend2 * kappa1)
    store(point, k + 7, f.torque)
    stiff = times(firm, x.t)
    (xx, _, _), (yx, yy, _), (zx, zy, zz) = h.pp
    yx, zx, zy = yx + stiff[1] * x.t[0], zx + stiff[2] * x.t[0], zy + stiff[2] * x.t[1]
    put(point, k + PP, (xx + stiff[0] * x.t[0], yx, zx))
    put(point, k + PP + 3, (yx, yy + stiff[1] * x.t[1], zy))
    put(point, k + PP + 6, (zx, zy, zz + stiff[2] * x.t[2]))
    (xx, _, _), (yx, yy, _), (zx, zy, zz) = h.ss
    put(point, k + SS, (xx, yx, zx))
    put(point, k + SS + 3, (yx, yy, zy))
    put(point, k + SS + 6, (zx, zy, zz))
    for row in range(3):
        put(point, k + PS + 3 * row, h.ps[row])
    put(point, k + P_THETA, h.p_theta)
    put(point, k + S_THETA, h.s_theta)
    store(point, k + THETA, h.theta)


@njit(from_python=False, **FLAGS)
def _add_forces(tables, scratch, span, lo, hi):
    """Add the forces of a span to the gradient."""
    gradient, point = scratch.gradient, scratch.point
    for i in range(4):
        if not lo <= span + i < hi:
            continue
        at = 4 * (span + i)
        force, turn = get(gradient, at), load(gradient, at + 3)
        for g in range(3):
            k, e = POINT * g, 4 * (3 * span + g) + i
            w, u, v = entry(tables.b, e), entry(tables.b1, e), entry(tables.b2, e)
            force = mix3(1.0, force, u, get(point, k), v, get(point, k + 3))
            turn += w * load(point, k + 6) + u * load(point, k + 7)
        put(gradient, at, force)
        store(gradient, at + 3, turn)


@njit(**INLINE)
def _add_block(tables, scratch, law, span, row, i, j, at):
    """Add the second derivatives for the control points i and j of a span to a block at a row.

    It goes row by row: the four sums of one stay in registers.
    """
    point, work, band = scratch.point, scratch.line, scratch.band
    # The laws have the points' weights, which sum to the span's length.
    e = 3 * span
    stiff = load(law.bend, 3 * e + 2) + load(law.bend, 3 * e + 5) + load(law.bend, 3 * e + 8)
    turning = _four(work, TURN + 4 * j)
    for r in range(3):
        x, y, z, t = _four(band, at + 4 * r)
        for g in range(3):
            k, c, b = POINT * g + r, 4 * (3 * row + g), 4 * (e + g)
            uu, uv = entry(tables.products, c), entry(tables.products, c + 1)
            vu, vv = entry(tables.products, c + 2), entry(tables.products, c + 3)
            # Rows k + 2 r and on are those of this row of a matrix, rows k, k + 3 of its column.
            o = k + 2 * r
            x += uu * load(point, o + PP) + vv * load(point, o + SS)
            y += uu * load(point, o + PP + 1) + vv * load(point, o + SS + 1)
            z += uu * load(point, o + PP + 2) + vv * load(point, o + SS + 2)
            x += uv * load(point, o + PS) + vu * load(point, k + PS)
            y += uv * load(point, o + PS + 1) + vu * load(point, k + PS + 3)
            z += uv * load(point, o + PS + 2) + vu * load(point, k + PS + 6)
            w = entry(tables.b, b + j)
            u, v = w * entry(tables.b1, b + i), w * entry(tables.b2, b + i)
            t += u * load(point, k + P_THETA) + v * load(point, k + S_THETA)
        x, y, z, t = _plus((x, y, z, t), stiff * load(work, TURN + 4 * i + r), turning)
        _put_four(band, at + 4 * r, x, y, z, t)
    x, y, z, t = _four(band, at + 12)
    for g in range(3):
        k, b = POINT * g, 4 * (e + g)
        w = entry(tables.b, b + i)
        u, v = w * entry(tables.b1, b + j), w * entry(tables.b2, b + j)
        x += u * load(point, k + P_THETA) + v * load(point, k + S_THETA)
        y += u * load(point, k + P_THETA + 1) + v * load(point, k + S_THETA + 1)
        z += u * load(point, k + P_THETA + 2) + v * load(point, k + S_THETA + 2)
        t += (w * entry(tables.b, b + j)) * load(point, k + THETA)
    x, y, z, t = _plus((x, y, z, t), stiff * load(work, TURN + 4 * i + 3), turning)
    _put_four(band, at + 12, x, y, z, t)
    linear, twisted = entry(tables.linear, span), entry(tables.twist_linear, span)
    if somewhere(twisted):
        _add_square(band, at, twisted * stiff, work, TURN_TILT + 4 * i, TURN_TILT + 4 * j)
    if somewhere(linear):
        stiff = load(law.stretch, e) + load(law.stretch, e + 1) + load(law.stretch, e + 2)
        stiff *= linear
        _add_square(band, at, stiff, work, LINE + 4 * i, LINE + 4 * j)
        _add_square(band, at, stiff, work, LINE_TILT + 4 * i, LINE_TILT + 4 * j)


@njit(from_python=False, **FLAGS)
def _add_square(band, at, stiff, work, i, j):
    """Add stiff times four rows from row i on by four from row j on to a block."""
    four = _four(work, j)
    for r in range(4):
        x, y, z, t = _plus(_four(band, at + 4 * r), stiff * load(work, i + r), four)
        _put_four(band, at + 4 * r, x, y, z, t)


@njit(**INLINE)
def _four(array, at):
    """Four rows."""
    return load(array, at), load(array, at + 1), load(array, at + 2), load(array, at + 3)


@njit(**INLINE)
def _put_four(array, at, x, y, z, t):
    """Write four rows."""
    store(array, at, x)
    store(array, at + 1, y)
    store(array, at + 2, z)
    store(array, at + 3, t)


@njit(**INLINE)
def _plus(x, factor, a):
    return x[0] + factor * a[0], x[1] + factor * a[1], x[2] + factor * a[2], x[3] + factor * a[3]
