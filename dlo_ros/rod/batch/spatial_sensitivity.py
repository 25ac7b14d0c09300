# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities of one rod in space for eight parameters at once; see `simd_sensitivity`.

Formulas of the reference frame's derivatives: `elements.frame_derivatives`.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch.simd_kernels import span_stretch
from dlo_ros.rod.batch.spatial_kernels import BLOCKS
from dlo_ros.rod.batch.spatial_strains import get, line, put, slopes
from dlo_ros.rod.elements.strain_derivatives import first_at
from dlo_ros.rod.elements.strains import MIDDLE, carried, turned
from dlo_ros.rod.simd.eight_lanes import entry, load, store
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE, cross, dot, mix, mix3, times

# Rows of a point: tangent; derivatives of kappa_1, kappa_2 and twist by p and s; z, s, second
# director of the frame, 1 / |p| and w of `strain_derivatives`.
TANGENT, KAPPA1_P, KAPPA1_S, KAPPA2_P, KAPPA2_S, TWIST_P, TWIST_S = 0, 3, 6, 9, 12, 15, 18
Z, S, SECOND, R, W, GRADIENTS = 21, 24, 27, 30, 31, 32


@linked(**FLAGS)
def strain_gradients(q, tables, frame, bend, out):
    """Write the derivatives of the strains at every point, see `GRADIENTS`.

    Args:
        frame: reference frame before the step to q.
        bend: curvatures and twist of q, (3 nb, LANES).
    """
    for e in range(3 * tables.spans):
        p, s, theta, _ = slopes(q, tables, e)
        r, t0, director = 1.0 / np.sqrt(dot(p, p)), get(frame.tangent, 3 * e), get(
            frame.director, 3 * e
        )  # fmt: skip
        t = times(r, p)
        x = first_at(
            p, s, r, t, t0, get(frame.rate, 3 * e), turned(director, theta, t0, t),
            load(bend, 3 * e), load(bend, 3 * e + 1),
        )  # fmt: skip
        at = GRADIENTS * e
        put(out, at + TANGENT, t)
        put(out, at + KAPPA1_P, x.kappa1_p)
        put(out, at + KAPPA1_S, x.kappa1_s)
        put(out, at + KAPPA2_P, x.kappa2_p)
        put(out, at + KAPPA2_S, x.kappa2_s)
        put(out, at + TWIST_P, x.twist_p)
        put(out, at + TWIST_S, x.a)
        put(out, at + Z, x.z)
        put(out, at + S, s)
        put(out, at + SECOND, cross(t, carried(director, t0, t)))
        store(out, at + R, r)
        store(out, at + W, x.w)


@linked(**FLAGS)
def turn_frame(tables, frame, gradients, change, turn, work, span):
    """Change of the frame at the points of a span by that of the frame before the step, the shape
    held.

    Args:
        frame: reference frame before the step.
        change: derivatives of the frame.
        turn: output, angle [rad] by which the directors turn, then change of the frame's twist
            [rad/m], (2 nb, LANES).
        work: output, changes of the derivatives of the frame's twist by s and p, (18, LANES).
    """
    points = 3 * tables.spans
    for k in range(3):
        e = 3 * span + k
        at = GRADIENTS * e
        t, z, s, second = (get(gradients, at + TANGENT), get(gradients, at + Z),
                           get(gradients, at + S), get(gradients, at + SECOND))  # fmt: skip
        r, w = load(gradients, at + R), load(gradients, at + W)
        t0, rate, director = (get(frame.tangent, 3 * e), get(frame.rate, 3 * e),
                              get(frame.director, 3 * e))  # fmt: skip
        one = w / r  # 1 / (1 + t . t0)
        p, u, across, s_t0 = times(1.0 / r, t), mix(1.0, t, 1.0, t0), cross(t, t0), cross(s, t0)
        lag, bent, along = dot(p, z), dot(t, s_t0), dot(director, t) * one
        dt0, dd = get(change.tangent, 3 * e), get(change.director, 3 * e)
        closer = dot(t, dt0)
        tilted = (dot(dd, t) - along * closer) * one
        angle = dot(mix3(1.0, dd, -tilted, u, -along, dt0), second)
        dw = -w * one * closer
        dz = mix3(1.0, cross(dt0, rate), 1.0, cross(t0, get(change.rate, 3 * e)),
                  -r, cross(s, dt0))  # fmt: skip
        lagging = dot(p, dz)
        store(turn, e, angle)
        store(turn, points + e, load(change.twist, e) + dw * lag + w * lagging)
        put(work, 6 * k, mix(dw, across, w, cross(t, dt0)))
        put(work, 6 * k + 3, mix3(
            1.0, mix3(dw, z, w, dz, -w * (2.0 * dw * lag + w * lagging), u), -w * w * lag, dt0,
            r * (dw * bent + w * dot(t, cross(s, dt0))), t,
        ))  # fmt: skip


