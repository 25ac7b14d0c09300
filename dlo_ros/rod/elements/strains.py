# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled strains and reference frame of the spline rod in space.

A configuration is q of shape (n, 4): x, y, z [m] and theta [rad] of the control points. At a
quadrature point p = r' and s = r'' are linear in q, and four strains are defined (paper, eq. (7),
read as physics.md asks):

    stretch   |p| - 1
    bending   kappa_1, kappa_2: curvature vector (p x s) / |p|^3 in the material frame
    twist     theta' + twist of the reference frame

The reference frame is carried along in time without spin (it is parallel-transported from the
last accepted configuration to the present one), so it is defined for straight rods, its twist is
a local and exact function of p and s, and the rate of theta is the true axial spin. With t0 the
reference tangent, t0' its derivative, and t the present tangent, the rotation that takes t0 to t
the short way changes the twist by

    (t x t0) . (t0' + t') / (1 + t . t0)

which is the rate at which the geodesic from t0 to t sweeps area on the unit sphere.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.rod_tables import Reference
from dlo_ros.rod.simd.four_lanes import lane, quad
from dlo_ros.rod.simd.vector_algebra import (
    FLAGS,
    INLINE,
    cos_sin,
    cross,
    dot,
    mix,
    mix3,
    row,
    times,
    unit,
)  # fmt: skip

OUTER = 5.0 / 18.0  # weights of the three Gauss points in a mean
MIDDLE = 8.0 / 18.0


@njit(from_python=False, **FLAGS)
def span_line(x):
    """Replace values at a span's three points by the straight line that fits them best."""
    # Least squares with the quadrature's weights, so that this is its own adjoint.
    mean, tilt = OUTER * (x[0] + x[2]) + MIDDLE * x[1], 0.5 * (x[2] - x[0])
    x[0], x[1], x[2] = mean - tilt, mean, mean + tilt


@njit(from_python=False, **FLAGS)
def span_stretch(x, linear):
    """Stretch of a span from its values at the three points: the middle one, or a line."""
    if linear:
        span_line(x)
    else:
        x[0], x[2] = x[1], x[1]


@njit(**FLAGS)
def span_twist(x, linear):
    """Twist of a span from its values at the three points: their mean, or a line."""
    if linear:
        span_line(x)
    else:
        x[:] = OUTER * (x[0] + x[2]) + MIDDLE * x[1]


@njit(**INLINE)
def three(x, e):
    """Values at points e, e + 1, e + 2."""
    return quad(x[e], x[e + 1], x[e + 2])


@njit(**INLINE)
def column(x, e, c):
    """Column c of an array at points e, e + 1, e + 2."""
    return quad(x[e, c], x[e + 1, c], x[e + 2, c])


@njit(**INLINE)
def vectors(x, e):
    """Vectors of an array (nb, 3) at points e, e + 1, e + 2."""
    return column(x, e, 0), column(x, e, 1), column(x, e, 2)


@njit(**INLINE)
def tension_share(linear):
    """Share of a span's tension that acts at its points: the adjoint of `span_stretch`."""
    if linear:
        return quad(1.0, 1.0, 1.0)
    return quad(0.0, 1.0 / MIDDLE, 0.0)


@njit(**INLINE)
def slopes(q, rule, e):
    """Slopes p = r' and s = r'' at the points of the span that begins with point e."""
    span = rule.span[e]
    x = row(q, span)
    p, s = times(column(rule.b1, e, 0), x), times(column(rule.b2, e, 0), x)
    for i in range(1, 4):
        x = row(q, span + i)
        p = mix(1.0, p, column(rule.b1, e, i), x)
        s = mix(1.0, s, column(rule.b2, e, i), x)
    return p, s


@njit(**INLINE)
def angle(q, rule, b, e):
    """Theta at the points of a span, or its derivative with b of the basis' derivatives."""
    span = rule.span[e]
    theta = column(b, e, 0) * q[span, 3]
    for i in range(1, 4):
        theta += column(b, e, i) * q[span + i, 3]
    return theta


