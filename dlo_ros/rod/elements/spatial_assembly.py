# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled forces and stiffness of the spline rod in space.

The derivatives at the three points of a knot span are computed at once, in the lanes of vectors
(`four_lanes`); the span's stiffness is gathered in a `block` of its own (`element_stiffness`)
and then added to the banded matrix.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.element_stiffness import (
    BLOCK,
    FIRST,
    PRODUCTS,
    TURN_SQUARES,
    TURNS,
    add_block,
    add_forces,
    add_squares,
    couple,
    derive,
    means,
    slope_products,
    tilts,
    turn_products,
)  # fmt: skip
from dlo_ros.rod.elements.rod_tables import DOF
from dlo_ros.rod.elements.strain_derivatives import Stress, first, second
from dlo_ros.rod.elements.strains import (
    angle,
    column,
    slopes,
    span_stretch,
    span_twist,
    tension_share,
    three,
    vectors,
)  # fmt: skip
from dlo_ros.rod.simd.four_lanes import lane, lanes, quad
from dlo_ros.rod.simd.row_operations import set_rows
from dlo_ros.rod.simd.vector_algebra import FLAGS, INLINE, dot, mix, mix3, times

# Rows of the block: coordinates x, y, z, theta, the second not behind the first.
XX, YX, YY, ZX, ZY, ZZ, TX, TY, TZ, TT = range(0, 160, 16)


