# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Laws beyond linear elasticity for the planar discrete rod, compiled as with numba's @njit.

Each law is stated as an incremental potential: over one time step it is an energy whose gradient is
the law's force at the end of the step. All of them are convex (but for the geometry of a peg), so
that Newton's method with a line search finds the one solution of a step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.spline import FloatArray


class BendingLaw(NamedTuple):
    """Moment against turning angle of each vertex; arrays of shape (N + 1,).

    A saturating spring with a plastic slider in series, and a hysteretic element beside them.

    Args:
        active: whether the law replaces the linear one.
        stiffness: k of the unbent vertex [J].
        rest: turning angle at rest [rad].
        half: angle at which the tangent stiffness is half of k [rad], infinite where linear.
        limit: moment less back stress at which the slider yields [J], infinite for none.
        hardening: slope of the back stress [J].
        plastic: the slider's angle before the step [rad].
        drag: largest moment of the hysteretic element [J], 0 for none.
        width: angle over which that moment turns round [rad].
        drag_state: frictional moment before the step, over `drag`, -1 to 1.
        turn: turning angle before the step [rad].
    """

    active: bool
    stiffness: FloatArray
    rest: FloatArray
    half: FloatArray
    limit: FloatArray
    hardening: FloatArray
    plastic: FloatArray
    drag: FloatArray
    width: FloatArray
    drag_state: FloatArray
    turn: FloatArray


class Friction(NamedTuple):
    """Coulomb friction of the nodes with the board.

    Args:
        active: whether there is any.
        limit: largest force on each node [N], shape (N + 1,).
        anchor: points to which the presliding springs are fixed [m], shape (N + 1, 2).
        slack: distance of a node from its anchor at which it slides [m].
    """

    active: bool
    limit: FloatArray
    anchor: FloatArray
    slack: float


class Wind(NamedTuple):
    """Drag that grows with the square of the velocity across the DLO; v = rate x + past.

    Args:
        active: whether there is any.
        coefficient: drag coefficient of each node [N s^2/m^2], shape (N + 1,).
        along: unit tangent of each node, shape (N + 1, 2).
        past: [m/s], shape (N + 1, 2).
        rate: [1/s].
    """

    active: bool
    coefficient: FloatArray
    along: FloatArray
    past: FloatArray
    rate: float


class Contact(NamedTuple):
    """Frictionless round pegs and a straight wall.

    Args:
        active: whether there are any.
        pegs: x, z and the distance of the DLO's axis at contact [m], shape (m, 3).
        stiffness: force per length of DLO and penetration [N/m^2].
        spacing: distance of the points of the DLO that are checked [m].
        wall: unit normal x, z and where along it the DLO's axis touches [m], shape (3,), or none.
    """

    active: bool
    pegs: FloatArray
    stiffness: float
    spacing: float
    wall: FloatArray


def _spring(k: float, half: float, strain: float) -> tuple[float, float, float]:
    """Energy, moment and tangent of a spring of tangent stiffness k / (1 + (strain / half)^2)."""
    if math.isinf(half):
        return 0.5 * k * strain * strain, k * strain, k
    q = strain / half
    turned = math.atan(q)
    energy = k * half * (strain * turned - 0.5 * half * math.log1p(q * q))
    return energy, k * half * turned, k / (1.0 + q * q)


def _slide(law: BendingLaw, i: int, turn: float) -> float:
    """Displacement of the plastic slider when vertex i comes to a turning angle [rad]."""
    k, half = law.stiffness[i], law.half[i]
    h, before = law.hardening[i], law.plastic[i]
    trial = turn - law.rest[i] - before
    _, moment, _ = spring(k, half, trial)
    excess = moment - h * before
    sign = 1.0 if excess > 0.0 else -1.0
    if sign * excess <= law.limit[i]:
        return 0.0
    moved = 0.0
    for _ in range(50):
        _, moment, tangent = spring(k, half, trial - sign * moved)
        miss = sign * (moment - h * (before + sign * moved)) - law.limit[i]
        change = miss / (tangent + h)
        moved += change
        if abs(change) <= 1e-14 * abs(trial):
            break
    return sign * moved


