"""Compiled forces and stiffness of the spline rod in space.

The stiffness of a knot span is gathered in a `block` of its own, see `spans`, and then added to the
banded matrix.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod import derivatives
from dlo_ros.rod.kernels import angle, slopes, span_stretch, span_twist, tension_share
from dlo_ros.rod.lanes import add_rows
from dlo_ros.rod.spans import (
    BLOCK, POINT, PRODUCTS, SHAPE, SHAPES, SLOPE, VALUE, add_block, add_forces, add_squares, mean,
    shapes, slope_products, tilt, value_products,
)  # fmt: skip
from dlo_ros.rod.tables import DOF
from dlo_ros.rod.vectors import FLAGS, INLINE, dot, mix, mix3, put, row, times

# Rows of the block: coordinates x, y, z, theta, the second not behind the first.
XX, YX, YY, ZX, ZY, ZZ, TX, TY, TZ, TT = range(0, 160, 16)


@njit(**INLINE)
def _stress(response, rule, e):
    """Stress resultants at point e and tangents of bending, times the point's weight."""
    wt, bend, tangent = rule.weight[e], response.bend, response.bend_tangent
    return derivatives.Stress(
        wt * response.tension[e] * tension_share(e, rule.stretch_linear[e // 3]),
        wt * bend[e, 0], wt * bend[e, 1], wt * response.torque[e],
        wt * tangent[e, 0], wt * tangent[e, 1], wt * tangent[e, 2],
    )  # fmt: skip


@njit(**INLINE)
def _add_second(block, h, products):
    """Add the second derivatives of a point to the block."""
    (xx, _, _), (yx, yy, _), (zx, zy, zz) = h.pp
    x, y, z = h.ps
    (sxx, _, _), (syx, syy, _), (szx, szy, szz) = h.ss
    add_rows(block, XX, (xx, x[0], x[0], sxx), products, SLOPE, 16)
    add_rows(block, YX, (yx, y[0], x[1], syx), products, SLOPE, 16)
    add_rows(block, YY, (yy, y[1], y[1], syy), products, SLOPE, 16)
    add_rows(block, ZX, (zx, z[0], x[2], szx), products, SLOPE, 16)
    add_rows(block, ZY, (zy, z[1], y[2], szy), products, SLOPE, 16)
    add_rows(block, ZZ, (zz, z[2], z[2], szz), products, SLOPE, 16)
    add_rows(block, TX, (h.p_theta[0], h.s_theta[0]), products, VALUE, 16)
    add_rows(block, TY, (h.p_theta[1], h.s_theta[1]), products, VALUE, 16)
    add_rows(block, TZ, (h.p_theta[2], h.s_theta[2]), products, VALUE, 16)
    add_rows(block, TT, (h.theta,), products, VALUE + 32, 16)


@njit(**INLINE)
def _add_first(out, at, by_p, by_s, theta, rate, shape):
    """Add derivatives by p, s, theta and theta' of a point to those by the span's 16 numbers."""
    add_rows(out, at, (by_p[0], by_s[0]), shape, SHAPE, 4)
    add_rows(out, at + 4, (by_p[1], by_s[1]), shape, SHAPE, 4)
    add_rows(out, at + 8, (by_p[2], by_s[2]), shape, SHAPE, 4)
    add_rows(out, at + 12, (theta, rate), shape, 0, 4)


@njit(**FLAGS)
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
    block, products, shape = np.empty(BLOCK * 10), np.empty(PRODUCTS), np.empty(SHAPES)
    forces, pull, turn = np.empty(POINT), np.empty(2 * POINT), np.empty(2 * POINT)
    nothing = (0.0, 0.0, 0.0)
    for k in range(rule.weight.size // 3):
        block[:], forces[:], pull[:], turn[:] = 0.0, 0.0, 0.0, 0.0
        stretch_line, twist_line = rule.stretch_linear[k], rule.twist_linear[k]
        for point in range(3):
            e = 3 * k + point
            kappa1, kappa2 = other[e, 0], other[e, 1]
            f = _stress(response, rule, e)
            x = derivatives.first(q, rule, ref, e, kappa1, kappa2)
            shapes(rule, e, shape)
            slope_products(rule, e, products)
            value_products(rule, e, products)
            _add_second(block, derivatives.second(x, kappa1, kappa2, f), products)
            _add_first(
                forces, 0,
                mix(1.0, mix3(f.bend1, x.kappa1_p, f.bend2, x.kappa2_p, f.torque, x.twist_p),
                    f.tension, x.t),
                mix3(f.bend1, x.kappa1_s, f.bend2, x.kappa2_s, f.torque, x.a),
                f.bend1 * kappa2 - f.bend2 * kappa1, f.torque, shape,
            )  # fmt: skip
            m = mean(point, False)
            _add_first(turn, 0, times(m, x.twist_p), times(m, x.a), 0.0, m, shape)
            if twist_line:
                m = tilt(point)
                _add_first(turn, POINT, times(m, x.twist_p), times(m, x.a), 0.0, m, shape)
            m = mean(point, not stretch_line)
            if m != 0.0:
                _add_first(pull, 0, times(m, x.t), nothing, 0.0, 0.0, shape)
            if stretch_line:
                _add_first(pull, POINT, times(tilt(point), x.t), nothing, 0.0, 0.0, shape)
            put(grad_stretch, e, x.t)
            _keep(grad_other, e, x, kappa1, kappa2)
        length = rule.weight[3 * k] + rule.weight[3 * k + 1] + rule.weight[3 * k + 2]
        modulus = length * response.stretch_tangent[3 * k]
        add_squares(block, 3, modulus, pull, stretch_line)
        add_squares(block, 4, length * response.twist_tangent[3 * k], turn, twist_line)
        add_block(block, DOF, rule.span[3 * k], band)
        add_forces(forces, DOF, rule.span[3 * k], gradient)


@njit(**INLINE)
def _keep(grad, e, x, kappa1, kappa2):
    """Write the derivatives of the strains at point e, see `assemble`."""
    _put(grad, e, 0, x.kappa1_p, x.kappa1_s, kappa2, 0.0)
    _put(grad, e, 1, x.kappa2_p, x.kappa2_s, -kappa1, 0.0)
    _put(grad, e, 2, x.twist_p, x.a, 0.0, 1.0)


@njit(**INLINE)
def _put(grad, e, a, by_p, by_s, theta, rate):
    grad[e, a, 0], grad[e, a, 1], grad[e, a, 2] = by_p
    grad[e, a, 3], grad[e, a, 4], grad[e, a, 5] = by_s
    grad[e, a, 6], grad[e, a, 7] = theta, rate


@njit(**INLINE)
def _by_p(grad, e, a):
    return grad[e, a, 0], grad[e, a, 1], grad[e, a, 2]


@njit(**INLINE)
def _by_s(grad, e, a):
    return grad[e, a, 3], grad[e, a, 4], grad[e, a, 5]


@njit(**FLAGS)
def scatter_stress(rule, grad_stretch, grad_other, stress_s, stress_o, out):
    """Add the generalised force of given stresses, sum of weight stress d(strain)/dq, to out.

    Stresses of stretch and twist hold for a whole span, as their strains do.
    """
    shape, forces = np.empty(SHAPES), np.empty(POINT)
    for k in range(rule.weight.size // 3):
        forces[:] = 0.0
        for e in range(3 * k, 3 * k + 3):
            wt, g = rule.weight[e], grad_other
            f1, f2, f3 = wt * stress_o[e, 0], wt * stress_o[e, 1], wt * stress_o[e, 2]
            tension = wt * stress_s[e] * tension_share(e, rule.stretch_linear[k])
            bent = mix3(f1, _by_p(g, e, 0), f2, _by_p(g, e, 1), f3, _by_p(g, e, 2))
            shapes(rule, e, shape)
            _add_first(
                forces, 0, mix(1.0, bent, tension, row(grad_stretch, e)),
                mix3(f1, _by_s(g, e, 0), f2, _by_s(g, e, 1), f3, _by_s(g, e, 2)),
                f1 * g[e, 0, 6] + f2 * g[e, 1, 6], f3, shape,
            )  # fmt: skip
        add_forces(forces, DOF, rule.span[3 * k], out)


@njit(**FLAGS)
def strain_increments(rule, grad_stretch, grad_other, dq, stretch, other):
    """First-order strains of an increment dq (n, 4): the transpose of `scatter_stress`."""
    for e in range(rule.weight.size):
        span, g = rule.span[e], grad_other
        p, s = slopes(dq, span, rule.b1, rule.b2, e)
        theta, rate = angle(dq, span, rule.b, e), angle(dq, span, rule.b1, e)
        stretch[e] = dot(row(grad_stretch, e), p)
        other[e, 0] = dot(_by_p(g, e, 0), p) + dot(_by_s(g, e, 0), s) + g[e, 0, 6] * theta
        other[e, 1] = dot(_by_p(g, e, 1), p) + dot(_by_s(g, e, 1), s) + g[e, 1, 6] * theta
        other[e, 2] = dot(_by_p(g, e, 2), p) + dot(_by_s(g, e, 2), s) + rate
    for k in range(rule.weight.size // 3):
        span_stretch(stretch[3 * k : 3 * k + 3], rule.stretch_linear[k])
        span_twist(other[3 * k : 3 * k + 3, 2], rule.twist_linear[k])
