# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled constitutive law: from strains to stress resultants and their tangents.

Stretch and twist are linear. Bending may soften and yield, both in the plane of the curvature
vector x against its rest value:

    yield      c follows x once |x - c| exceeds the yield curvature: the middle of the elastic
               range, of which kappa_p = (1 - h) c stays as plastic curvature (linear kinematic
               hardening, with the tangent stiffness h B past the yield)
    softening  moment B half atan(|x_e| / half) along x_e = x - kappa_p, whose tangent stiffness is
               B / (1 + (x_e / half)^2)

so that both are exact where there is one curvature only, and isotropic otherwise.

Internal friction adds a moment M z, where z follows the curvature towards its direction of change,

    dz = (n - z) |dx| / w,    n = dx / |dx|

(Dahl, A solid friction model, 1968), which is integrated exactly along the straight way from one
step's curvature to the next. What relaxes is in the stiffness already, see
`generalised_alpha.damped`; it is linear, and softening and yield are those of the rest.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.rod_tables import Response


@linked()
def room(points):
    """A response to write to, for a number of quadrature points."""
    return Response(
        np.empty(points), np.empty((points, 2)), np.empty(points), np.empty(points),
        np.empty((points, 3)), np.empty(points), np.empty(points),
    )  # fmt: skip


@njit(inline="always")
def yield_centre(x1, x2, c1, c2, most):
    """Where a curvature (x1, x2) leaves the middle of the elastic range that was at (c1, c2).

    It does not depend on the hardening, of which 0 and 1 are cases like others.

    Args:
        most: yield curvature there.
    """
    d1, d2 = x1 - c1, x2 - c2
    size = np.sqrt(d1 * d1 + d2 * d2)
    if size > most:
        flow = 1.0 - most / size
        c1 += flow * d1
        c2 += flow * d2
    return c1, c2


@njit(from_python=False)
def bending_moment(stiff1, stiff2, x1, x2, c1, c2, half, most, hardening):
    """Moment of a curvature beyond linear elasticity.

    It is called for each point: to hand over a tuple of arrays would take longer than the rest.

    Args:
        stiff1, stiff2: bending stiffness about both directors [N m^2].
        x1, x2: curvature against the rest curvature [1/m].
        c1, c2: middle of the elastic range before [1/m].
        half, most, hardening: half and yield curvature there, and hardening, see `ConstitutiveLaw`.

    Returns:
        Moments about both directors [N m], their tangent (11, 12, 22) [N m^2], energy [J/m].
    """
    q1, q2 = yield_centre(x1, x2, c1, c2, most)
    soft = 1.0 - hardening
    e1, e2 = x1 - soft * q1, x2 - soft * q2
    root1, root2, mean = np.sqrt(stiff1), np.sqrt(stiff2), 0.5 * (stiff1 + stiff2)
    y1, y2 = root1 * e1, root2 * e2
    r = np.sqrt((y1 * y1 + y2 * y2) / mean)
    secant, tangent, energy = 1.0, 1.0, 0.5 * mean * r * r
    if r > 1e-9 * half:
        s = r / half
        secant, tangent = np.arctan(s) / s, 1.0 / (1.0 + s * s)
        energy = mean * half**2 * (s * np.arctan(s) - 0.5 * np.log(1.0 + s * s))
    along = 0.0 if r == 0.0 else (tangent - secant) / (mean * r * r)
    t11 = stiff1 * (secant + along * y1 * y1)
    t12 = root1 * root2 * along * y1 * y2
    t22 = stiff2 * (secant + along * y2 * y2)
    d1, d2 = x1 - c1, x2 - c2
    size = np.sqrt(d1 * d1 + d2 * d2)
    if size > most:
        # d(x_e)/dx: less along the flow direction, and across it as far as it has turned.
        n1, n2 = d1 / size, d2 / size
        across = soft * (1.0 - most / size)
        along = soft - across
        j11, j12, j22 = 1.0 - across - along * n1 * n1, -along * n1 * n2, (
            1.0 - across - along * n2 * n2
        )  # fmt: skip
        energy += (
            soft
            * mean
            * (
                0.5 * hardening * (q1 * q1 + q2 * q2)
                + most * np.sqrt((q1 - c1) ** 2 + (q2 - c2) ** 2)
            )
        )
        a12, a21 = t11 * j12 + t12 * j22, t12 * j11 + t22 * j12
        t11, t22 = t11 * j11 + t12 * j12, t12 * j12 + t22 * j22
        t12 = 0.5 * (a12 + a21)  # symmetric where the curvature keeps its plane
    return root1 * secant * y1, root2 * secant * y2, t11, t12, t22, energy


