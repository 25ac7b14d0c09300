# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of inelastic moments and of their internal variables by all they depend on.

With the names of `constitutive_law`, where a curvature x yields, d = x - c exceeds the yield
curvature Y along n = d / |d|, and the middle of the elastic range after it, c + f d with
f = 1 - Y / |d|, has the derivatives

    by x     A = f I + (Y / |d|) n n'
    by the middle before   I - A
    by Y     -n

The elastic curvature is x less 1 - h times that middle, h the hardening. The softening moment
m_i = B_i s x_i of the elastic curvature x has the secant s(r), with
ds = (tangent - secant) (dr / r - dhalf / half) and r^2 = (B_1 x_1^2 + B_2 x_2^2) / mean B. Internal
friction z becomes k z + (1 - k) n with k = exp(-|dx| / w).

They are computed once for a step; a parameter costs products of small matrices then.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.constitutive_law import yield_centre as centre_after
from dlo_ros.spline import FloatArray


class MomentDerivatives(NamedTuple):
    """Derivatives at the quadrature points; no points where the law is linear."""

    yield_centre: FloatArray  # (nb, 2, 5) middle of the elastic range by x, that before and Y
    moment: FloatArray  # (nb, 2, 10) by bending stiffness 11 and 22, x, c, Y, h, half; itself
    slide: FloatArray  # (nb, 2, 6) z by change of curvature, z before, w; and z itself


@njit(inline="always")
def _centre(x1, x2, c1, c2, law, e, out):
    """Write the derivatives of the middle of the elastic range, (2, 5); see above."""
    d1, d2 = x1 - c1, x2 - c2
    size = np.sqrt(d1 * d1 + d2 * d2)
    out[:, :] = 0.0
    if size <= law.yield_curvature[e]:
        out[0, 2], out[1, 3] = 1.0, 1.0
        return
    n1, n2, rest = d1 / size, d2 / size, law.yield_curvature[e] / size
    flow = 1.0 - rest
    a11, a12, a22 = flow + rest * n1 * n1, rest * n1 * n2, flow + rest * n2 * n2
    out[0, 0], out[0, 1], out[1, 0], out[1, 1] = a11, a12, a12, a22
    out[0, 2], out[0, 3], out[1, 2], out[1, 3] = 1.0 - a11, -a12, -a12, 1.0 - a22
    out[0, 4], out[1, 4] = -n1, -n2


@njit(inline="always")
def _moment(stiff1, stiff2, x1, x2, c1, c2, law, e, centre, out):
    """Write the derivatives of `constitutive_law.bending_moment` and itself, (2, 10)."""
    q1, q2 = centre_after(x1, x2, c1, c2, law.yield_curvature[e])
    half, soft = law.half_curvature[e], 1.0 - law.hardening
    e1, e2 = x1 - soft * q1, x2 - soft * q2
    mean = 0.5 * (stiff1 + stiff2)
    f1, f2 = stiff1 * e1, stiff2 * e2  # linear moments
    r2 = (f1 * e1 + f2 * e2) / mean
    r = np.sqrt(r2)
    secant, less, along = 1.0, 0.0, 0.0
    if r > 1e-9 * half:
        s = r / half
        secant = np.arctan(s) / s
        less = 1.0 / (1.0 + s * s) - secant
        along = less / (mean * r2)
    t11, t12, t22 = secant * stiff1 + along * f1 * f1, along * f1 * f2, (
        secant * stiff2 + along * f2 * f2
    )  # fmt: skip
    # By the stiffnesses the elastic curvature held.
    by1, by2 = 0.5 * (along * e1 * e1 - 0.5 * less / mean), 0.5 * (
        along * e2 * e2 - 0.5 * less / mean
    )  # fmt: skip
    out[0, 0], out[0, 1] = secant * e1 + f1 * by1, f1 * by2
    out[1, 0], out[1, 1] = f2 * by1, secant * e2 + f2 * by2
    for c in range(5):
        out[0, 2 + c] = -soft * (t11 * centre[0, c] + t12 * centre[1, c])
        out[1, 2 + c] = -soft * (t12 * centre[0, c] + t22 * centre[1, c])
    out[0, 7], out[1, 7] = t11 * q1 + t12 * q2, t12 * q1 + t22 * q2
    out[0, 2] += t11
    out[0, 3] += t12
    out[1, 2] += t12
    out[1, 3] += t22
    out[0, 8], out[1, 8] = -f1 * less / half, -f2 * less / half
    out[0, 9], out[1, 9] = secant * f1, secant * f2


@njit(inline="always")
def _slide(d1, d2, z1, z2, turn, out):
    """Write the derivatives of internal friction and itself, (2, 6); see `hysteresis_moment`."""
    size = np.sqrt(d1 * d1 + d2 * d2)
    out[:, :] = 0.0
    if size < 1e-12 * turn:
        out[0, 0], out[1, 1] = 1.0 / turn, 1.0 / turn
        out[0, 2], out[1, 3], out[0, 5], out[1, 5] = 1.0, 1.0, z1, z2
        return
    keep, gone = np.exp(-size / turn), -np.expm1(-size / turn)
    n1, n2, across = d1 / size, d2 / size, gone / size
    g1, g2 = (n1 - z1) * keep / turn, (n2 - z2) * keep / turn
    out[0, 0], out[0, 1] = g1 * n1 + across * n2 * n2, g1 * n2 - across * n1 * n2
    out[1, 0], out[1, 1] = g2 * n1 - across * n1 * n2, g2 * n2 + across * n1 * n1
    out[0, 2], out[1, 3] = keep, keep
    out[0, 4], out[1, 4] = -g1 * size / turn, -g2 * size / turn
    out[0, 5], out[1, 5] = keep * z1 + gone * n1, keep * z2 + gone * n2


@linked()
def moment_derivatives(other, bend, bend_rest, internal, law):
    """Derivatives of inelastic moments after a motion to strains `other`.

    Args:
        other: strains (nb, 3), see `strains.strains`.
        bend, bend_rest: bending stiffness [N m^2] and rest curvature [1/m] without damping, shapes
            (nb, 3) and (nb, 2).
        internal: internal variables before.
        law: see `ConstitutiveLaw`.
    """
    centre, inner, points = internal.yield_centre, internal.inner, other.shape[0]
    yields = points if law.active != 0.0 else 0
    # A grip that gives does not rub: somewhere the DLO itself does.
    slides = inner.shape[0] if np.min(law.turn) < np.inf else 0
    out = MomentDerivatives(
        np.empty((yields, 2, 5)), np.empty((yields, 2, 10)), np.empty((slides, 2, 6))
    )
    for e in range(yields):
        x1, x2 = other[e, 0] - bend_rest[e, 0], other[e, 1] - bend_rest[e, 1]
        c1, c2, by = centre[e, 0], centre[e, 1], out.yield_centre[e]
        _centre(x1, x2, c1, c2, law, e, by)
        _moment(bend[e, 0], bend[e, 1], x1, x2, c1, c2, law, e, by, out.moment[e])
    for e in range(slides):
        _slide(
            other[e, 0] - inner[e, 4], other[e, 1] - inner[e, 5], inner[e, 2], inner[e, 3],
            law.turn[e], out.slide[e],
        )  # fmt: skip
    return out
