# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The strain energy where everything lies in the plane y = 0: x and z only, no frame.

A configuration is q of shape (n, 2). The only bending strain is the curvature about +y,
(p_z s_x - p_x s_z) / |p|^3, which is kappa_1 of the spatial rod whose first director is y.
Storage is that of `spatial_assembly`, with two degrees of freedom to a control point instead
of four.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.element_stiffness import (
    BLOCK,
    FIRST,
    PRODUCTS,
    add_block,
    add_forces,
    add_squares,
    couple,
    derive,
    means,
    slope_products,
    tilts,
)  # fmt: skip
from dlo_ros.rod.elements.strains import column, span_stretch, tension_share, three
from dlo_ros.rod.simd.four_lanes import lane, lanes, quad
from dlo_ros.rod.simd.row_operations import set_rows
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE

PLANAR = 2
XX, ZX, ZZ = 0, BLOCK, 2 * BLOCK  # pairs of coordinates


@njit(**INLINE)
def _slopes(q, rule, e):
    """Slopes p = r' and s = r'' at the points of the span that begins with point e."""
    span = rule.span[e]
    x, z = q[span, 0], q[span, 1]
    b1, b2 = column(rule.b1, e, 0), column(rule.b2, e, 0)
    px, pz, sx, sz = b1 * x, b1 * z, b2 * x, b2 * z
    for i in range(1, 4):
        x, z = q[span + i, 0], q[span + i, 1]
        b1, b2 = column(rule.b1, e, i), column(rule.b2, e, i)
        px += b1 * x
        pz += b1 * z
        sx += b2 * x
        sz += b2 * z
    return px, pz, sx, sz


@linked(from_python=True)
def tangents(q, rule, tangent, rate):
    """Write the unit tangents of a planar configuration in space (n, 4), and their derivatives.

    Args:
        tangent, rate: output, the latter along u [1/m], shape (nb, 3).
    """
    for e in range(rule.span.size):
        px, pz, sx, sz = 0.0, 0.0, 0.0, 0.0
        for i in range(4):
            x, z = q[rule.span[e] + i, 0], q[rule.span[e] + i, 2]
            px += rule.b1[e, i] * x
            pz += rule.b1[e, i] * z
            sx += rule.b2[e, i] * x
            sz += rule.b2[e, i] * z
        r = 1.0 / np.sqrt(px * px + pz * pz)
        tx, tz = px * r, pz * r
        along = tx * sx + tz * sz
        tangent[e, 0], tangent[e, 1], tangent[e, 2] = tx, 0.0, tz
        rate[e, 0], rate[e, 1], rate[e, 2] = (sx - along * tx) * r, 0.0, (sz - along * tz) * r