@linked()
def respond(stretch, other, weight, material, out):
    """Stress resultants and tangents of strains.

    Args:
        stretch, other: strains (nb,) and (nb, 3), see `strains.strains`.
        weight: weights of the quadrature points [m], shape (nb,).
        material: see `Material`.
        out: output.

    Returns:
        Energy [J].
    """
    stiff, energy = material.stiffness, 0.0
    for e in range(weight.size):
        x0 = stretch[e] - stiff.stretch_rest[e]
        x1 = other[e, 0] - stiff.bend_rest[e, 0]
        x2 = other[e, 1] - stiff.bend_rest[e, 1]
        x3 = other[e, 2] - stiff.twist_rest[e]
        out.tension[e], out.torque[e] = stiff.stretch[e] * x0, stiff.twist[e] * x3
        out.pull[e] = out.tension[e]
        both = stiff.bend[e, 2]
        out.bend[e, 0] = stiff.bend[e, 0] * x1 + both * x2
        out.bend[e, 1] = both * x1 + stiff.bend[e, 1] * x2
        out.stretch_tangent[e], out.twist_tangent[e] = stiff.stretch[e], stiff.twist[e]
        out.bend_tangent[e, 0], out.bend_tangent[e, 2] = stiff.bend[e, 0], stiff.bend[e, 1]
        out.bend_tangent[e, 1] = both
        energy += 0.5 * weight[e] * (
            out.tension[e] * x0 + out.bend[e, 0] * x1 + out.bend[e, 1] * x2 + out.torque[e] * x3
        )  # fmt: skip
    if material.law.active != 0.0:
        # The stiffness above contains damping; only its elastic share follows the law.
        energy += _add_nonlinear_bending(other, weight, material, out)
    if material.law.slide != 0.0:
        energy += _add_hysteresis(other, weight, material, out)
    return energy


@njit(inline="always")
def hysteresis_moment(d1, d2, z1, z2, turn):
    """Internal friction after a change of curvature.

    Args:
        d1, d2: change of curvature [1/m].
        z1, z2: moment before, over its largest.
        turn: see `ConstitutiveLaw`.

    Returns:
        The moment, its derivatives by the change (11, 12, 22) [m] and its work [1/m], over the
        largest moment. The derivative is made symmetric, which it is in one plane.
    """
    size = np.sqrt(d1 * d1 + d2 * d2)
    if size < 1e-12 * turn:
        return z1, z2, 1.0 / turn, 0.0, 1.0 / turn, z1 * d1 + z2 * d2
    keep, n1, n2 = np.exp(-size / turn), d1 / size, d2 / size
    gone = -np.expm1(-size / turn)
    g1, g2, across = (n1 - z1) * keep / turn, (n2 - z2) * keep / turn, gone / size
    return (
        z1 + gone * (n1 - z1), z2 + gone * (n2 - z2),
        g1 * n1 + across * n2 * n2,
        0.5 * (g1 * n2 + g2 * n1) - across * n1 * n2,
        g2 * n2 + across * n1 * n1,
        size - (1.0 - n1 * z1 - n2 * z2) * turn * gone,
    )  # fmt: skip


