# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities of one rod in space for eight parameters at once; see `simd_sensitivity`.

Formulas of the reference frame's derivatives: `elements.frame_derivatives`. They are linear in the
derivatives of the frame before the step; their coefficients belong to the rod, whatever the
parameter, and are computed once for all of them, eight knot spans at a time.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch.stress_sensitivity import stress
from dlo_ros.rod.elements.strain_derivatives import first_at
from dlo_ros.rod.elements.strains import MIDDLE, carried, turned
from dlo_ros.rod.lanes.simd_kernels import gathered_law, span_stretch
from dlo_ros.rod.lanes.simd_tables import local_tables
from dlo_ros.rod.lanes.span_lanes import gather, scatter_numbers
from dlo_ros.rod.lanes.spatial_strains import gathered_rod, get, line, put, slopes
from dlo_ros.rod.simd.eight_lanes import entry, load, row_address, store
from dlo_ros.rod.simd.vector_algebra import (
    FLAGS,
    INLINE,
    add_cross,
    add_diagonal,
    add_outer,
    cross,
    dot,
    mix,
    mix3,
    outer,
    times,
)  # fmt: skip

# Numbers of a point: tangent; derivatives of kappa_1, kappa_2 and twist by p and s.
TANGENT, KAPPA1_P, KAPPA1_S, KAPPA2_P, KAPPA2_S, TWIST_P, TWIST_S = 0, 3, 6, 9, 12, 15, 18
# Derivatives by the tangent of the frame before the step, by the rate of that tangent (the names
# end in T, R) and by its director (D), the shape held: of the angle by which the frame turns, of
# its twist, and of the forces on p and s.
ANGLE_D, ANGLE_T, TWIST_T, TWIST_R, SLOW_T, SLOW_R, FAST_T = 21, 24, 27, 30, 33, 42, 51
# s, derivative of the tangent by u, director and second director; kappa_1, kappa_2; derivatives of
# the three moments by that angle, or by the frame's twist; 1 / |p|, t . s.
S, RATE, DIRECTOR, SECOND, KAPPA, MOMENTS, R, ALONG, GRADIENTS = 60, 63, 66, 69, 72, 74, 77, 78, 79
ROOM = 82  # rows of `SpanLanes.work` from which on there is room for a group's numbers


@linked(**FLAGS)
def strain_gradients(q, tables, frame, law, bend, out):
    """Write the numbers of every point, see `TANGENT`.

    Args:
        frame: reference frame before the step to q.
        law: of the step, with damping.
        bend: curvatures and twist of q, (3 nb, LANES).
        out: output, (GRADIENTS nb,).
    """
    lanes, numbers = tables.together, tables.together.numbers
    bent, room = row_address(lanes.work, 43), row_address(lanes.work, ROOM)
    for group in range(lanes.groups):
        before = gathered_rod(q, tables, frame, group)
        own = gathered_law(lanes, group, law, 16, 9)
        gather(numbers, group, bend, 9, 9, bent)
        local = local_tables(tables, group)
        for k in range(3):
            _point(row_address(lanes.work, 0), local, before, own, bent, k,
                   row_address(lanes.work, ROOM + GRADIENTS * k))  # fmt: skip
        scatter_numbers(numbers, group, lanes.size, room, 3 * GRADIENTS, out)


