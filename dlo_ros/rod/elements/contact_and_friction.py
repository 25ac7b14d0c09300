# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled contact forces: friction with the board, pegs, walls; and quadratic drag.

Contact and friction act in the board's plane, on x and z. Friction is a spring to an anchor that
slides along once its force reaches the Coulomb limit, so a DLO sticks truly; the anchor is part of
the state. A peg or a wall pushes back in proportion to how deep the DLO's axis is within its reach,
without friction.

Quadratic drag is a force per length -c |v_n| v_n against the velocity across the DLO. Within a step
|v_n| and the direction are predicted from the past, to second order in the step, so that the force
is linear in the velocity at the step's end, and that velocity in the position: a spring across the
DLO to the place where it would not move.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked


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
def any_surroundings(around):
    """Whether `add_contact_and_friction` has any force to add."""
    return (
        around.friction > 0.0
        or around.pegs.shape[0] > 0
        or around.walls.shape[0] > 0
        or around.tow.shape[0] > 0
    )


@linked()
def drag_springs(rule, coefficient, q, velocity, still, rate):
    """Quadratic drag of one step as springs across the DLO.

    Args:
        coefficient: c, times the true length over that of the basis [N s^2/m^3].
        q, velocity: control points and their velocities by which direction and speed are judged,
            shape (n, d).
        still: control points at which the DLO would not move, shape (n, d).
        rate: velocity over the distance from there [1/s].

    Returns:
        For each quadrature point a stiffness across the DLO [N/m^2], the tangent and the point at
        which there is no force [m], shape (nb, 1 + 2 m) for m coordinates.
    """
    count = min(q.shape[1], 3)
    result = np.zeros((rule.weight.size, 1 + 2 * count))
    for e in range(rule.weight.size):
        row = result[e]
        long, fast, along = 0.0, 0.0, 0.0
        for c in range(count):
            speed = 0.0
            for i in range(4):
                at = rule.span[e] + i
                row[1 + c] += rule.b1[e, i] * q[at, c]
                row[1 + count + c] += rule.b[e, i] * still[at, c]
                speed += rule.b[e, i] * velocity[at, c]
            long += row[1 + c] * row[1 + c]
            fast += speed * speed
            along += row[1 + c] * speed
        size = np.sqrt(long)
        for c in range(count):
            row[1 + c] /= size
        row[0] = coefficient * rate * np.sqrt(max(fast - along * along / long, 0.0))
    return result


@linked()
def _tow(q, rule, tow, gradient, band):
    """Add the quadratic drag of a step and its tangent to gradient and banded matrix."""
    dof, last = q.shape[1], band.shape[1] - 1
    count = min(dof, 3)
    away = np.empty(count)
    for e in range(rule.weight.size):
        t, stiff = tow[e, 1 : 1 + count], rule.weight[e] * tow[e, 0]
        along = 0.0
        for c in range(count):
            away[c] = -tow[e, 1 + count + c]
            for i in range(4):
                away[c] += rule.b[e, i] * q[rule.span[e] + i, c]
            along += t[c] * away[c]
        for i in range(4):
            for c in range(count):
                row = dof * (rule.span[e] + i) + c
                gradient[row] += stiff * rule.b[e, i] * (away[c] - along * t[c])
                for j in range(i + 1):
                    share = stiff * rule.b[e, i] * rule.b[e, j]
                    for d in range(count):
                        column = dof * (rule.span[e] + j) + d
                        if column <= row:
                            unit = 1.0 if c == d else 0.0
                            band[row, last - row + column] += share * (unit - t[c] * t[d])


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
    if around.tow.shape[0] > 0:
        _tow(q, rule, around.tow, gradient, band)
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