def _bend(law: BendingLaw, i: int, turn: float) -> tuple[float, float, float]:
    """Incremental energy [J], moment [J] and tangent stiffness [J] of vertex i."""
    k, half = law.stiffness[i], law.half[i]
    moved = 0.0
    if not math.isinf(law.limit[i]):
        moved = slide(law, i, turn)
    plastic = law.plastic[i] + moved
    energy, moment, tangent = spring(k, half, turn - law.rest[i] - plastic)
    if moved != 0.0:
        h = law.hardening[i]
        before = law.plastic[i]
        energy += 0.5 * h * (plastic * plastic - before * before) + law.limit[i] * abs(moved)
        tangent = tangent * h / (tangent + h)
    if law.drag[i] > 0.0:
        change = turn - law.turn[i]
        sign = 1.0 if change > 0.0 else -1.0
        away = abs(change) / law.width[i]
        gap = 1.0 - sign * law.drag_state[i]
        decay = math.exp(-away)
        energy += law.drag[i] * law.width[i] * (away - gap * (1.0 - decay))
        moment += law.drag[i] * sign * (1.0 - gap * decay)
        tangent += law.drag[i] * gap * decay / law.width[i]
    return energy, moment, tangent


def _yield_to(law: BendingLaw, turn: FloatArray) -> None:
    """Bring the law's history to the end of a step, in place; `turn` is the new angle."""
    for i in range(turn.shape[0]):
        if not math.isinf(law.limit[i]):
            law.plastic[i] += slide(law, i, turn[i])
        if law.drag[i] > 0.0:
            change = turn[i] - law.turn[i]
            sign = 1.0 if change > 0.0 else -1.0
            gap = 1.0 - sign * law.drag_state[i]
            law.drag_state[i] = sign * (1.0 - gap * math.exp(-abs(change) / law.width[i]))
        law.turn[i] = turn[i]


def _drag_nodes(friction: Friction, x: FloatArray, gradient: FloatArray, band: FloatArray) -> float:
    """Energy [J] of the friction: quadratic within the slack, growing steadily beyond.

    Args:
        x: nodes [m], shape (N + 1, 2).
        gradient, band: arrays to which the derivatives are added, as in `rod_kernels.elastic`.
    """
    total = 0.0
    for i in range(x.shape[0]):
        limit, slack = friction.limit[i], friction.slack
        if not limit > 0.0:
            continue
        dx, dz = x[i, 0] - friction.anchor[i, 0], x[i, 1] - friction.anchor[i, 1]
        size = math.sqrt(dx * dx + dz * dz)
        if size <= slack:
            k = limit / slack
            total += 0.5 * k * size * size
            gradient[i, 0] += k * dx
            gradient[i, 1] += k * dz
            band[0, 2 * i] += k
            band[0, 2 * i + 1] += k
        else:
            total += limit * (size - 0.5 * slack)
            nx, nz = dx / size, dz / size
            gradient[i, 0] += limit * nx
            gradient[i, 1] += limit * nz
            across = limit / size
            band[0, 2 * i] += across * nz * nz
            band[1, 2 * i] -= across * nx * nz
            band[0, 2 * i + 1] += across * nx * nx
    return total


def _pull_anchors(friction: Friction, x: FloatArray) -> None:
    """Let the anchors follow nodes that have slid, in place."""
    for i in range(x.shape[0]):
        dx, dz = x[i, 0] - friction.anchor[i, 0], x[i, 1] - friction.anchor[i, 1]
        size = math.sqrt(dx * dx + dz * dz)
        if size > friction.slack:
            friction.anchor[i, 0] = x[i, 0] - dx * friction.slack / size
            friction.anchor[i, 1] = x[i, 1] - dz * friction.slack / size