@linked(**FLAGS)
def subtract_stresses(
    sets, tables, rates, change, rate_weights, law, bend, frame, gradients, strains, work, turn,
    right,
):  # fmt: skip
    """Subtract the forces of the stresses' derivatives, the shape held, from `right`.

    Args:
        law: of the step, with damping.
        bend: curvatures and twist after the step, (3 nb, LANES).
        frame, work, turn: see `turn_frame`.
    """
    points, own, more = 3 * tables.spans, sets.law, rates.law
    t_r, slower = load(sets.relaxation_time, 0), load(rates.relaxation_time, 0)
    past, faster = t_r * rate_weights[1], t_r * rate_weights[2]
    pulls = 4 * points  # where the rates begin
    for span in range(tables.spans):
        turn_frame(tables, frame, gradients, change.frame, turn, work, span)
        linear, at = entry(tables.linear, span) > 0.0, points + 3 * span
        wound, tilt = line(load(turn, at), load(turn, at + 1), load(turn, at + 2),
                           entry(tables.twist_linear, span))  # fmt: skip
        for k in range(3):
            e = 3 * span + k
            at, b = GRADIENTS * e, 3 * e
            f1 = _stress(more, own, change, strains, points, slower, past, faster, b)
            f2 = _stress(more, own, change, strains, points, slower, past, faster, b + 1)
            f3 = _stress(more, own, change, strains, points, slower, past, faster, b + 2)
            kappa1, kappa2, angle = load(bend, b), load(bend, b + 1), load(turn, e)
            stiff1, stiff2, stiff3 = get(law.bend, b)
            bend1, bend2 = (stiff1 * (kappa1 - load(law.bend_rest, b)),
                            stiff2 * (kappa2 - load(law.bend_rest, b + 1)))  # fmt: skip
            torque = stiff3 * (load(bend, b + 2) - load(law.bend_rest, b + 2))
            f1 += (stiff1 * kappa2 - bend2) * angle
            f2 += (bend1 - stiff2 * kappa1) * angle
            f3 += stiff3 * (wound + float(k - 1) * tilt)
            da, dp = get(work, 6 * k), get(work, 6 * k + 3)
            slow = mix3(f1, get(gradients, at + KAPPA1_P), f2, get(gradients, at + KAPPA2_P),
                        f3, get(gradients, at + TWIST_P))  # fmt: skip
            slow = mix3(1.0, slow, bend1 * kappa2 - bend2 * kappa1, da, torque, dp)
            fast = mix3(f1, get(gradients, at + KAPPA1_S), f2, get(gradients, at + KAPPA2_S),
                        f3, get(gradients, at + TWIST_S))  # fmt: skip
            fast = mix(1.0, fast, torque, da)
            if linear or k == 1:
                pull = load(more.stretch, e) * load(strains, e) + load(own.stretch, e) * (
                    slower * load(strains, pulls + e) + past * load(change.stretch, e)
                    + faster * load(change.stretch_before, e) - load(more.stretch_rest, e)
                )  # fmt: skip
                if not linear:
                    pull *= 1.0 / MIDDLE
                slow = mix(1.0, slow, pull, get(gradients, at + TANGENT))
            around = f1 * kappa2 - f2 * kappa1
            for i in range(4):
                j, to = 4 * e + i, 4 * (span + i)
                w, u, v = entry(tables.b, j), entry(tables.b1, j), entry(tables.b2, j)
                put(right, to, mix3(1.0, get(right, to), -u, slow, -v, fast))
                store(right, to + 3, load(right, to + 3) - w * around - u * f3)


