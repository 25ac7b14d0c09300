# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives of the strains of the rod in space, by p = r', s = r'' and theta.

All is written for one point; its numbers are `four_lanes`, the three points of a knot span, or
`eight_lanes`, the same point of eight rods.

The rotation that takes the reference tangent t0 to the present tangent t turns the directors about
t by an angle whose change depends on the path, by a . dp. So a curvature depends on p as if the
reference tangent were t itself, where most terms vanish, and moreover as it depends on theta, with
d theta = a . dp. With n = |p| and material directors d1, d2 at t:

    a = t x t0 / (n (1 + t . t0))
    d kappa_1 = ( (t.s) d2 / n^3 - 2 kappa_1 t / n) . dp - d2 / n^2 . ds + kappa_2 (dtheta + a . dp)
    d kappa_2 = (-(t.s) d1 / n^3 - 2 kappa_2 t / n) . dp + d1 / n^2 . ds - kappa_1 (dtheta + a . dp)

The twist of the frame is w p . z, with w = 1 / (n (1 + t . t0)) and z = t0 x t0' - s x t0 / n; it
depends on s by a. Second derivatives are sums of products of these few vectors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.rod.elements.strains import material_director, slopes, vectors
from dlo_ros.rod.simd.vector_algebra import (
    INLINE,
    add_both,
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

Number = Any  # a vector of numbers
Vector = tuple[Number, Number, Number]


class FirstDerivatives(NamedTuple):
    """First derivatives of the strains by p and s, and what the second ones need.

    The stretch has the derivative t by p; kappa_1 and kappa_2 have kappa_2 and -kappa_1 by theta.
    """

    r: Number  # 1 / |p|
    t: Vector
    s: Vector
    t0: Vector
    d1: Vector
    d2: Vector
    a: Vector  # also the derivative of the twist by s
    w: Number
    z: Vector
    kappa1_p: Vector
    kappa1_s: Vector
    kappa2_p: Vector
    kappa2_s: Vector
    twist_p: Vector


class Stress(NamedTuple):
    """Stress resultants at a point and the tangents of bending, times the point's weight."""

    tension: Number
    bend1: Number
    bend2: Number
    torque: Number
    t11: Number
    t12: Number
    t22: Number
    pull: Number


class SecondDerivatives(NamedTuple):
    """Second derivatives of a point's energy, without the squares of stretch and twist."""

    pp: tuple[Vector, Vector, Vector]  # rows
    ps: tuple[Vector, Vector, Vector]  # rows by p
    ss: tuple[Vector, Vector, Vector]
    p_theta: Vector
    s_theta: Vector
    theta: Number


@njit(**INLINE)
def first(q, rule, ref, e, kappa1, kappa2):
    """First derivatives of the strains in the span of points e, e + 1, e + 2.

    kappa1, kappa2 are the curvatures there.
    """
    p, s = slopes(q, rule, e)
    r, t0 = 1.0 / np.sqrt(dot(p, p)), vectors(ref.tangent, e)
    t = times(r, p)
    d1 = material_director(q, rule, ref, e, t0, t)
    return first_at(p, s, r, t, t0, vectors(ref.rate, e), d1, kappa1, kappa2)


@njit(**INLINE)
def first_at(p, s, r, t, t0, rate, d1, kappa1, kappa2):
    """First derivatives of the strains at a point.

    Args:
        p, s, r, t: r', r'', 1 / |p|, tangent.
        t0, rate: tangent of the reference frame and its derivative along u.
        d1: first material director.
        kappa1, kappa2: curvatures.
    """
    d2 = cross(t, d1)
    w = r / (1.0 + dot(t, t0))
    a = times(w, cross(t, t0))
    s_t0 = cross(s, t0)
    z = mix(1.0, cross(t0, rate), -r, s_t0)
    bent, squeezed = dot(s, t) * r * r * r, -2.0 * r
    return FirstDerivatives(
        r, t, s, t0, d1, d2, a, w, z,
        mix3(bent, d2, squeezed * kappa1, t, kappa2, a), times(-r * r, d2),
        mix3(-bent, d1, squeezed * kappa2, t, -kappa1, a), times(r * r, d1),
        mix3(w, z, -w * w * dot(p, z), mix(1.0, t, 1.0, t0), w * r * dot(t, s_t0), t),
    )  # fmt: skip


@njit(**INLINE)
def second(x, kappa1, kappa2, f):
    """Second derivatives at a point with first derivatives x under the stress f."""
    r, r2, t, t0, a, w = x.r, x.r * x.r, x.t, x.t0, x.a, x.w
    bent = dot(x.s, t) * r2 * r
    v, across = mix(f.bend1, x.d1, f.bend2, x.d2), mix(f.bend1, x.d2, -f.bend2, x.d1)
    work = f.bend1 * kappa1 + f.bend2 * kappa2
    turning = f.bend1 * kappa2 - f.bend2 * kappa1  # derivative of the work by theta
    u, s_t0, m = mix(1.0, t, 1.0, t0), cross(x.s, t0), f.torque * w
    c, lag = dot(t, s_t0) * r, dot(t, x.z) * w / r  # (p x s) . t0 / n^2, twist of the frame
    # How the moments change with p, s and theta by the bending stiffness.
    m1_p, m1_s = (mix(f.t11, x.kappa1_p, f.t12, x.kappa2_p),
                  mix(f.t11, x.kappa1_s, f.t12, x.kappa2_s))  # fmt: skip
    m2_p, m2_s = (mix(f.t12, x.kappa1_p, f.t22, x.kappa2_p),
                  mix(f.t12, x.kappa1_s, f.t22, x.kappa2_s))  # fmt: skip
    m1_theta, m2_theta = f.t11 * kappa2 - f.t12 * kappa1, f.t12 * kappa2 - f.t22 * kappa1

    # By p twice: symmetric products of t, u, a and v with these, and a multiple of the unit matrix.
    pull = f.pull * r
    by_t = mix3(
        -3.0 * bent * r, across,
        4.5 * work * r2 + 0.5 * (m * r * (lag - 3.0 * c) - pull), t,
        m * r2, s_t0,
    )  # fmt: skip
    by_u = mix(-m * w, mix3(1.0, x.z, c, t, -lag, u), -0.5 * turning * w, a)
    by_a = mix3(-bent, v, -2.5 * turning * r, t, -0.5 * work, a)
    by_v = mix(0.5 * r2 * kappa1, x.d1, 0.5 * r2 * kappa2, x.d2)
    alike = -3.0 * work * r2 + pull + m * r * (c - lag)

    # By p and s: products of t, across, a, u with these, and an antisymmetric matrix.
    of_t, of_across = mix(2.0 * r2 * r, across, -f.torque * r, a), times(r2 * r, t)
    of_a, of_u, n = times(r2, v), times(-m, a), times(-m * r, t0)

    pp = add_both(add_both(outer(x.kappa1_p, m1_p), t, by_t), u, by_u)
    pp = add_both(add_both(add_outer(pp, x.kappa2_p, m2_p), a, by_a), v, by_v)
    ps = add_outer(add_outer(outer(x.kappa1_p, m1_s), t, of_t), u, of_u)
    ps = add_outer(add_outer(add_outer(ps, x.kappa2_p, m2_s), a, of_a), across, of_across)
    p_theta = mix3(1.0, mix3(-bent, v, -2.0 * turning * r, t, -work, a),
                   m1_theta, x.kappa1_p, m2_theta, x.kappa2_p)  # fmt: skip
    return SecondDerivatives(
        add_diagonal(pp, alike),
        add_cross(ps, n),
        add_outer(outer(x.kappa1_s, m1_s), x.kappa2_s, m2_s),
        p_theta,
        mix3(r2, v, m1_theta, x.kappa1_s, m2_theta, x.kappa2_s),
        kappa2 * m1_theta - kappa1 * m2_theta - work,
    )