@njit(from_python=False, **FLAGS)
def _point(q, tables, frame, law, bend, k, out):
    """Write the numbers of point k of a group's spans to rows."""
    p, s, theta, _ = slopes(q, tables, k)
    t0, rate, before = (get(frame.tangent, 3 * k), get(frame.rate, 3 * k),
                        get(frame.director, 3 * k))  # fmt: skip
    r = 1.0 / np.sqrt(dot(p, p))
    t, (kappa1, kappa2, twist) = times(r, p), get(bend, 3 * k)
    x = first_at(p, s, r, t, t0, rate, turned(before, theta, t0, t), kappa1, kappa2)
    put(out, TANGENT, t)
    put(out, KAPPA1_P, x.kappa1_p)
    put(out, KAPPA1_S, x.kappa1_s)
    put(out, KAPPA2_P, x.kappa2_p)
    put(out, KAPPA2_S, x.kappa2_s)
    put(out, TWIST_P, x.twist_p)
    put(out, TWIST_S, x.a)
    director, w = carried(before, t0, t), x.w
    second, u, s_t0 = cross(t, director), mix(1.0, t, 1.0, t0), cross(s, t0)
    one = w / r  # 1 / (1 + t . t0)
    tipped = times(one * dot(u, second), t)
    put(out, ANGLE_D, mix(1.0, second, -1.0, tipped))
    put(out, ANGLE_T, times(dot(before, t) * one, mix(1.0, tipped, -1.0, second)))
    # Changes by the tangent: of w (`shorter`) and of p . z (`lagging`).
    shorter, lag = times(-w * one, t), dot(p, x.z)
    lagging, lagging_r = mix(1.0, cross(rate, p), -r, cross(p, s)), cross(p, t0)
    put(out, TWIST_T, mix(lag, shorter, w, lagging))
    put(out, TWIST_R, times(w, lagging_r))
    by_s = add_cross(outer(cross(t, t0), shorter), times(-w, t))
    by_p = add_outer(outer(x.z, shorter), u, mix(-2.0 * w * lag, shorter, -w * w, lagging))
    by_p = add_outer(by_p, t, mix(r * dot(t, s_t0), shorter, r * w, cross(t, s)))
    by_p = add_cross(add_diagonal(by_p, -w * w * lag), times(w, mix(1.0, rate, r, s)))
    by_p_r = add_cross(outer(times(-w * w, u), lagging_r), times(-w, t0))
    stiff1, stiff2, stiff3 = get(law.bend, 3 * k)
    rest1, rest2, rest3 = get(law.bend_rest, 3 * k)
    bend1, bend2, torque = stiff1 * (kappa1 - rest1), stiff2 * (kappa2 - rest2), twist - rest3
    torque *= stiff3
    around = bend1 * kappa2 - bend2 * kappa1
    for c in range(3):
        put(out, SLOW_T + 3 * c, mix(around, by_s[c], torque, by_p[c]))
        put(out, SLOW_R + 3 * c, times(torque, by_p_r[c]))
        put(out, FAST_T + 3 * c, times(torque, by_s[c]))
    along = dot(t, s)
    put(out, S, s)
    put(out, RATE, mix(r, s, -r * along, t))
    put(out, DIRECTOR, director)
    put(out, SECOND, second)
    store(out, KAPPA, kappa1)
    store(out, KAPPA + 1, kappa2)
    put(out, MOMENTS, (stiff1 * kappa2 - bend2, bend1 - stiff2 * kappa1, stiff3))
    store(out, R, r)
    store(out, ALONG, along)


@njit(**INLINE)
def _three(numbers, at):
    """Three numbers as a vector in space."""
    return entry(numbers, at), entry(numbers, at + 1), entry(numbers, at + 2)


@njit(**INLINE)
def _add_product(a, numbers, at, b):
    """The vector a + M b of a matrix whose rows begin at number `at`."""
    return (
        a[0] + dot(_three(numbers, at), b),
        a[1] + dot(_three(numbers, at + 3), b),
        a[2] + dot(_three(numbers, at + 6), b),
    )


@linked(**FLAGS)
def subtract_stresses(tables, rates, change, pace, gradients, stresses, turn, right):
    """Subtract the forces of the stresses' derivatives, the shape held, from `right`.

    Args:
        rates, change: derivatives of the rod's numbers and of its state before the step.
        pace, stresses: see `stress_sensitivity.stress`.
        gradients: see `strain_gradients`.
        turn: output, angle [rad] by which the directors turn with the frame before the step, the
            shape held, then change of the frame's twist [rad/m], (2 nb, LANES).
    """
    points, more, frame = 3 * tables.spans, rates.law, change.frame
    for span in range(tables.spans):
        for e in range(3 * span, 3 * span + 3):
            at = GRADIENTS * e
            dt, dr = get(frame.tangent, 3 * e), get(frame.rate, 3 * e)
            angle = dot(_three(gradients, at + ANGLE_T), dt)
            store(turn, e, angle + dot(_three(gradients, at + ANGLE_D), get(frame.director, 3 * e)))
            wound = load(frame.twist, e) + dot(_three(gradients, at + TWIST_T), dt)
            store(turn, points + e, wound + dot(_three(gradients, at + TWIST_R), dr))
        linear, at = entry(tables.linear, span) > 0.0, points + 3 * span
        wound, tilt = line(load(turn, at), load(turn, at + 1), load(turn, at + 2),
                           entry(tables.twist_linear, span))  # fmt: skip
        for k in range(3):
            e = 3 * span + k
            at, b = GRADIENTS * e, 3 * e
            bends = more.bend, more.bend_rest, change.bend, change.bend_before
            f1 = stress(bends, b, stresses, points + b, pace)
            f2 = stress(bends, b + 1, stresses, points + b + 1, pace)
            f3 = stress(bends, b + 2, stresses, points + b + 2, pace)
            by_angle, angle = _three(gradients, at + MOMENTS), load(turn, e)
            f1 += by_angle[0] * angle
            f2 += by_angle[1] * angle
            f3 += by_angle[2] * (wound + float(k - 1) * tilt)
            dt, dr = get(frame.tangent, b), get(frame.rate, b)
            slow = mix3(f1, _three(gradients, at + KAPPA1_P), f2, _three(gradients, at + KAPPA2_P),
                        f3, _three(gradients, at + TWIST_P))  # fmt: skip
            slow = _add_product(_add_product(slow, gradients, at + SLOW_T, dt), gradients,
                                at + SLOW_R, dr)  # fmt: skip
            fast = mix3(f1, _three(gradients, at + KAPPA1_S), f2, _three(gradients, at + KAPPA2_S),
                        f3, _three(gradients, at + TWIST_S))  # fmt: skip
            fast = _add_product(fast, gradients, at + FAST_T, dt)
            if linear or k == 1:
                pull = stress((more.stretch, more.stretch_rest, change.stretch,
                               change.stretch_before), e, stresses, e, pace)  # fmt: skip
                if not linear:
                    pull *= 1.0 / MIDDLE
                slow = mix(1.0, slow, pull, _three(gradients, at + TANGENT))
            around = f1 * entry(gradients, at + KAPPA + 1) - f2 * entry(gradients, at + KAPPA)
            for i in range(4):
                j, to = 4 * e + i, 4 * (span + i)
                w, u, v = entry(tables.b, j), entry(tables.b1, j), entry(tables.b2, j)
                put(right, to, mix3(1.0, get(right, to), -u, slow, -v, fast))
                store(right, to + 3, load(right, to + 3) - w * around - u * f3)


