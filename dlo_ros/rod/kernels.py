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

import numpy as np
from numba import njit

from dlo_ros.rod.tables import BAND, DOF, Reference

OUTER = 5.0 / 18.0  # weights of the three Gauss points in a mean
MIDDLE = 8.0 / 18.0


@njit(cache=True, nogil=True)
def span_line(x):
    """Replace values at a span's three points by the straight line that fits them best."""
    # Least squares with the quadrature's weights, so that this is its own adjoint.
    mean, tilt = OUTER * (x[0] + x[2]) + MIDDLE * x[1], 0.5 * (x[2] - x[0])
    x[0], x[1], x[2] = mean - tilt, mean, mean + tilt


@njit(cache=True, nogil=True)
def span_stretch(x, linear):
    """Stretch of a span from its values at the three points: the middle one, or a line."""
    if linear:
        span_line(x)
    else:
        x[0], x[2] = x[1], x[1]


@njit(cache=True, nogil=True)
def span_twist(x, linear):
    """Twist of a span from its values at the three points: their mean, or a line."""
    if linear:
        span_line(x)
    else:
        x[:] = OUTER * (x[0] + x[2]) + MIDDLE * x[1]


@njit(cache=True, nogil=True, inline="always")
def tension_share(e, linear):
    """Share of a span's tension that acts at point e: the adjoint of `span_stretch`."""
    if linear:
        return 1.0
    return 1.0 / MIDDLE if e % 3 == 1 else 0.0


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
        Stretch (nb,), and bending and twist in the columns of (nb, 3); stretch and twist are those
        of whole spans, see `Quadrature`.
    """
    nb = rule.weight.size
    stretch = np.empty(nb)
    other = np.empty((nb, 3))
    p, s, k, m1, m2, c0 = (
        np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    )  # fmt: skip
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
        stretch[e] = n - 1.0
    for e in range(nb // 3):
        span_stretch(stretch[3 * e : 3 * e + 3], rule.stretch_linear[e])
        span_twist(other[3 * e : 3 * e + 3, 2], rule.twist_linear[e])
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
def assemble(q, rule, ref, other, response, gradient, band, grad_stretch, grad_other):
    """Gradient of the strain energy and its exact Hessian.

    Args:
        q: configuration, shape (n, 4).
        rule, ref: tables, reference frame.
        other: bending and twist of q, shape (nb, 3), see `strains`.
        response: stresses and tangents that belong to the strains of q.
        gradient: output, shape (4 n,), overwritten.
        band: output, lower rows of the Hessian, shape (4 n, 16): H[i, j] at [i, 15 - i + j].
        grad_stretch: output, derivative of the stretch with respect to p, shape (nb, 3).
        grad_other: output, derivatives of kappa_1, kappa_2, twist with respect to
            (p, s, theta, theta'), shape (nb, 3, 8). Neither is averaged over the span.
    """
    gradient[:] = 0.0
    band[:, :] = 0.0
    p, s = np.empty(3), np.empty(3)
    m1, m2, c0, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    hess, row = np.zeros((8, 8)), np.empty(8)
    # Derivatives of stretch and twist at the three points with respect to the span's 16 numbers.
    means = np.empty((3, 2, 16))
    for e in range(rule.weight.size):
        span, wt = rule.span[e], rule.weight[e]
        b, b1, b2 = rule.b[e], rule.b1[e], rule.b2[e]
        _interpolate(q, span, b1, b2, p, s)
        theta = 0.0
        for i in range(4):
            theta += b[i] * q[span + i, 3]
        n = np.sqrt(_dot(p, p))
        t0 = ref.tangent[e]
        _material_directors(ref, e, theta, m1, m2)
        _cross(t0, ref.rate[e], c0)
        kappa1, kappa2 = other[e, 0], other[e, 1]
        tension, torque = response.tension[e], response.torque[e]
        stress1, stress2 = response.bend[e, 0], response.bend[e, 1]
        t11, t12, t22 = (
            response.bend_tangent[e, 0], response.bend_tangent[e, 1], response.bend_tangent[e, 2]
        )  # fmt: skip
        tension *= tension_share(e, rule.stretch_linear[e // 3])
        for i in range(3):
            v[i] = stress1 * m1[i] + stress2 * m2[i]
        grad = grad_other[e]
        _point_derivatives(p, s, t0, c0, v, torque, m1, m2, grad, hess)
        # theta turns the directors: m1' = m2, m2' = -m1.
        grad[0, 6], grad[1, 6], grad[2, 6] = kappa2, -kappa1, 0.0
        grad[0, 7], grad[1, 7], grad[2, 7] = 0.0, 0.0, 1.0
        for i in range(6):
            h = stress1 * grad[1, i] - stress2 * grad[0, i]
            hess[i, 6] = h
            hess[6, i] = h
            hess[i, 7] = 0.0
            hess[7, i] = 0.0
        hess[6, 6] = -stress1 * kappa1 - stress2 * kappa2
        hess[6, 7], hess[7, 6], hess[7, 7] = 0.0, 0.0, 0.0
        for i in range(3):
            grad_stretch[e, i] = p[i] / n
            for j in range(3):
                unit = 1.0 if i == j else 0.0
                hess[i, j] += tension / n * (unit - p[i] * p[j] / n**2)
        for i in range(8):
            g1, g2 = t11 * grad[0, i] + t12 * grad[1, i], t12 * grad[0, i] + t22 * grad[1, i]
            for j in range(8):
                hess[i, j] += g1 * grad[0, j] + g2 * grad[1, j]
        for i in range(4):
            for c in range(DOF):
                at = DOF * (span + i) + c
                if c < 3:
                    lo, hi, f_lo, f_hi = c, 3 + c, b1[i], b2[i]
                    pull = b1[i] * grad_stretch[e, c]
                else:
                    lo, hi, f_lo, f_hi = 6, 7, b[i], b1[i]
                    pull = 0.0
                turn = f_lo * grad[2, lo] + f_hi * grad[2, hi]
                means[e % 3, 0, DOF * i + c], means[e % 3, 1, DOF * i + c] = pull, turn
                bent = stress1 * (f_lo * grad[0, lo] + f_hi * grad[0, hi])
                bent += stress2 * (f_lo * grad[1, lo] + f_hi * grad[1, hi])
                gradient[at] += wt * (bent + tension * pull + torque * turn)
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
        if e % 3 == 2:
            length = rule.weight[e - 2] + rule.weight[e - 1] + wt
            at, line = DOF * span, rule.stretch_linear[e // 3]
            add_square(band, at, means[:, 0], length * response.stretch_tangent[e], line, not line)
            line = rule.twist_linear[e // 3]
            add_square(band, at, means[:, 1], length * response.twist_tangent[e], line, False)


@njit(cache=True, nogil=True)
def add_square(band, first, gradients, modulus, line, middle):
    """Add the square of a span's stretch or twist to a banded matrix (lower rows, (N, w + 1)).

    Args:
        first: first degree of freedom of the span.
        gradients: of the quantity at the three points, shape (3, m).
        modulus: factor, integrated over the span.
        line, middle: whether the straight line counts, or the middle point, or else the mean.
    """
    last, count = band.shape[1] - 1, gradients.shape[1]
    mean, tilt = np.empty(count), np.zeros(count)
    for i in range(count):
        if middle:
            mean[i] = gradients[1, i]
        else:
            mean[i] = OUTER * (gradients[0, i] + gradients[2, i]) + MIDDLE * gradients[1, i]
        if line:  # its mean square adds the tilt at the outer points, with their weights
            tilt[i] = np.sqrt(2.0 * OUTER) * 0.5 * (gradients[2, i] - gradients[0, i])
    for i in range(count):
        f, g = modulus * mean[i], modulus * tilt[i]
        for j in range(i + 1):
            band[first + i, last - i + j] += f * mean[j] + g * tilt[j]


@njit(cache=True, nogil=True)
def scatter_stress(rule, grad_stretch, grad_other, stress_s, stress_o, out):
    """Add the generalised force of given stresses, sum of weight stress d(strain)/dq, to out.

    Stresses of stretch and twist hold for a whole span, as their strains do.
    """
    column = np.empty(8)
    for e in range(rule.weight.size):
        tension = stress_s[e] * tension_share(e, rule.stretch_linear[e // 3])
        for j in range(8):
            column[j] = rule.weight[e] * (
                stress_o[e, 0] * grad_other[e, 0, j]
                + stress_o[e, 1] * grad_other[e, 1, j]
                + stress_o[e, 2] * grad_other[e, 2, j]
            )
        for c in range(3):
            column[c] += rule.weight[e] * tension * grad_stretch[e, c]
        for i in range(4):
            at = DOF * (rule.span[e] + i)
            for c in range(3):
                out[at + c] += rule.b1[e, i] * column[c] + rule.b2[e, i] * column[3 + c]
            out[at + 3] += rule.b[e, i] * column[6] + rule.b1[e, i] * column[7]


@njit(cache=True, nogil=True)
def strain_increments(rule, grad_stretch, grad_other, dq, stretch, other):
    """First-order strains of an increment dq (n, 4): the transpose of `scatter_stress`."""
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
        stretch[e] = _dot(grad_stretch[e], column[:3])
        for a in range(3):
            x = 0.0
            for j in range(8):
                x += grad_other[e, a, j] * column[j]
            other[e, a] = x
    for e in range(rule.weight.size // 3):
        span_stretch(stretch[3 * e : 3 * e + 3], rule.stretch_linear[e])
        span_twist(other[3 * e : 3 * e + 3, 2], rule.twist_linear[e])