@njit(**INLINE)
def stress_at(response, rule, e):
    """Stress at the points of a span, times their weight."""
    wt, bend, tangent = three(rule.weight, e), response.bend, response.bend_tangent
    return Stress(
        wt * three(response.tension, e) * tension_share(rule.stretch_linear[e // 3]),
        wt * column(bend, e, 0), wt * column(bend, e, 1), wt * three(response.torque, e),
        wt * column(tangent, e, 0), wt * column(tangent, e, 1), wt * column(tangent, e, 2),
        wt * three(response.pull, e) * tension_share(rule.stretch_linear[e // 3]),
    )  # fmt: skip


@njit(**INLINE)
def _fill(block, h, products):
    """Write second derivatives at the points of a span to its block."""
    (xx, _, _), (yx, yy, _), (zx, zy, zz) = h.pp
    x, y, z = h.ps
    (sxx, _, _), (syx, syy, _), (szx, szy, szz) = h.ss
    couple(block, XX, xx, x[0], x[0], sxx, products)
    couple(block, YX, yx, y[0], x[1], syx, products)
    couple(block, YY, yy, y[1], y[1], syy, products)
    couple(block, ZX, zx, z[0], x[2], szx, products)
    couple(block, ZY, zy, z[1], y[2], szy, products)
    couple(block, ZZ, zz, z[2], z[2], szz, products)
    _turn(block, TX, h.p_theta[0], h.s_theta[0], products)
    _turn(block, TY, h.p_theta[1], h.s_theta[1], products)
    _turn(block, TZ, h.p_theta[2], h.s_theta[2], products)
    set_rows(block, TT, lanes(h.theta), products, TURN_SQUARES, 16)


@njit(**INLINE)
def _turn(block, pair, p, s, products):
    """Write second derivatives by theta and a position."""
    factors = lane(p, 0), lane(s, 0), lane(p, 1), lane(s, 1), lane(p, 2), lane(s, 2)
    set_rows(block, pair, factors, products, TURNS, 16)


@njit(**INLINE)
def derive_all(out, at, p, s, theta, rate, rule, e):
    """Write derivatives by the span's 16 numbers, given those by p, s, theta and theta'."""
    derive(out, at, p[0], rule.b1, s[0], rule.b2, e)
    derive(out, at + 4, p[1], rule.b1, s[1], rule.b2, e)
    derive(out, at + 8, p[2], rule.b1, s[2], rule.b2, e)
    derive(out, at + 12, theta, rule.b, rate, rule.b1, e)


@njit(**INLINE)
def _derive_stretch(out, at, p, rule, e):
    """Write derivatives by the span's 12 positions, given those by p."""
    for c, x in enumerate(p):
        set_rows(out, at + 4 * c, lanes(x), rule.b1, 4 * e, 4)


@njit(**INLINE)
def _derive_twist(out, at, weights, x, rule, e):
    """Write derivatives of a weighted sum of the twist at the points of a span."""
    zero = quad(0.0, 0.0, 0.0)
    derive_all(out, at, times(weights, x.twist_p), times(weights, x.a), zero, weights, rule, e)


@njit(**INLINE)
def _resist(out, f, x, kappa1, kappa2, rule, e):
    """Write the forces of the stresses at the points of a span."""
    bent = mix3(f.bend1, x.kappa1_p, f.bend2, x.kappa2_p, f.torque, x.twist_p)
    derive_all(
        out, 0,
        mix(1.0, bent, f.tension, x.t),
        mix3(f.bend1, x.kappa1_s, f.bend2, x.kappa2_s, f.torque, x.a),
        f.bend1 * kappa2 - f.bend2 * kappa1,
        f.torque, rule, e,
    )  # fmt: skip


@linked(**FLAGS)
def assemble(q, rule, ref, other, response, gradient, band, grad_stretch, grad_other):
    """Gradient of the strain energy and its exact Hessian.

    Args:
        q: configuration, shape (n, 4).
        rule, ref: tables, reference frame.
        other: bending and twist of q, shape (nb, 3), see `strains.strains`.
        response: stresses and tangents that belong to the strains of q.
        gradient: output, shape (4 n,), overwritten.
        band: output, lower rows of the Hessian, shape (4 n, 16): H[i, j] at [i, 15 - i + j].
        grad_stretch: output, derivative of the stretch with respect to p, shape (nb, 3).
        grad_other: output, derivatives of kappa_1, kappa_2, twist with respect to
            (p, s, theta, theta'), shape (nb, 3, 8). Neither is averaged over the span.
    """
    gradient[:] = 0.0
    band[:, :] = 0.0
    block, products = np.empty(10 * BLOCK), np.empty(PRODUCTS)
    forces, pull, turn = np.empty(FIRST), np.empty(2 * FIRST), np.empty(2 * FIRST)
    for k in range(rule.weight.size // 3):
        e, stretch_line, twist_line = 3 * k, rule.stretch_linear[k], rule.twist_linear[k]
        kappa1, kappa2 = column(other, e, 0), column(other, e, 1)
        f = stress_at(response, rule, e)
        x = first(q, rule, ref, e, kappa1, kappa2)
        slope_products(rule, e, products)
        turn_products(rule, e, products)
        _fill(block, second(x, kappa1, kappa2, f), products)
        _resist(forces, f, x, kappa1, kappa2, rule, e)
        _derive_stretch(pull, 0, times(means(not stretch_line), x.t), rule, e)
        if stretch_line:
            _derive_stretch(pull, FIRST, times(tilts(), x.t), rule, e)
        _derive_twist(turn, 0, means(False), x, rule, e)
        if twist_line:
            _derive_twist(turn, FIRST, tilts(), x, rule, e)
        _keep(grad_stretch, grad_other, e, x, kappa1, kappa2)
        length = rule.weight[e] + rule.weight[e + 1] + rule.weight[e + 2]
        add_squares(block, 3, length * response.stretch_tangent[e], pull, stretch_line)
        add_squares(block, 4, length * response.twist_tangent[e], turn, twist_line)
        add_block(block, DOF, rule.span[e], band)
        add_forces(forces, DOF, rule.span[e], gradient)


@njit(**INLINE)
def _keep(grad_stretch, grad_other, e, x, kappa1, kappa2):
    """Write the derivatives of the strains at the points of a span, see `assemble`."""
    for k in range(3):
        for c in range(3):
            grad_stretch[e + k, c] = lane(x.t[c], k)
        _put(grad_other, e + k, 0, x.kappa1_p, x.kappa1_s, lane(kappa2, k), 0.0, k)
        _put(grad_other, e + k, 1, x.kappa2_p, x.kappa2_s, -lane(kappa1, k), 0.0, k)
        _put(grad_other, e + k, 2, x.twist_p, x.a, 0.0, 1.0, k)


@njit(**INLINE)
def _put(grad, e, a, by_p, by_s, theta, rate, k):
    for c in range(3):
        grad[e, a, c], grad[e, a, 3 + c] = lane(by_p[c], k), lane(by_s[c], k)
    grad[e, a, 6], grad[e, a, 7] = theta, rate


@njit(**INLINE)
def _entry(grad, e, a, j):
    """Entry of the strains' derivatives at the points of a span."""
    return quad(grad[e, a, j], grad[e + 1, a, j], grad[e + 2, a, j])


@njit(**INLINE)
def by_p(grad, e, a):
    """Derivatives of strain a by p at the points of a span."""
    return _entry(grad, e, a, 0), _entry(grad, e, a, 1), _entry(grad, e, a, 2)


@njit(**INLINE)
def by_s(grad, e, a):
    """Derivatives of strain a by s at the points of a span."""
    return _entry(grad, e, a, 3), _entry(grad, e, a, 4), _entry(grad, e, a, 5)


@linked(**FLAGS)
def scatter_stress(rule, grad_stretch, grad_other, stress_s, stress_o, out):
    """Add the generalised force of given stresses, sum of weight stress d(strain)/dq, to out.

    Stresses of stretch and twist hold for a whole span, as their strains do.
    """
    forces, g = np.empty(FIRST), grad_other
    for k in range(rule.weight.size // 3):
        e = 3 * k
        wt = three(rule.weight, e)
        f1, f2, f3 = times(wt, vectors(stress_o, e))
        tension = wt * three(stress_s, e) * tension_share(rule.stretch_linear[k])
        bent = mix3(f1, by_p(g, e, 0), f2, by_p(g, e, 1), f3, by_p(g, e, 2))
        derive_all(
            forces, 0,
            mix(1.0, bent, tension, vectors(grad_stretch, e)),
            mix3(f1, by_s(g, e, 0), f2, by_s(g, e, 1), f3, by_s(g, e, 2)),
            f1 * _entry(g, e, 0, 6) + f2 * _entry(g, e, 1, 6),
            f3, rule, e,
        )  # fmt: skip
        add_forces(forces, DOF, rule.span[e], out)


@linked(**FLAGS)
def strain_increments(rule, grad_stretch, grad_other, dq, stretch, other):
    """First-order strains of an increment dq (n, 4): the transpose of `scatter_stress`."""
    g = grad_other
    for span in range(rule.weight.size // 3):
        e = 3 * span
        p, s = slopes(dq, rule, e)
        theta, rate = angle(dq, rule, rule.b, e), angle(dq, rule, rule.b1, e)
        pulled = dot(vectors(grad_stretch, e), p)
        bent1 = dot(by_p(g, e, 0), p) + dot(by_s(g, e, 0), s) + _entry(g, e, 0, 6) * theta
        bent2 = dot(by_p(g, e, 1), p) + dot(by_s(g, e, 1), s) + _entry(g, e, 1, 6) * theta
        turned = dot(by_p(g, e, 2), p) + dot(by_s(g, e, 2), s) + rate
        for k in range(3):
            stretch[e + k], other[e + k, 2] = lane(pulled, k), lane(turned, k)
            other[e + k, 0], other[e + k, 1] = lane(bent1, k), lane(bent2, k)
        span_stretch(stretch[e : e + 3], rule.stretch_linear[span])
        span_twist(other[e : e + 3, 2], rule.twist_linear[span])