@linked(**FLAGS)
def vary_strains(tables, gradients, turn, change, d_q):
    """Let the derivatives of strains and frame become those after a step.

    Args:
        gradients, turn: see `strain_gradients`, `subtract_stresses`.
        change: derivatives, of which these are changed.
        d_q: derivatives of the shape.
    """
    points = 3 * tables.spans
    for e in range(points):
        store(change.stretch_before, e, load(change.stretch, e))
        put(change.bend_before, 3 * e, get(change.bend, 3 * e))
        at = GRADIENTS * e
        dp, ds, theta, rate = slopes(d_q, tables, e)
        t, s, r = (_three(gradients, at + TANGENT), _three(gradients, at + S),
                   entry(gradients, at + R))  # fmt: skip
        axis = _three(gradients, at + TWIST_S)
        # Directors turn by theta and with the frame.
        angle, stretched = load(turn, e) + theta, dot(t, dp)
        wound = load(turn, points + e) + dot(_three(gradients, at + TWIST_P), dp) + dot(axis, ds)
        store(change.stretch, e, stretched)
        bent1 = dot(_three(gradients, at + KAPPA1_P), dp)
        bent1 += dot(_three(gradients, at + KAPPA1_S), ds)
        bent2 = dot(_three(gradients, at + KAPPA2_P), dp)
        bent2 += dot(_three(gradients, at + KAPPA2_S), ds)
        put(change.bend, 3 * e, (bent1 + entry(gradients, at + KAPPA + 1) * angle,
                                 bent2 - entry(gradients, at + KAPPA) * angle,
                                 wound + rate))  # fmt: skip
        longer = r * stretched
        dt = mix(r, dp, -longer, t)
        steeper = dot(dt, s) + dot(t, ds)
        put(change.frame.tangent, 3 * e, dt)
        put(change.frame.rate, 3 * e, mix(
            1.0, mix3(r, ds, -r * steeper, t, -r * entry(gradients, at + ALONG), dt),
            -longer, _three(gradients, at + RATE),
        ))  # fmt: skip
        put(change.frame.director, 3 * e, mix(
            load(turn, e) + dot(axis, dp), _three(gradients, at + SECOND),
            -dot(_three(gradients, at + DIRECTOR), dt), t,
        ))  # fmt: skip
        store(change.frame.twist, e, wound)
        if e % 3 == 2:
            span = e // 3
            span_stretch(change.stretch, e - 2, entry(tables.linear, span))
            first = 3 * e - 4  # twist of the span's first point
            mean, tilt = line(
                load(change.bend, first), load(change.bend, first + 3),
                load(change.bend, first + 6),
                entry(tables.twist_linear, span),
            )  # fmt: skip
            store(change.bend, first, mean - tilt)
            store(change.bend, first + 3, mean)
            store(change.bend, first + 6, mean + tilt)
