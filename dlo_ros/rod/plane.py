"""The same strain energy where everything lies in the plane y = 0: x and z only, no frame.

A configuration is q of shape (n, 2). The only bending strain is the curvature about +y,
(p_z s_x - p_x s_z) / |p|^3, which is kappa_1 of the spatial rod whose first director is y.
Storage is that of `kernels`, with two degrees of freedom to a control point instead of four.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod.kernels import add_square, span_stretch, tension_share

PLANAR = 2


@njit(cache=True, nogil=True, inline="always")
def _point(q, span, b1, b2):
    px, pz, sx, sz = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        x, z = q[span + i, 0], q[span + i, 1]
        px += b1[i] * x
        pz += b1[i] * z
        sx += b2[i] * x
        sz += b2[i] * z
    return px, pz, sx, sz


@njit(cache=True, nogil=True)
def strains(q, rule):
    """Stretch (nb,) of whole spans, and the curvature in the first column of (nb, 3)."""
    stretch = np.empty(rule.weight.size)
    other = np.zeros((rule.weight.size, 3))
    for e in range(rule.weight.size):
        px, pz, sx, sz = _point(q, rule.span[e], rule.b1[e], rule.b2[e])
        n = np.sqrt(px * px + pz * pz)
        other[e, 0] = (pz * sx - px * sz) / n**3
        stretch[e] = n - 1.0
    for e in range(rule.weight.size // 3):
        span_stretch(stretch[3 * e : 3 * e + 3], rule.stretch_linear[e])
    return stretch, other


@njit(cache=True, nogil=True)
def assemble(q, rule, other, response, gradient, band, grad_stretch, grad_other):
    """Gradient (2 n,) and exact Hessian (2 n, 8); see `kernels.assemble`.

    grad_stretch (nb, 2) and grad_other (nb, 1, 4) become the derivatives of stretch and curvature
    with respect to p and (p, s).
    """
    gradient[:] = 0.0
    band[:, :] = 0.0
    means = np.empty((3, 8))
    for e in range(rule.weight.size):
        span, wt, b1, b2 = rule.span[e], rule.weight[e], rule.b1[e], rule.b2[e]
        px, pz, sx, sz = _point(q, span, b1, b2)
        r2 = 1.0 / (px * px + pz * pz)
        r = np.sqrt(r2)
        g, tx, tz = r2 * r, px * r, pz * r
        grad_stretch[e, 0], grad_stretch[e, 1] = tx, tz
        tension = wt * response.tension[e] * tension_share(e, rule.stretch_linear[e // 3])
        # Gradient of the curvature with respect to (p_x, p_z, s_x, s_z).
        kappa = other[e, 0]
        f = 3.0 * kappa * r2
        kpx, kpz = -sz * g - f * px, sx * g - f * pz
        ksx, ksz = pz * g, -px * g
        grad = grad_other[e, 0]
        grad[0], grad[1], grad[2], grad[3] = kpx, kpz, ksx, ksz
        stress = wt * response.bend[e, 0]
        # Second derivatives of kappa, times the stress, and the Gauss-Newton part; then those of
        # the stretch, times the tension.
        b, m = wt * response.bend_tangent[e, 0], 3.0 * g * r2 * stress
        q15, fs, soft = 5.0 * f * r2 * stress, f * stress, tension * r
        hxx = b * kpx * kpx + 2.0 * m * sz * px - fs + q15 * px * px + soft * tz * tz
        hxz = b * kpx * kpz + m * (sz * pz - sx * px) + q15 * px * pz - soft * tx * tz
        hzz = b * kpz * kpz - 2.0 * m * sx * pz - fs + q15 * pz * pz + soft * tx * tx
        axx = b * kpx * ksx - m * px * pz
        axz = b * kpx * ksz - g * stress + m * px * px
        azx = b * kpz * ksx + g * stress - m * pz * pz
        azz = b * kpz * ksz + m * pz * px
        dxx, dxz, dzz = b * ksx * ksx, b * ksx * ksz, b * ksz * ksz
        for i in range(4):
            at, u, v = 2 * (span + i), b1[i], b2[i]
            means[e % 3, 2 * i], means[e % 3, 2 * i + 1] = u * tx, u * tz
            gradient[at] += stress * (u * kpx + v * ksx) + tension * u * tx
            gradient[at + 1] += stress * (u * kpz + v * ksz) + tension * u * tz
            # Row of (p, s) blocks contracted with control point i.
            ixx, ixz = u * hxx + v * axx, u * hxz + v * azx
            izx, izz = u * hxz + v * axz, u * hzz + v * azz
            jxx, jxz = u * axx + v * dxx, u * axz + v * dxz
            jzx, jzz = u * azx + v * dxz, u * azz + v * dzz
            for j in range(i + 1):
                k, y, z = 7 - 2 * (i - j), b1[j], b2[j]
                band[at, k] += y * ixx + z * jxx
                band[at + 1, k - 1] += y * izx + z * jzx
                band[at + 1, k] += y * izz + z * jzz
                if j < i:
                    band[at, k + 1] += y * ixz + z * jxz
        if e % 3 == 2:
            length = rule.weight[e - 2] + rule.weight[e - 1] + wt
            line = rule.stretch_linear[e // 3]
            add_square(band, 2 * span, means, length * response.stretch_tangent[e], line, not line)


@njit(cache=True, nogil=True)
def scatter_stress(rule, grad_stretch, grad_other, stress_s, stress_o, out):
    """Add the generalised force of given stresses to out (2 n,)."""
    for e in range(rule.weight.size):
        f, grad = rule.weight[e] * stress_o[e, 0], grad_other[e, 0]
        h = rule.weight[e] * stress_s[e] * tension_share(e, rule.stretch_linear[e // 3])
        for i in range(4):
            at = 2 * (rule.span[e] + i)
            for c in range(2):
                along = f * grad[c] + h * grad_stretch[e, c]
                out[at + c] += rule.b1[e, i] * along + rule.b2[e, i] * f * grad[2 + c]


@njit(cache=True, nogil=True)
def strain_increments(rule, grad_stretch, grad_other, dq, stretch, other):
    """First-order strains of an increment dq (n, 2)."""
    for e in range(rule.weight.size):
        x, y, grad = 0.0, 0.0, grad_other[e, 0]
        for i in range(4):
            for c in range(2):
                d = dq[rule.span[e] + i, c]
                x += (rule.b1[e, i] * grad[c] + rule.b2[e, i] * grad[2 + c]) * d
                y += rule.b1[e, i] * grad_stretch[e, c] * d
        stretch[e] = y
        other[e, 0], other[e, 1], other[e, 2] = x, 0.0, 0.0
    for e in range(rule.weight.size // 3):
        span_stretch(stretch[3 * e : 3 * e + 3], rule.stretch_linear[e])
