# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of strains and forces by the reference frame of the rod in space.

A shape q is held; the frame before, from which the one at q is carried, changes by small dt0, dt0',
dd and a change of its twist. Then the directors at q turn about the tangent t by

    turn = d2 . d(carried director)

so that d kappa_1 = kappa_2 turn, d kappa_2 = -kappa_1 turn, and every derivative of kappa_1 by the
shape changes by turn times that of kappa_2, and the other way round. Beyond that only a and the
twist w p . z of the frame contain t0 and t0' (names as in `strain_derivatives`):

    dw = -w^2 n t . dt0        da = dw t x t0 + w t x dt0
    dz = dt0 x t0' + t0 x dt0' - s x dt0 / n

With these the change of the forces is written out; it costs no second evaluation of the rod.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.element_stiffness import FIRST, add_forces
from dlo_ros.rod.elements.rod_tables import DOF
from dlo_ros.rod.elements.spatial_assembly import by_p, by_s, derive_all, stress_at
from dlo_ros.rod.elements.strain_derivatives import first
from dlo_ros.rod.elements.strains import (
    carried,
    column,
    put,
    slopes,
    span_twist,
    three,
    vectors,
)  # fmt: skip
from dlo_ros.rod.simd.four_lanes import lane
from dlo_ros.rod.simd.vector_algebra import FLAGS, cross, dot, mix, mix3, times


@linked(**FLAGS)
def vary_frame(q, rule, ref, change, other, response, turn, twist, forces):
    """Strains and forces that a change of the frame before causes, the shape held.

    Args:
        q: configuration, shape (n, 4).
        rule, ref: tables, reference frame from which that at q is carried.
        change: derivatives of the frame by P parameters, a `Reference` with a leading axis.
        other: bending and twist of q, shape (nb, 3).
        response: stresses and tangents that belong to the strains of q.
        turn: output, angle [rad] by which the directors at q turn, shape (P, nb).
        twist: output, change of the twist of the frame at q [rad/m], shape (P, nb).
        forces: forces (P, 4 n) to which those of the change are added.
    """
    line, own = np.empty(3), np.empty(FIRST)
    for k in range(rule.weight.size // 3):
        e = 3 * k
        kappa1, kappa2 = column(other, e, 0), column(other, e, 1)
        f, x = stress_at(response, rule, e), first(q, rule, ref, e, kappa1, kappa2)
        stiff = three(rule.weight, e) * three(response.twist_tangent, e)
        rate, director = vectors(ref.rate, e), vectors(ref.director, e)
        t, t0, one = x.t, x.t0, x.w / x.r  # one: 1 / (1 + t . t0)
        p, s_t0, u, across = times(1.0 / x.r, t), cross(x.s, t0), mix(1.0, t, 1.0, t0), cross(t, t0)
        lag, bent, along = dot(p, x.z), dot(t, s_t0), dot(director, t) * one
        second = cross(t, carried(director, t0, t))
        turning = f.bend1 * kappa2 - f.bend2 * kappa1
        for a in range(turn.shape[0]):
            dt0, dd = vectors(change.tangent[a], e), vectors(change.director[a], e)
            closer = dot(t, dt0)
            tilted = (dot(dd, t) - along * closer) * one
            angle = dot(mix3(1.0, dd, -tilted, u, -along, dt0), second)
            dw = -x.w * one * closer
            dz = mix3(
                1.0, cross(dt0, rate), 1.0, cross(t0, vectors(change.rate[a], e)),
                -x.r, cross(x.s, dt0),
            )  # fmt: skip
            lagging = dot(p, dz)
            wound = three(change.twist[a], e) + dw * lag + x.w * lagging
            for point in range(3):
                turn[a, e + point], line[point] = lane(angle, point), lane(wound, point)
                twist[a, e + point] = line[point]
            span_twist(line, rule.twist_linear[k])
            # Changes of the stresses, and of the derivatives of the frame's twist by s and p.
            d1, d2 = kappa2 * angle, -kappa1 * angle
            m1 = f.t11 * d1 + f.t12 * d2 - f.bend2 * angle
            m2 = f.t12 * d1 + f.t22 * d2 + f.bend1 * angle
            torque = stiff * three(line, 0)
            da = mix(dw, across, x.w, cross(t, dt0))
            dp = mix3(
                1.0, mix3(dw, x.z, x.w, dz, -x.w * (2.0 * dw * lag + x.w * lagging), u),
                -x.w * x.w * lag, dt0,
                x.r * (dw * bent + x.w * dot(t, cross(x.s, dt0))), t,
            )  # fmt: skip
            slow = mix3(m1, x.kappa1_p, m2, x.kappa2_p, torque, x.twist_p)
            fast = mix3(m1, x.kappa1_s, m2, x.kappa2_s, torque, x.a)
            derive_all(
                own, 0, mix3(1.0, slow, turning, da, f.torque, dp),
                mix(1.0, fast, f.torque, da), m1 * kappa2 - m2 * kappa1, torque, rule, e,
            )  # fmt: skip
            add_forces(own, DOF, rule.span[e], forces[a])


@linked(**FLAGS)
def vary_carried_frame(q, rule, ref, d_q, grad_other, turn, twist, change):
    """Derivatives of the frame carried to q, from those of the shape and of the frame before.

    Args:
        q: configuration, shape (n, 4).
        rule, ref: tables, reference frame at q.
        d_q: derivatives of the shape by P parameters, shape (P, n, 4).
        grad_other: derivatives of the strains, see `spatial_assembly.assemble`.
        turn, twist: see `vary_frame`.
        change: output, a `Reference` with a leading axis of P.
    """
    for e in range(0, rule.weight.size - 2, 3):
        p, s = slopes(q, rule, e)
        r = 1.0 / np.sqrt(dot(p, p))
        t, director = times(r, p), vectors(ref.director, e)
        along, second = dot(t, s), cross(t, director)
        rate, axis = mix(r, s, -r * along, t), by_s(grad_other, e, 2)
        for a in range(turn.shape[0]):
            dp, ds = slopes(d_q[a], rule, e)
            longer = r * dot(t, dp)
            dt = mix(r, dp, -longer, t)
            steeper = dot(dt, s) + dot(t, ds)
            put(change.tangent[a], e, dt)
            put(
                change.rate[a], e,
                mix(1.0, mix3(r, ds, -r * steeper, t, -r * along, dt), -longer, rate),
            )  # fmt: skip
            angle = three(turn[a], e) + dot(axis, dp)
            wound = three(twist[a], e) + dot(by_p(grad_other, e, 2), dp) + dot(axis, ds)
            put(change.director[a], e, mix(angle, second, -dot(director, dt), t))
            for point in range(3):
                change.twist[a, e + point] = lane(wound, point)