@linked(**FLAGS)
def strains(q, rule):
    """Stretch (nb,) of whole spans, and the curvature in the first column of (nb, 3)."""
    stretch = np.empty(rule.weight.size)
    other = np.zeros((rule.weight.size, 3))
    for k in range(rule.weight.size // 3):
        e = 3 * k
        px, pz, sx, sz = _slopes(q, rule, e)
        n = np.sqrt(px * px + pz * pz)
        r = 1.0 / n
        kappa = (pz * sx - px * sz) * (r * r * r)
        for j in range(3):
            other[e + j, 0], stretch[e + j] = lane(kappa, j), lane(n, j) - 1.0
        span_stretch(stretch[e : e + 3], rule.stretch_linear[k])
    return stretch, other


@njit(**INLINE)
def _derive(out, px, pz, sx, sz, rule, e):
    """Write derivatives by the span's 8 numbers, given those by p and s."""
    derive(out, 0, px, rule.b1, sx, rule.b2, e)
    derive(out, 4, pz, rule.b1, sz, rule.b2, e)


@linked(**FLAGS)
def assemble(q, rule, other, response, gradient, band, grad_stretch, grad_other):
    """Gradient (2 n,) and exact Hessian (2 n, 8); see `spatial_assembly.assemble`.

    grad_stretch (nb, 2) and grad_other (nb, 1, 4) become the derivatives of stretch and curvature
    with respect to p and (p, s).
    """
    gradient[:] = 0.0
    band[:, :] = 0.0
    block, products = np.empty(3 * BLOCK), np.empty(PRODUCTS)
    forces, pull = np.empty(FIRST), np.empty(2 * FIRST)
    for k in range(rule.weight.size // 3):
        e, line = 3 * k, rule.stretch_linear[k]
        wt, kappa = three(rule.weight, e), column(other, e, 0)
        px, pz, sx, sz = _slopes(q, rule, e)
        r2 = 1.0 / (px * px + pz * pz)
        r = np.sqrt(r2)
        g, tx, tz = r2 * r, px * r, pz * r
        tension = wt * three(response.tension, e) * tension_share(line)
        drawn = wt * three(response.pull, e) * tension_share(line)
        stress, b = wt * column(response.bend, e, 0), wt * column(response.bend_tangent, e, 0)
        # Gradient of the curvature with respect to (p_x, p_z, s_x, s_z).
        f = 3.0 * kappa * r2
        kpx, kpz, ksx, ksz = -sz * g - f * px, sx * g - f * pz, pz * g, -px * g
        # Second derivatives of kappa, times the stress, and the Gauss-Newton part; then those of
        # the stretch, times the tension.
        m, q15, fs, soft = 3.0 * g * r2 * stress, 5.0 * f * r2 * stress, f * stress, drawn * r
        hxx = b * kpx * kpx + 2.0 * m * sz * px - fs + q15 * px * px + soft * tz * tz
        hxz = b * kpx * kpz + m * (sz * pz - sx * px) + q15 * px * pz - soft * tx * tz
        hzz = b * kpz * kpz - 2.0 * m * sx * pz - fs + q15 * pz * pz + soft * tx * tx
        axx = b * kpx * ksx - m * px * pz
        axz = b * kpx * ksz - g * stress + m * px * px
        azx = b * kpz * ksx + g * stress - m * pz * pz
        azz = b * kpz * ksz + m * pz * px
        slope_products(rule, e, products)
        couple(block, XX, hxx, axx, axx, b * ksx * ksx, products)
        couple(block, ZX, hxz, azx, axz, b * ksx * ksz, products)
        couple(block, ZZ, hzz, azz, azz, b * ksz * ksz, products)
        fpx, fpz = stress * kpx + tension * tx, stress * kpz + tension * tz
        _derive(forces, fpx, fpz, stress * ksx, stress * ksz, rule, e)
        share, slant = means(not line), tilts()
        set_rows(pull, 0, lanes(share * tx), rule.b1, 4 * e, 4)
        set_rows(pull, 4, lanes(share * tz), rule.b1, 4 * e, 4)
        if line:
            set_rows(pull, FIRST, lanes(slant * tx), rule.b1, 4 * e, 4)
            set_rows(pull, FIRST + 4, lanes(slant * tz), rule.b1, 4 * e, 4)
        for j in range(3):
            grad_stretch[e + j, 0], grad_stretch[e + j, 1] = lane(tx, j), lane(tz, j)
            grad_other[e + j, 0, 0], grad_other[e + j, 0, 1] = lane(kpx, j), lane(kpz, j)
            grad_other[e + j, 0, 2], grad_other[e + j, 0, 3] = lane(ksx, j), lane(ksz, j)
        length = rule.weight[e] + rule.weight[e + 1] + rule.weight[e + 2]
        add_squares(block, PLANAR, length * response.stretch_tangent[e], pull, line)
        add_block(block, PLANAR, rule.span[e], band)
        add_forces(forces, PLANAR, rule.span[e], gradient)


@njit(**INLINE)
def _entry(grad, e, j):
    """Entry of the curvature's derivatives at the points of a span."""
    return quad(grad[e, 0, j], grad[e + 1, 0, j], grad[e + 2, 0, j])


@linked(**FLAGS)
def scatter_stress(rule, grad_stretch, grad_other, stress_s, stress_o, out):
    """Add the generalised force of given stresses to out (2 n,)."""
    forces, g = np.empty(FIRST), grad_other
    for k in range(rule.weight.size // 3):
        e = 3 * k
        wt = three(rule.weight, e)
        f, h = wt * column(stress_o, e, 0), wt * three(stress_s, e)
        h = h * tension_share(rule.stretch_linear[k])
        px = f * _entry(g, e, 0) + h * column(grad_stretch, e, 0)
        pz = f * _entry(g, e, 1) + h * column(grad_stretch, e, 1)
        _derive(forces, px, pz, f * _entry(g, e, 2), f * _entry(g, e, 3), rule, e)
        add_forces(forces, PLANAR, rule.span[e], out)


@linked(**FLAGS)
def strain_increments(rule, grad_stretch, grad_other, dq, stretch, other):
    """First-order strains of an increment dq (n, 2)."""
    g = grad_other
    for k in range(rule.weight.size // 3):
        e = 3 * k
        px, pz, sx, sz = _slopes(dq, rule, e)
        pulled = column(grad_stretch, e, 0) * px + column(grad_stretch, e, 1) * pz
        bent = _entry(g, e, 0) * px + _entry(g, e, 1) * pz
        bent += _entry(g, e, 2) * sx + _entry(g, e, 3) * sz
        for j in range(3):
            stretch[e + j], other[e + j, 0] = lane(pulled, j), lane(bent, j)
            other[e + j, 1], other[e + j, 2] = 0.0, 0.0
        span_stretch(stretch[e : e + 3], rule.stretch_linear[k])
