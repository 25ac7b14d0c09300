# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled contact forces: friction with the board, pegs, walls.

Contact and friction act in the board's plane, on x and z. Friction is a spring to an anchor that
slides along once its force reaches the Coulomb limit, so a DLO sticks truly; the anchor is part of
the state. A peg or a wall pushes back in proportion to how deep the DLO's axis is within its reach,
without friction.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.drag_springs import add_springs


@njit(inline="always")
def _position(q, span, b, z):
    x0, x1 = 0.0, 0.0
    for i in range(4):
        x0 += b[i] * q[span + i, 0]
        x1 += b[i] * q[span + i, z]
    return x0, x1


@njit(inline="always")
def friction(x0, x1, a0, a1, limit, creep):
    """Friction at a point (x0, x1) with its anchor at (a0, a1).

    Returns:
        Force against the motion [N/m], its tangent (11, 12, 22) [N/m^2], energy [J/m].
    """
    d0, d1 = x0 - a0, x1 - a1
    size, stiff = np.sqrt(d0 * d0 + d1 * d1), limit / creep
    if size <= creep:
        return stiff * d0, stiff * d1, stiff, 0.0, stiff, 0.5 * stiff * size * size
    n0, n1, across = d0 / size, d1 / size, limit / size
    return (
        limit * n0, limit * n1, across * n1 * n1, -across * n0 * n1, across * n0 * n0,
        limit * (size - 0.5 * creep),
    )  # fmt: skip


@njit(inline="always")
def contact(x0, x1, peg, stiff):
    """Push of a peg (x, z, reach) on a point: force, its tangent and energy as in `friction`."""
    d0, d1 = x0 - peg[0], x1 - peg[1]
    size = max(np.sqrt(d0 * d0 + d1 * d1), 1e-9 * peg[2])
    deep = size - peg[2]
    if deep >= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n0, n1, across = d0 / size, d1 / size, stiff * deep / size
    return (
        stiff * deep * n0, stiff * deep * n1,
        stiff * n0 * n0 + across * n1 * n1, (stiff - across) * n0 * n1,
        stiff * n1 * n1 + across * n0 * n0, 0.5 * stiff * deep * deep,
    )  # fmt: skip


@njit(inline="always")
def press(x0, x1, wall, stiff):
    """Push of a wall on a point: force, its tangent and energy as in `friction`."""
    deep = wall[0] * x0 + wall[1] * x1 - wall[2]
    if deep >= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n0, n1 = wall[0], wall[1]
    return (
        stiff * deep * n0, stiff * deep * n1, stiff * n0 * n0, stiff * n0 * n1, stiff * n1 * n1,
        0.5 * stiff * deep * deep,
    )  # fmt: skip


@njit(from_python=False)
def may_be_touched(around):
    """Whether there are forces that begin or turn over where the DLO moves on."""
    return around.friction > 0.0 or around.pegs.shape[0] > 0 or around.walls.shape[0] > 0


@njit(from_python=False)
def any_surroundings(around):
    """Whether `add_contact_and_friction` has any force to add."""
    return may_be_touched(around) or around.tow.pull.size > 0


@njit(from_python=False)
def _add(span, b, weight, dof, force, gradient, band):
    """Add a point's force and tangent to gradient and banded matrix."""
    f0, f1, t00, t01, t11, _ = force
    z, last = dof // 2, band.shape[1] - 1
    for i in range(4):
        at = dof * (span + i)
        gradient[at] += weight * b[i] * f0
        gradient[at + z] += weight * b[i] * f1
        for j in range(i + 1):
            share, k = weight * b[i] * b[j], last - dof * (i - j)
            band[at, k] += share * t00
            band[at + z, k] += share * t11
            band[at + z, k - z] += share * t01
            if j < i:
                band[at, k + z] += share * t01


@linked()
def add_contact_and_friction(q, rule, around, anchor, gradient, band):
    """Add the forces of the surroundings and their tangent.

    Args:
        q: configuration, shape (n, 4) or (n, 2).
        rule: quadrature tables.
        around: see `Surroundings`.
        anchor: see `InternalVariables`.
        gradient, band: see `spatial_assembly.assemble`.

    Returns:
        Their energy without that of quadratic drag, which is none at rest [J].
    """
    energy, dof = 0.0, q.shape[1]
    if around.friction > 0.0:
        for e in range(rule.weight.size):
            x0, x1 = _position(q, rule.span[e], rule.b[e], dof // 2)
            force = friction(x0, x1, anchor[e, 0], anchor[e, 1], around.friction, around.creep)
            _add(rule.span[e], rule.b[e], rule.weight[e], dof, force, gradient, band)
            energy += rule.weight[e] * force[5]
    for peg in around.pegs:
        for e in range(around.weight.size):
            x0, x1 = _position(q, around.span[e], around.b[e], dof // 2)
            force = contact(x0, x1, peg, around.contact)
            if force[5] > 0.0:
                _add(around.span[e], around.b[e], around.weight[e], dof, force, gradient, band)
                energy += around.weight[e] * force[5]
    for wall in around.walls:
        for e in range(around.weight.size):
            x0, x1 = _position(q, around.span[e], around.b[e], dof // 2)
            force = press(x0, x1, wall, around.contact)
            if force[5] > 0.0:
                _add(around.span[e], around.b[e], around.weight[e], dof, force, gradient, band)
                energy += around.weight[e] * force[5]
    if around.tow.pull.size > 0:
        add_springs(q, around.tow, gradient, band)
    return energy


@linked()
def energy_of(q, rule, around, anchor):
    """Energy of the surroundings' forces [J]; see `add_contact_and_friction`."""
    energy, z = 0.0, q.shape[1] // 2
    if around.friction > 0.0:
        for e in range(rule.weight.size):
            x0, x1 = _position(q, rule.span[e], rule.b[e], z)
            energy += (
                rule.weight[e]
                * friction(x0, x1, anchor[e, 0], anchor[e, 1], around.friction, around.creep)[5]
            )
    for peg in around.pegs:
        for e in range(around.weight.size):
            x0, x1 = _position(q, around.span[e], around.b[e], z)
            energy += around.weight[e] * contact(x0, x1, peg, around.contact)[5]
    for wall in around.walls:
        for e in range(around.weight.size):
            x0, x1 = _position(q, around.span[e], around.b[e], z)
            energy += around.weight[e] * press(x0, x1, wall, around.contact)[5]
    return energy


@linked()
def drag_along(q, rule, around, anchor, out):
    """Write the anchors (nb, 2) after a motion to q to out, moved as little as friction demands."""
    if anchor.shape[0] == 0:
        return
    for e in range(rule.weight.size):
        x0, x1 = _position(q, rule.span[e], rule.b[e], q.shape[1] // 2)
        d0, d1 = x0 - anchor[e, 0], x1 - anchor[e, 1]
        size = np.sqrt(d0 * d0 + d1 * d1)
        share = around.creep / max(size, around.creep)
        out[e, 0], out[e, 1] = x0 - share * d0, x1 - share * d1


@linked(from_python=True)
def rest_anchor(q, rule):
    """Anchors (nb, 2) at which a configuration feels no friction."""
    result = np.empty((rule.weight.size, 2))
    for e in range(rule.weight.size):
        result[e, 0], result[e, 1] = _position(q, rule.span[e], rule.b[e], q.shape[1] // 2)
    return result
