"""The same strain energy where everything lies in the plane y = 0: x and z only, no frame.

A configuration is q of shape (n, 2). The only bending strain is the curvature about +y,
(p_z s_x - p_x s_z) / |p|^3, which is kappa_1 of the spatial rod whose first director is y.
Storage is that of `assembly`, with two degrees of freedom to a control point instead of four.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod.kernels import span_stretch, tension_share
from dlo_ros.rod.lanes import add_rows
from dlo_ros.rod.spans import (
    BLOCK, POINT, PRODUCTS, SHAPE, SHAPES, SLOPE, add_block, add_forces, add_squares, mean, shapes,
    slope_products, tilt,
)  # fmt: skip
from dlo_ros.rod.vectors import FLAGS, INLINE

PLANAR = 2
XX, ZX, ZZ = 0, BLOCK, 2 * BLOCK  # pairs of coordinates


@njit(**INLINE)
def _point(q, span, b1, b2, e):
    px, pz, sx, sz = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        x, z = q[span + i, 0], q[span + i, 1]
        px += b1[e, i] * x
        pz += b1[e, i] * z
        sx += b2[e, i] * x
        sz += b2[e, i] * z
    return px, pz, sx, sz


@njit(**FLAGS)
def strains(q, rule):
    """Stretch (nb,) of whole spans, and the curvature in the first column of (nb, 3)."""
    stretch = np.empty(rule.weight.size)
    other = np.zeros((rule.weight.size, 3))
    for e in range(rule.weight.size):
        px, pz, sx, sz = _point(q, rule.span[e], rule.b1, rule.b2, e)
        n = np.sqrt(px * px + pz * pz)
        r = 1.0 / n
        other[e, 0] = (pz * sx - px * sz) * r * r * r
        stretch[e] = n - 1.0
    for k in range(rule.weight.size // 3):
        span_stretch(stretch[3 * k : 3 * k + 3], rule.stretch_linear[k])
    return stretch, other


@njit(**INLINE)
def _add_first(out, at, by_px, by_pz, by_sx, by_sz, shape):
    """Add derivatives by p and s of a point to those by the span's 8 numbers."""
    add_rows(out, at, (by_px, by_sx), shape, SHAPE, 4)
    add_rows(out, at + 4, (by_pz, by_sz), shape, SHAPE, 4)


