# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Strains and reference frames of eight rods in space; formulas: `elements.strains`."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.strains import MIDDLE, OUTER, carried_twist, carry, curvatures, turned
from dlo_ros.rod.lanes.simd_kernels import Frame, span_stretch
from dlo_ros.rod.lanes.simd_tables import local_tables
from dlo_ros.rod.lanes.span_lanes import gather, scatter
from dlo_ros.rod.simd.eight_lanes import LANES, entry, load, row_address, store
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE, dot, mix, times


@njit(**INLINE)
def get(array, at):
    """Three rows as a vector."""
    return load(array, at), load(array, at + 1), load(array, at + 2)


@njit(**INLINE)
def put(array, at, vector):
    """Write three rows."""
    store(array, at, vector[0])
    store(array, at + 1, vector[1])
    store(array, at + 2, vector[2])


@njit(**INLINE)
def slopes(q, tables, e):
    """First and second derivative along u, theta and its derivative at point e."""
    at = 4 * (e // 3)
    w, u, v = entry(tables.b, 4 * e), entry(tables.b1, 4 * e), entry(tables.b2, 4 * e)
    x, angle = get(q, at), load(q, at + 3)
    p, s, theta, rate = times(u, x), times(v, x), w * angle, u * angle
    for i in range(1, 4):
        k = 4 * e + i
        w, u, v = entry(tables.b, k), entry(tables.b1, k), entry(tables.b2, k)
        x, angle = get(q, at + 4 * i), load(q, at + 4 * i + 3)
        p, s = mix(1.0, p, u, x), mix(1.0, s, v, x)
        theta += w * angle
        rate += u * angle
    return p, s, theta, rate


@linked(**FLAGS)
def gathered_rod(q, tables, frame, group):
    """Reference frame of a group's spans in lanes, and their control points in rows 0 to 15 of
    `SpanLanes.work`.
    """
    lanes, numbers = tables.together, tables.together.numbers
    carried = Frame(
        row_address(lanes.work, 52), row_address(lanes.work, 61), row_address(lanes.work, 70),
        row_address(lanes.work, 79),
    )  # fmt: skip
    gather(numbers, group, q, 4, 16, row_address(lanes.work, 0))
    gather(numbers, group, frame.tangent, 9, 9, carried.tangent)
    gather(numbers, group, frame.rate, 9, 9, carried.rate)
    gather(numbers, group, frame.director, 9, 9, carried.director)
    gather(numbers, group, frame.twist, 3, 3, carried.twist)
    return carried


@linked(**FLAGS)
def advance(q, tables, frame, stretch, other):
    """`advance_frame`; of one rod eight spans at a time."""
    lanes, numbers, points = tables.together, tables.together.numbers, 3 * tables.spans
    long, bent = row_address(lanes.work, 40), row_address(lanes.work, 43)
    for group in range(lanes.groups):
        spans, own = min(LANES, lanes.size - LANES * group), gathered_rod(q, tables, frame, group)
        advance_frame(row_address(lanes.work, 0), local_tables(tables, group), own, long, bent)
        scatter(numbers, group, spans, long, 3, 3, 0, points, stretch)
        scatter(numbers, group, spans, bent, 9, 9, 0, 3 * points, other)
        scatter(numbers, group, spans, own.tangent, 9, 9, 0, 3 * points, frame.tangent)
        scatter(numbers, group, spans, own.rate, 9, 9, 0, 3 * points, frame.rate)
        scatter(numbers, group, spans, own.director, 9, 9, 0, 3 * points, frame.director)
        scatter(numbers, group, spans, own.twist, 3, 3, 0, points, frame.twist)
    if lanes.groups == 0:
        advance_frame(q, tables, frame, stretch, other)


@linked(**FLAGS)
def advance_frame(q, tables, frame, stretch, other):
    """Write the strains of a configuration, and carry the reference frame to it.

    Args:
        stretch, other: output, stretch (nb, LANES) of whole spans; kappa_1, kappa_2 and twist, the
            twist of whole spans, (3 nb, LANES).
    """
    for e in range(3 * tables.spans):
        p, s, theta, rate = slopes(q, tables, e)
        n = np.sqrt(dot(p, p))
        t0, turning, director = (get(frame.tangent, 3 * e), get(frame.rate, 3 * e),
                                 get(frame.director, 3 * e))  # fmt: skip
        r = 1.0 / n
        t = times(r, p)
        kappa1, kappa2 = curvatures(s, r, t, turned(director, theta, t0, t))
        twist = load(frame.twist, e) + carried_twist(p, s, r, t0, turning)
        store(stretch, e, n - 1.0)
        put(other, 3 * e, (kappa1, kappa2, twist + rate))
        store(frame.twist, e, twist)
        put(frame.tangent, 3 * e, t)
        put(frame.rate, 3 * e, mix(r, s, -r * dot(t, s), t))
        put(frame.director, 3 * e, carry(director, t0, t))
        if e % 3 == 2:
            span = e // 3
            span_stretch(stretch, e - 2, entry(tables.linear, span))
            at = 3 * e - 4  # twist of the span's first point
            a, b, c = load(other, at), load(other, at + 3), load(other, at + 6)
            mean, tilt = line(a, b, c, entry(tables.twist_linear, span))
            store(other, at, mean - tilt)
            store(other, at + 3, mean)
            store(other, at + 6, mean + tilt)


@njit(**INLINE)
def line(a, b, c, tilted):
    """Mean of a span's three values, and the rise of their line, `tilted` (0 or 1) times."""
    mean, tilt = OUTER * (a + c) + MIDDLE * b, 0.5 * (c - a)
    return mean, tilted * tilt