@linked()
def _add_hysteresis(other, weight, material, out):
    """Add the moment of internal friction, its tangent; returns its work [J]."""
    inner, law, energy = material.internal.inner, material.law, 0.0
    for e in range(weight.size):
        z1, z2, t11, t12, t22, work = hysteresis_moment(
            other[e, 0] - inner[e, 4], other[e, 1] - inner[e, 5], inner[e, 2], inner[e, 3],
            law.turn[e],
        )  # fmt: skip
        out.bend[e, 0] += law.slide * z1
        out.bend[e, 1] += law.slide * z2
        out.bend_tangent[e, 0] += law.slide * t11
        out.bend_tangent[e, 1] += law.slide * t12
        out.bend_tangent[e, 2] += law.slide * t22
        energy += weight[e] * law.slide * work
    return energy


@linked()
def _add_nonlinear_bending(other, weight, material, out):
    """Replace the linear elastic part of the moments by what the law makes of it."""
    centre, energy, law = material.internal.yield_centre, 0.0, material.law
    held = 1.0 - law.relaxing
    for e in range(weight.size):
        b1 = material.stiffness.bend[e, 0] / material.damping
        b2 = material.stiffness.bend[e, 1] / material.damping
        x1 = other[e, 0] - material.bend_rest[e, 0]
        x2 = other[e, 1] - material.bend_rest[e, 1]
        m1, m2, t11, t12, t22, w = bending_moment(
            b1, b2, x1, x2, centre[e, 0], centre[e, 1], law.half_curvature[e],
            law.yield_curvature[e], law.hardening,
        )  # fmt: skip
        out.bend[e, 0] += held * (m1 - b1 * x1)
        out.bend[e, 1] += held * (m2 - b2 * x2)
        out.bend_tangent[e, 0] += held * (t11 - b1)
        out.bend_tangent[e, 1] += held * t12
        out.bend_tangent[e, 2] += held * (t22 - b2)
        energy += held * weight[e] * (w - 0.5 * (b1 * x1 * x1 + b2 * x2 * x2))
    return energy


@linked()
def moments_in_plane(kappa, material, moment, tangent):
    """Write bending moments [N m] and tangents [N m^2] of curvatures in the plane, all (nb,)."""
    stiff, law, inner = material.stiffness, material.law, material.internal.inner
    centre, held = material.internal.yield_centre, 1.0 - law.relaxing
    for e in range(kappa.size):
        tangent[e] = stiff.bend[e, 0]
        moment[e] = tangent[e] * (kappa[e] - stiff.bend_rest[e, 0])
        if law.active != 0.0:
            b, x = stiff.bend[e, 0] / material.damping, kappa[e] - material.bend_rest[e, 0]
            m, _, t, _, _, _ = bending_moment(
                b, b, x, 0.0, centre[e, 0], 0.0, law.half_curvature[e], law.yield_curvature[e],
                law.hardening,
            )  # fmt: skip
            moment[e] += held * (m - b * x)
            tangent[e] += held * (t - b)
        if law.slide != 0.0:
            z, _, t, _, _, _ = hysteresis_moment(
                kappa[e] - inner[e, 4], 0.0, inner[e, 2], 0.0, law.turn[e]
            )
            moment[e] += law.slide * z
            tangent[e] += law.slide * t


@linked()
def update_internal(other, material, out):
    """Write the `InternalVariables` of bending after a motion to strains `other` to out."""
    centre, inner = material.internal.yield_centre, material.internal.inner
    for e in range(inner.shape[0]):
        z1, z2, _, _, _, _ = hysteresis_moment(
            other[e, 0] - inner[e, 4], other[e, 1] - inner[e, 5], inner[e, 2], inner[e, 3],
            material.law.turn[e],
        )  # fmt: skip
        for c in range(2):
            change = other[e, c] - inner[e, 4 + c]
            out.inner[e, c] = material.keep * inner[e, c] + material.gain * change
            out.inner[e, 4 + c] = other[e, c]
        out.inner[e, 2], out.inner[e, 3] = z1, z2
    law = material.law
    if law.active != 0.0:
        for e in range(other.shape[0]):
            x1 = other[e, 0] - material.bend_rest[e, 0]
            x2 = other[e, 1] - material.bend_rest[e, 1]
            c1, c2 = yield_centre(x1, x2, centre[e, 0], centre[e, 1], law.yield_curvature[e])
            out.yield_centre[e, 0], out.yield_centre[e, 1] = c1, c2