def _press(
    contact: Contact,
    x: FloatArray,
    lengths: FloatArray,
    gradient: FloatArray,
    band: FloatArray,
) -> float:
    """Energy [J] of pegs that press on the DLO: k / 2 times the square of the penetration over u.

    A polygon would rattle over a peg. The points that touch it lie on the quadratic B-spline whose
    control points are the nodes, which is smooth and couples no more than three nodes.

    Args:
        x: nodes [m], shape (N + 1, 2).
        lengths: lengths of the edges [m], shape (N,).
        gradient, band: arrays to which the derivatives are added, as in `rod_kernels.elastic`.
    """
    total = 0.0
    last = x.shape[0] - 1
    share = np.empty(3)
    for m in range(contact.pegs.shape[0]):
        cx, cz, radius = contact.pegs[m, 0], contact.pegs[m, 1], contact.pegs[m, 2]
        for i in range(last + 1):
            reach = 0.0
            if i > 0:
                reach += lengths[i - 1]
            if i < last:
                reach += lengths[i]
            if math.hypot(x[i, 0] - cx, x[i, 1] - cz) > radius + reach:
                continue
            count = math.ceil(0.5 * reach / contact.spacing)
            k = contact.stiffness * 0.5 * reach / count
            for q in range(count):
                t = (q + 0.5) / count
                if i == 0:
                    share[0], share[1], share[2] = 0.0, 1.0 - 0.5 * t, 0.5 * t
                elif i == last:
                    share[0], share[1], share[2] = 0.5 - 0.5 * t, 0.5 + 0.5 * t, 0.0
                else:
                    share[0], share[2] = 0.5 * (1.0 - t) ** 2, 0.5 * t * t
                    share[1] = 1.0 - share[0] - share[2]
                px, pz = -cx, -cz
                for a in range(3):
                    if share[a] > 0.0:
                        px += share[a] * x[i - 1 + a, 0]
                        pz += share[a] * x[i - 1 + a, 1]
                distance = math.sqrt(px * px + pz * pz)
                depth = radius - distance
                if depth <= 0.0 or distance == 0.0:
                    continue
                nx, nz = px / distance, pz / distance
                total += 0.5 * k * depth * depth
                along, across = k, -k * depth / distance
                hxx = along * nx * nx + across * nz * nz
                hxz = (along - across) * nx * nz
                hzz = along * nz * nz + across * nx * nx
                for a in range(3):
                    if share[a] == 0.0:
                        continue
                    row = 2 * (i - 1 + a)
                    gradient[i - 1 + a, 0] -= k * depth * nx * share[a]
                    gradient[i - 1 + a, 1] -= k * depth * nz * share[a]
                    for b in range(a + 1):
                        w = share[a] * share[b]
                        column = 2 * (i - 1 + b)
                        if w == 0.0:
                            continue
                        band[row - column, column] += w * hxx
                        band[row + 1 - column, column] += w * hxz
                        band[row - column, column + 1] += w * hzz
                        if a != b:
                            band[row - column - 1, column + 1] += w * hxz
    return total


def _lean(
    contact: Contact, x: FloatArray, lengths: FloatArray, gradient: FloatArray, band: FloatArray
) -> float:
    """Energy [J] of a wall that presses on the nodes; arguments as in `press`."""
    total = 0.0
    last = x.shape[0] - 1
    nx, nz = contact.wall[0], contact.wall[1]
    for i in range(last + 1):
        depth = nx * x[i, 0] + nz * x[i, 1] - contact.wall[2]
        if depth >= 0.0:
            continue
        reach = 0.0
        if i > 0:
            reach += lengths[i - 1]
        if i < last:
            reach += lengths[i]
        k = contact.stiffness * 0.5 * reach
        total += 0.5 * k * depth * depth
        gradient[i, 0] += k * depth * nx
        gradient[i, 1] += k * depth * nz
        band[0, 2 * i] += k * nx * nx
        band[1, 2 * i] += k * nx * nz
        band[0, 2 * i + 1] += k * nz * nz
    return total


def _blow(wind: Wind, x: FloatArray, gradient: FloatArray, band: FloatArray) -> float:
    """Potential [J] of the quadratic drag in a step: c |v_n|^3 / 3 over the rate of v by x.

    Args:
        x: nodes [m], shape (N + 1, 2).
        gradient, band: arrays to which the derivatives are added, as in `rod_kernels.elastic`.
    """
    total = 0.0
    for i in range(x.shape[0]):
        nx, nz = -wind.along[i, 1], wind.along[i, 0]
        speed = nx * (wind.rate * x[i, 0] + wind.past[i, 0])
        speed += nz * (wind.rate * x[i, 1] + wind.past[i, 1])
        c, size = wind.coefficient[i], abs(speed)
        total += c * size**3 / (3.0 * wind.rate)
        force, k = c * size * speed, 2.0 * c * size * wind.rate
        gradient[i, 0] += force * nx
        gradient[i, 1] += force * nz
        band[0, 2 * i] += k * nx * nx
        band[1, 2 * i] += k * nx * nz
        band[0, 2 * i + 1] += k * nz * nz
    return total


spring = njit(from_python=False)(_spring)
slide = njit(from_python=False)(_slide)
bend = njit()(_bend)
yield_to = njit()(_yield_to)
pull_anchors = njit()(_pull_anchors)
drag_nodes = linked()(_drag_nodes)
press = linked(from_python=True)(_press)
lean = linked(from_python=True)(_lean)
blow = linked()(_blow)