@njit(**FLAGS)
def assemble(q, rule, other, response, gradient, band, grad_stretch, grad_other):
    """Gradient (2 n,) and exact Hessian (2 n, 8); see `assembly.assemble`.

    grad_stretch (nb, 2) and grad_other (nb, 1, 4) become the derivatives of stretch and curvature
    with respect to p and (p, s).
    """
    gradient[:] = 0.0
    band[:, :] = 0.0
    block, products, shape = np.empty(3 * BLOCK), np.empty(PRODUCTS), np.empty(SHAPES)
    forces, pull = np.empty(POINT), np.empty(2 * POINT)
    for k in range(rule.weight.size // 3):
        span, line = rule.span[3 * k], rule.stretch_linear[k]
        block[:], forces[:], pull[:] = 0.0, 0.0, 0.0
        for point in range(3):
            e = 3 * k + point
            wt = rule.weight[e]
            px, pz, sx, sz = _point(q, span, rule.b1, rule.b2, e)
            r2 = 1.0 / (px * px + pz * pz)
            r = np.sqrt(r2)
            g, tx, tz = r2 * r, px * r, pz * r
            tension = wt * response.tension[e] * tension_share(e, line)
            # Gradient of the curvature with respect to (p_x, p_z, s_x, s_z).
            kappa = other[e, 0]
            f = 3.0 * kappa * r2
            kpx, kpz, ksx, ksz = -sz * g - f * px, sx * g - f * pz, pz * g, -px * g
            stress = wt * response.bend[e, 0]
            # Second derivatives of kappa, times the stress, and the Gauss-Newton part; then those
            # of the stretch, times the tension.
            b, m = wt * response.bend_tangent[e, 0], 3.0 * g * r2 * stress
            q15, fs, soft = 5.0 * f * r2 * stress, f * stress, tension * r
            hxx = b * kpx * kpx + 2.0 * m * sz * px - fs + q15 * px * px + soft * tz * tz
            hxz = b * kpx * kpz + m * (sz * pz - sx * px) + q15 * px * pz - soft * tx * tz
            hzz = b * kpz * kpz - 2.0 * m * sx * pz - fs + q15 * pz * pz + soft * tx * tx
            axx = b * kpx * ksx - m * px * pz
            axz = b * kpx * ksz - g * stress + m * px * px
            azx = b * kpz * ksx + g * stress - m * pz * pz
            azz = b * kpz * ksz + m * pz * px
            slope_products(rule, e, products)
            add_rows(block, XX, (hxx, axx, axx, b * ksx * ksx), products, SLOPE, 16)
            add_rows(block, ZX, (hxz, azx, axz, b * ksx * ksz), products, SLOPE, 16)
            add_rows(block, ZZ, (hzz, azz, azz, b * ksz * ksz), products, SLOPE, 16)
            shapes(rule, e, shape)
            _add_first(
                forces, 0, stress * kpx + tension * tx, stress * kpz + tension * tz, stress * ksx,
                stress * ksz, shape,
            )  # fmt: skip
            share = mean(point, not line)
            if share != 0.0:
                _add_first(pull, 0, share * tx, share * tz, 0.0, 0.0, shape)
            if line:
                share = tilt(point)
                _add_first(pull, POINT, share * tx, share * tz, 0.0, 0.0, shape)
            grad_stretch[e, 0], grad_stretch[e, 1] = tx, tz
            grad_other[e, 0, 0], grad_other[e, 0, 1] = kpx, kpz
            grad_other[e, 0, 2], grad_other[e, 0, 3] = ksx, ksz
        length = rule.weight[3 * k] + rule.weight[3 * k + 1] + rule.weight[3 * k + 2]
        add_squares(block, PLANAR, length * response.stretch_tangent[3 * k], pull, line)
        add_block(block, PLANAR, span, band)
        add_forces(forces, PLANAR, span, gradient)


@njit(**FLAGS)
def scatter_stress(rule, grad_stretch, grad_other, stress_s, stress_o, out):
    """Add the generalised force of given stresses to out (2 n,)."""
    shape, forces = np.empty(SHAPES), np.empty(POINT)
    for k in range(rule.weight.size // 3):
        forces[:] = 0.0
        for e in range(3 * k, 3 * k + 3):
            f, g = rule.weight[e] * stress_o[e, 0], grad_other
            h = rule.weight[e] * stress_s[e] * tension_share(e, rule.stretch_linear[k])
            shapes(rule, e, shape)
            _add_first(
                forces, 0, f * g[e, 0, 0] + h * grad_stretch[e, 0],
                f * g[e, 0, 1] + h * grad_stretch[e, 1], f * g[e, 0, 2], f * g[e, 0, 3], shape,
            )  # fmt: skip
        add_forces(forces, PLANAR, rule.span[3 * k], out)


@njit(**FLAGS)
def strain_increments(rule, grad_stretch, grad_other, dq, stretch, other):
    """First-order strains of an increment dq (n, 2)."""
    for e in range(rule.weight.size):
        px, pz, sx, sz = _point(dq, rule.span[e], rule.b1, rule.b2, e)
        g = grad_other
        stretch[e] = grad_stretch[e, 0] * px + grad_stretch[e, 1] * pz
        other[e, 0] = g[e, 0, 0] * px + g[e, 0, 1] * pz + g[e, 0, 2] * sx + g[e, 0, 3] * sz
        other[e, 1], other[e, 2] = 0.0, 0.0
    for k in range(rule.weight.size // 3):
        span_stretch(stretch[3 * k : 3 * k + 3], rule.stretch_linear[k])
