"""Compiled strain energy of the spline rod: strains, their derivatives, forces and stiffness.

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

from typing import NamedTuple

import numpy as np
from numba import njit

from dlo_ros.spline import FloatArray

DOF = 4  # x, y, z, theta of a control point
LOCAL = 16  # degrees of freedom that a knot span touches
BAND = 15  # half bandwidth of the stiffness matrix


class Quadrature(NamedTuple):
    """Basis functions at the quadrature points; tables that never change.

    Stretch has points of its own (numerics.md: one a knot span, more at free ends).
    """

    stretch_span: FloatArray  # (ns,) integers
    stretch_b1: FloatArray  # (ns, 4)
    stretch_weight: FloatArray  # (ns,)
    span: FloatArray  # (nb,) integers
    b: FloatArray  # (nb, 4)
    b1: FloatArray  # (nb, 4)
    b2: FloatArray  # (nb, 4)
    weight: FloatArray  # (nb,)


class Stiffness(NamedTuple):
    """Stiffness and rest strain at every quadrature point."""

    stretch: FloatArray  # (ns,) [N]
    stretch_rest: FloatArray  # (ns,)
    bend: FloatArray  # (nb, 2) [N m^2]
    bend_rest: FloatArray  # (nb, 2) [1/m]
    twist: FloatArray  # (nb,) [N m^2]
    twist_rest: FloatArray  # (nb,) [rad/m]


class Reference(NamedTuple):
    """Reference frame at the bending points, transported in time without spin."""

    tangent: FloatArray  # (nb, 3)
    rate: FloatArray  # (nb, 3) derivative of the tangent along u [1/m]
    director: FloatArray  # (nb, 3) first director, unit and normal to the tangent
    twist: FloatArray  # (nb,) twist of the frame [rad/m]


@njit(cache=True, inline="always")
def _interpolate(q, span, b1, b2, p, s):
    for c in range(3):
        p[c] = 0.0
        s[c] = 0.0
    for i in range(4):
        for c in range(3):
            p[c] += b1[i] * q[span + i, c]
            s[c] += b2[i] * q[span + i, c]


@njit(cache=True, inline="always")
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, inline="always")
def _projected_curvature(k, p, n, v, t0):
    """Component of the curvature vector k / n^3 along v, carried from t0 to the tangent p / n."""
    return (_dot(k, v) - _dot(p, v) * _dot(k, t0) / (n + _dot(p, t0))) / n**3


@njit(cache=True, nogil=True)
def strains(q, rule, ref):
    """All strains of a configuration.

    Returns:
        Stretch (ns,), and bending and twist in the columns of (nb, 3).
    """
    ns, nb = rule.stretch_weight.size, rule.weight.size
    stretch = np.empty(ns)
    other = np.empty((nb, 3))
    p, s, k, m1, m2, c0 = (
        np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    )  # fmt: skip
    for e in range(ns):
        _interpolate(q, rule.stretch_span[e], rule.stretch_b1[e], rule.stretch_b1[e], p, s)
        stretch[e] = np.sqrt(_dot(p, p)) - 1.0
    for e in range(nb):
        span = rule.span[e]
        _interpolate(q, span, rule.b1[e], rule.b2[e], p, s)
        theta, rate = 0.0, 0.0
        for i in range(4):
            theta += rule.b[e, i] * q[span + i, 3]
            rate += rule.b1[e, i] * q[span + i, 3]
        n = np.sqrt(_dot(p, p))
        t0 = ref.tangent[e]
        _cross(p, s, k)
        _material_directors(ref, e, theta, m1, m2)
        other[e, 0] = _projected_curvature(k, p, n, m1, t0)
        other[e, 1] = _projected_curvature(k, p, n, m2, t0)
        _cross(t0, ref.rate[e], c0)
        w = 1.0 / (n + _dot(p, t0))
        other[e, 2] = rate + ref.twist[e] + _dot(p, c0) * w - _dot(k, t0) * w / n
    return stretch, other


@njit(cache=True, inline="always")
def _material_directors(ref, e, theta, m1, m2):
    d1 = ref.director[e]
    _cross(ref.tangent[e], d1, m2)
    c, s = np.cos(theta), np.sin(theta)
    for i in range(3):
        d2 = m2[i]
        m1[i] = c * d1[i] + s * d2
        m2[i] = -s * d1[i] + c * d2


@njit(cache=True, nogil=True)
def transport(q, rule, ref):
    """The reference frame carried to configuration q; the strains of q do not change by it."""
    nb = rule.weight.size
    tangent, rate = np.empty((nb, 3)), np.empty((nb, 3))
    director, twist = np.empty((nb, 3)), np.empty(nb)
    p, s, k, c0 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for e in range(nb):
        _interpolate(q, rule.span[e], rule.b1[e], rule.b2[e], p, s)
        n = np.sqrt(_dot(p, p))
        t0 = ref.tangent[e]
        _cross(p, s, k)
        _cross(t0, ref.rate[e], c0)
        w = 1.0 / (n + _dot(p, t0))
        twist[e] = ref.twist[e] + _dot(p, c0) * w - _dot(k, t0) * w / n
        along = _dot(p, s) / n**2
        for i in range(3):
            tangent[e, i] = p[i] / n
            rate[e, i] = (s[i] - along * p[i]) / n
        carry(ref.director[e], t0, tangent[e], director[e])
    return Reference(tangent, rate, director, twist)


@njit(cache=True, nogil=True)
def carry(director, t0, t, out):
    """Rotate a director the short way from tangent t0 to tangent t, and make it unit and normal."""
    f = _dot(director, t) / (1.0 + _dot(t0, t))
    for i in range(3):
        out[i] = director[i] - f * (t[i] + t0[i])
    f = _dot(out, t)
    for i in range(3):
        out[i] -= f * t[i]
    f = 1.0 / np.sqrt(_dot(out, out))
    for i in range(3):
        out[i] *= f


@njit(cache=True, nogil=True)
def _point_derivatives(p, s, t0, c0, v, moment, m1, m2, grad, hess):
    """Derivatives of the strains at one point with respect to (p, s).

    grad (3, 8): rows kappa_1, kappa_2, twist; columns p, s (theta, theta' are filled elsewhere).
    hess (8, 8): of v . curvature + moment * twist, where v = sum of stress times director.
    """
    n = np.sqrt(_dot(p, p))
    g = n**-3
    w = 1.0 / (n + _dot(p, t0))
    t, tw, k = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        t[i] = p[i] / n
        tw[i] = -w * w * (t[i] + t0[i])  # gradient of w
    _cross(p, s, k)
    c = _dot(k, t0)
    cp, cs = np.empty(3), np.empty(3)
    _cross(s, t0, cp)
    _cross(t0, p, cs)
    fp, fs = np.empty(3), np.empty(3)

    # Gradients of the two curvatures, S = g (k.m - (p.m) c w).
    for row in range(2):
        m = m1 if row == 0 else m2
        _cross(s, m, fp)
        _cross(m, p, fs)
        b = _dot(p, m)
        f = _dot(k, m) - b * c * w
        for i in range(3):
            grad[row, i] = (
                g * (fp[i] - w * c * m[i] - w * b * cp[i] - b * c * tw[i]) - 3.0 * g * f * t[i] / n
            )
            grad[row, 3 + i] = g * (fs[i] - w * b * cs[i])

    # Gradient of the reference twist, e w - c y with y = w / n.
    e, y = _dot(p, c0), w / n
    yp = np.empty(3)
    for i in range(3):
        yp[i] = tw[i] / n - w * t[i] / n**2
        grad[2, i] = w * c0[i] + e * tw[i] - y * cp[i] - c * yp[i]
        grad[2, 3 + i] = -y * cs[i]

    # Second derivatives for the stress-weighted sum.
    _cross(s, v, fp)
    _cross(v, p, fs)
    b = _dot(p, v)
    f = _dot(k, v) - b * c * w
    sp, gp = np.empty(3), np.empty(3)
    ss = np.empty(3)
    for i in range(3):
        sp[i] = fp[i] - w * c * v[i] - w * b * cp[i] - b * c * tw[i]  # gradient of f
        ss[i] = fs[i] - w * b * cs[i]
        gp[i] = -3.0 * g * t[i] / n
    for i in range(3):
        for j in range(3):
            unit = 1.0 if i == j else 0.0
            w_ij = 2.0 * w**3 * (t[i] + t0[i]) * (t[j] + t0[j]) - w * w * (unit - t[i] * t[j]) / n
            g_ij = g / n**2 * (15.0 * t[i] * t[j] - 3.0 * unit)
            f_ij = (
                -w * (v[i] * cp[j] + cp[i] * v[j])
                - c * (v[i] * tw[j] + tw[i] * v[j])
                - b * (cp[i] * tw[j] + tw[i] * cp[j])
                - b * c * w_ij
            )
            y_ij = (
                w_ij / n
                - (tw[i] * t[j] + t[i] * tw[j]) / n**2
                + w * (3.0 * t[i] * t[j] - unit) / n**3
            )
            hess[i, j] = (
                g * f_ij + gp[i] * sp[j] + sp[i] * gp[j] + f * g_ij
                + moment * (
                    c0[i] * tw[j] + tw[i] * c0[j] + e * w_ij
                    - cp[i] * yp[j] - yp[i] * cp[j] - c * y_ij
                )
            )  # fmt: skip
            # d2 (p x s . a) / dp_i ds_j = epsilon_ijk a_k
            av, at = _levi_civita(i, j, v), _levi_civita(i, j, t0)
            f_ps = av - w * v[i] * cs[j] - w * b * at - b * tw[i] * cs[j]
            h = g * f_ps + gp[i] * ss[j] + moment * (-y * at - yp[i] * cs[j])
            hess[i, 3 + j] = h
            hess[3 + j, i] = h
            hess[3 + i, 3 + j] = 0.0


@njit(cache=True, inline="always")
def _levi_civita(i, j, a):
    if i == j:
        return 0.0
    return a[3 - i - j] if (j - i) % 3 == 1 else -a[3 - i - j]


@njit(cache=True, nogil=True)
def assemble(q, rule, stiff, ref, gradient, band, grad_stretch, grad_other):
    """Elastic energy, its gradient and its exact Hessian.

    Args:
        q: configuration, shape (n, 4).
        rule, stiff, ref: tables, stiffness with rest strains, reference frame.
        gradient: output, shape (4 n,), overwritten.
        band: output, lower rows of the Hessian, shape (4 n, 16): H[i, j] at [i, 15 - i + j].
        grad_stretch: output, derivative of the stretch with respect to p, shape (ns, 3).
        grad_other: output, derivatives of kappa_1, kappa_2, twist with respect to
            (p, s, theta, theta'), shape (nb, 3, 8).

    Returns:
        Energy [J].
    """
    gradient[:] = 0.0
    band[:, :] = 0.0
    energy = 0.0
    p, s, k = np.empty(3), np.empty(3), np.empty(3)
    m1, m2, c0, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    hess, stress = np.zeros((8, 8)), np.empty(3)
    row = np.empty(8)
    for e in range(rule.stretch_weight.size):
        span, b1, wt = rule.stretch_span[e], rule.stretch_b1[e], rule.stretch_weight[e]
        _interpolate(q, span, b1, b1, p, s)
        n = np.sqrt(_dot(p, p))
        stress_s = stiff.stretch[e] * (n - 1.0 - stiff.stretch_rest[e])
        energy += 0.5 * wt * stress_s * (n - 1.0 - stiff.stretch_rest[e])
        for i in range(3):
            grad_stretch[e, i] = p[i] / n
        for i in range(4):
            at = DOF * (span + i)
            for c in range(3):
                gradient[at + c] += wt * stress_s * b1[i] * p[c] / n
                for j in range(i + 1):
                    for d in range(3):
                        if j < i or d <= c:
                            unit = 1.0 if c == d else 0.0
                            tt = p[c] * p[d] / n**2
                            h = stiff.stretch[e] * tt + stress_s / n * (unit - tt)
                            band[at + c, BAND - DOF * (i - j) - c + d] += wt * b1[i] * b1[j] * h
    for e in range(rule.weight.size):
        span, wt = rule.span[e], rule.weight[e]
        b, b1, b2 = rule.b[e], rule.b1[e], rule.b2[e]
        _interpolate(q, span, b1, b2, p, s)
        theta, rate = 0.0, 0.0
        for i in range(4):
            theta += b[i] * q[span + i, 3]
            rate += b1[i] * q[span + i, 3]
        n = np.sqrt(_dot(p, p))
        t0 = ref.tangent[e]
        _cross(p, s, k)
        _material_directors(ref, e, theta, m1, m2)
        _cross(t0, ref.rate[e], c0)
        w = 1.0 / (n + _dot(p, t0))
        kappa1 = _projected_curvature(k, p, n, m1, t0)
        kappa2 = _projected_curvature(k, p, n, m2, t0)
        twist = rate + ref.twist[e] + _dot(p, c0) * w - _dot(k, t0) * w / n
        x1, x2 = kappa1 - stiff.bend_rest[e, 0], kappa2 - stiff.bend_rest[e, 1]
        x3 = twist - stiff.twist_rest[e]
        stress[0], stress[1] = stiff.bend[e, 0] * x1, stiff.bend[e, 1] * x2
        stress[2] = stiff.twist[e] * x3
        energy += 0.5 * wt * (stress[0] * x1 + stress[1] * x2 + stress[2] * x3)
        for i in range(3):
            v[i] = stress[0] * m1[i] + stress[1] * m2[i]
        grad = grad_other[e]
        _point_derivatives(p, s, t0, c0, v, stress[2], m1, m2, grad, hess)
        # theta turns the directors: m1' = m2, m2' = -m1.
        grad[0, 6], grad[1, 6], grad[2, 6] = kappa2, -kappa1, 0.0
        grad[0, 7], grad[1, 7], grad[2, 7] = 0.0, 0.0, 1.0
        for i in range(6):
            h = stress[0] * grad[1, i] - stress[1] * grad[0, i]
            hess[i, 6] = h
            hess[6, i] = h
            hess[i, 7] = 0.0
            hess[7, i] = 0.0
        hess[6, 6] = -stress[0] * kappa1 - stress[1] * kappa2
        hess[6, 7], hess[7, 6], hess[7, 7] = 0.0, 0.0, 0.0
        for i in range(8):
            g1, g2 = stiff.bend[e, 0] * grad[0, i], stiff.bend[e, 1] * grad[1, i]
            g3 = stiff.twist[e] * grad[2, i]
            for j in range(8):
                hess[i, j] += g1 * grad[0, j] + g2 * grad[1, j] + g3 * grad[2, j]
        for i in range(4):
            for c in range(DOF):
                at = DOF * (span + i) + c
                if c < 3:
                    lo, hi, f_lo, f_hi = c, 3 + c, b1[i], b2[i]
                else:
                    lo, hi, f_lo, f_hi = 6, 7, b[i], b1[i]
                g = 0.0
                for a in range(3):
                    g += stress[a] * (f_lo * grad[a, lo] + f_hi * grad[a, hi])
                gradient[at] += wt * g
                for j in range(8):
                    row[j] = wt * (f_lo * hess[lo, j] + f_hi * hess[hi, j])
                for j in range(i + 1):
                    base = BAND - DOF * (i - j) - c
                    for d in range(DOF if j < i else c + 1):
                        if d < 3:
                            h = b1[j] * row[d] + b2[j] * row[3 + d]
                        else:
                            h = b[j] * row[6] + b1[j] * row[7]
                        band[at, base + d] += h
    return energy


@njit(cache=True, nogil=True)
def scatter_stress(rule, grad_stretch, grad_other, stress_s, stress_o, out):
    """Add the generalised force of given stresses, sum of weight stress d(strain)/dq, to out."""
    for e in range(rule.stretch_weight.size):
        for i in range(4):
            at = DOF * (rule.stretch_span[e] + i)
            f = rule.stretch_weight[e] * stress_s[e] * rule.stretch_b1[e, i]
            for c in range(3):
                out[at + c] += f * grad_stretch[e, c]
    column = np.empty(8)
    for e in range(rule.weight.size):
        for j in range(8):
            column[j] = rule.weight[e] * (
                stress_o[e, 0] * grad_other[e, 0, j]
                + stress_o[e, 1] * grad_other[e, 1, j]
                + stress_o[e, 2] * grad_other[e, 2, j]
            )
        for i in range(4):
            at = DOF * (rule.span[e] + i)
            for c in range(3):
                out[at + c] += rule.b1[e, i] * column[c] + rule.b2[e, i] * column[3 + c]
            out[at + 3] += rule.b[e, i] * column[6] + rule.b1[e, i] * column[7]


@njit(cache=True, nogil=True)
def strain_increments(rule, grad_stretch, grad_other, dq, stretch, other):
    """First-order strains of an increment dq (n, 4): the transpose of `scatter_stress`."""
    for e in range(rule.stretch_weight.size):
        x = 0.0
        for i in range(4):
            for c in range(3):
                x += rule.stretch_b1[e, i] * grad_stretch[e, c] * dq[rule.stretch_span[e] + i, c]
        stretch[e] = x
    column = np.empty(8)
    for e in range(rule.weight.size):
        column[:] = 0.0
        for i in range(4):
            at = rule.span[e] + i
            for c in range(3):
                column[c] += rule.b1[e, i] * dq[at, c]
                column[3 + c] += rule.b2[e, i] * dq[at, c]
            column[6] += rule.b[e, i] * dq[at, 3]
            column[7] += rule.b1[e, i] * dq[at, 3]
        for a in range(3):
            x = 0.0
            for j in range(8):
                x += grad_other[e, a, j] * column[j]
            other[e, a] = x