@njit(**INLINE)
def material_director(q, rule, ref, e, t0, t):
    """First material director at the points of a span, normal to the present tangent t."""
    return turned(vectors(ref.director, e), angle(q, rule, rule.b, e), t0, t)


@njit(**INLINE)
def turned(director, theta, t0, t):
    """The material director that a reference director becomes by theta and a carriage to t."""
    cos, sin = cos_sin(theta)
    return carried(mix(cos, director, sin, cross(t0, director)), t0, t)


@njit(**INLINE)
def curvatures(s, r, t, d1):
    """Curvature vector t x s r^2 along the directors d1 and d2 = t x d1."""
    return dot(cross(t, s), d1) * (r * r), dot(s, d1) * (r * r)


@njit(**INLINE)
def carried(director, t0, t):
    """A director that is rotated the short way from tangent t0 to tangent t."""
    f = dot(director, t) / (1.0 + dot(t0, t))
    return mix3(1.0, director, -f, t, -f, t0)


@njit(**INLINE)
def carried_twist(p, s, r, t0, rate):
    """Twist [rad/m] that the shortest rotation from t0 to t = p r adds to the frame."""
    return dot(p, mix(1.0, cross(t0, rate), -r, cross(s, t0))) * r / (1.0 + r * dot(p, t0))


@njit(**INLINE)
def put(array, e, a):
    """Write vectors at points e, e + 1, e + 2 to an array (nb, 3)."""
    for point in range(3):
        for c, x in enumerate(a):
            array[e + point, c] = lane(x, point)


@linked(from_python=True, **FLAGS)
def strains(q, rule, ref):
    """All strains of a configuration.

    Returns:
        Stretch (nb,), and bending and twist in the columns of (nb, 3); stretch and twist are those
        of whole spans, see `Quadrature`.
    """
    nb = rule.weight.size
    stretch, other = np.empty(nb), np.empty((nb, 3))
    for e in range(0, nb - 2, 3):
        p, s = slopes(q, rule, e)
        n, t0 = np.sqrt(dot(p, p)), vectors(ref.tangent, e)
        r = 1.0 / n
        t = times(r, p)
        d1 = material_director(q, rule, ref, e, t0, t)
        kappa1, kappa2 = curvatures(s, r, t, d1)
        twist = angle(q, rule, rule.b1, e) + three(ref.twist, e)
        twist += carried_twist(p, s, r, t0, vectors(ref.rate, e))
        put(other, e, (kappa1, kappa2, twist))
        for point in range(3):
            stretch[e + point] = lane(n, point) - 1.0
    for k in range(nb // 3):
        span_stretch(stretch[3 * k : 3 * k + 3], rule.stretch_linear[k])
        span_twist(other[3 * k : 3 * k + 3, 2], rule.twist_linear[k])
    return stretch, other


@linked(**FLAGS)
def transport(q, rule, ref):
    """The reference frame carried to configuration q; the strains of q do not change by it."""
    nb = rule.weight.size
    tangent, rate = np.empty((nb, 3)), np.empty((nb, 3))
    director, twist = np.empty((nb, 3)), np.empty(nb)
    for e in range(0, nb - 2, 3):
        p, s = slopes(q, rule, e)
        r, t0 = 1.0 / np.sqrt(dot(p, p)), vectors(ref.tangent, e)
        t = times(r, p)
        added = carried_twist(p, s, r, t0, vectors(ref.rate, e))
        for point in range(3):
            twist[e + point] = ref.twist[e + point] + lane(added, point)
        put(tangent, e, t)
        put(rate, e, mix(r, s, -r * dot(t, s), t))
        put(director, e, _clean(carried(vectors(ref.director, e), t0, t), t))
    return Reference(tangent, rate, director, twist)


@njit(**INLINE)
def _clean(director, t):
    """A director that has become unit and normal to the tangent again."""
    return unit(mix(1.0, director, -dot(director, t), t))


@njit(from_python=False, **FLAGS)
def carry(director, t0, t):
    """A director rotated the short way from tangent t0 to tangent t, unit and normal to that."""
    return _clean(carried(director, t0, t), t)