@njit(**INLINE)
def _stress(more, own, change, strains, points, slower, past, faster, b):
    """Derivative of a moment, the strains held."""
    return load(more.bend, b) * load(strains, points + b) + load(own.bend, b) * (
        slower * load(strains, 5 * points + b) + past * load(change.bend, b)
        + faster * load(change.bend_before, b) - load(more.bend_rest, b)
    )  # fmt: skip


@linked(**FLAGS)
def subtract_imposed(tables, band, increments, right):
    """Subtract the forces of what is imposed from `right`."""
    n = tables.n
    for k in range(4 * n):
        if entry(tables.fixed, k) == 0.0:
            continue
        j, c = k // 4, k % 4
        x = load(increments, k)
        for o in range(min(4, n - j)):
            for r in range(4):
                to = 4 * (j + o) + r
                at = BLOCKS * j + 16 * o + 4 * r + c
                store(right, to, load(right, to) - load(band, at) * x)
        for o in range(1, min(3, j) + 1):
            for r in range(4):
                to = 4 * (j - o) + r
                at = BLOCKS * (j - o) + 16 * o + 4 * c + r
                store(right, to, load(right, to) - load(band, at) * x)


@linked(**FLAGS)
def vary_strains(tables, frame, bend, gradients, turn, change, d_q):
    """Let the derivatives of strains and frame become those after a step.

    Args:
        frame, bend: reference frame, curvatures and twist after the step.
        gradients, turn: see `strain_gradients`, `turn_frame`.
        change: derivatives, of which these are changed.
        d_q: derivatives of the shape.
    """
    points = 3 * tables.spans
    for e in range(points):
        store(change.stretch_before, e, load(change.stretch, e))
        put(change.bend_before, 3 * e, get(change.bend, 3 * e))
        at = GRADIENTS * e
        dp, ds, theta, rate = slopes(d_q, tables, e)
        t, s, r = get(gradients, at + TANGENT), get(gradients, at + S), load(gradients, at + R)
        twist_p, axis = get(gradients, at + TWIST_P), get(gradients, at + TWIST_S)
        # Directors turn by theta and with the frame.
        angle, along, stretched = load(turn, e) + theta, dot(t, s), dot(t, dp)
        wound = load(turn, points + e) + dot(twist_p, dp) + dot(axis, ds)
        store(change.stretch, e, stretched)
        bent1 = dot(get(gradients, at + KAPPA1_P), dp) + dot(get(gradients, at + KAPPA1_S), ds)
        bent2 = dot(get(gradients, at + KAPPA2_P), dp) + dot(get(gradients, at + KAPPA2_S), ds)
        put(change.bend, 3 * e, (bent1 + load(bend, 3 * e + 1) * angle,
                                 bent2 - load(bend, 3 * e) * angle, wound + rate))  # fmt: skip
        longer = r * stretched
        dt = mix(r, dp, -longer, t)
        steeper = dot(dt, s) + dot(t, ds)
        put(change.frame.tangent, 3 * e, dt)
        put(change.frame.rate, 3 * e, mix(
            1.0, mix3(r, ds, -r * steeper, t, -r * along, dt), -longer, mix(r, s, -r * along, t)
        ))  # fmt: skip
        director = get(frame.director, 3 * e)
        put(change.frame.director, 3 * e, mix(
            load(turn, e) + dot(axis, dp), cross(t, director), -dot(director, dt), t
        ))  # fmt: skip
        store(change.frame.twist, e, wound)
        if e % 3 == 2:
            span = e // 3
            span_stretch(change.stretch, e - 2, entry(tables.linear, span) > 0.0)
            first = 3 * e - 4  # twist of the span's first point
            mean, tilt = line(
                load(change.bend, first), load(change.bend, first + 3),
                load(change.bend, first + 6),
                entry(tables.twist_linear, span),
            )  # fmt: skip
            store(change.bend, first, mean - tilt)
            store(change.bend, first + 3, mean)
            store(change.bend, first + 6, mean + tilt)
