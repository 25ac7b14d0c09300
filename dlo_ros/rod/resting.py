"""Compiled search for static equilibrium under imposed motion, led along a path."""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod import forces, solver
from dlo_ros.rod.grips import DIRECTOR, TANGENT
from dlo_ros.rod.stepping import (
    DONE,
    NO_CONVERGENCE,
    NO_DIRECTION,
    Moving,
    grown,
    growth,
    remembered,
    targets,
)
from dlo_ros.rod.surroundings import rest_anchor
from dlo_ros.rod.tables import History, Material, Surroundings

MOVE_LIMIT = 0.05  # imposed motion per increment, of L
TURN_LIMIT = 0.15  # imposed rotation per increment [rad]


@njit(cache=True, nogil=True)
def _increments(system, q, target, gap, before, after):
    """In how many steps the imposed motion is made, so that the branch is not lost."""
    move, turn, dof = np.abs(gap).max() if gap.size else 0.0, 0.0, q.shape[1]
    for i in range(q.size):
        if system.fixed[i]:
            change = abs(target.ravel()[i] - q.ravel()[i])
            if i % dof == 3:
                turn = max(turn, change)
            else:
                move = max(move, change)
    for end in range(2):
        cosine = np.dot(before[end, TANGENT:DIRECTOR], after[end, TANGENT:DIRECTOR])
        turn = max(turn, np.arccos(min(max(cosine, -1.0), 1.0)))
    steps = max(move / system.length / MOVE_LIMIT, turn / TURN_LIMIT)
    return max(1, int(np.ceil(steps)))


@njit(cache=True, nogil=True)
def _untouched(a):
    """Surroundings without friction, which a DLO at its start has not felt yet."""
    return Surroundings(0.0, a.creep, a.pegs, a.contact, a.span, a.b, a.weight)


@njit(cache=True, nogil=True)
def settle(system, imposed, state, time, rate2, tolerance, fresh):
    """Static equilibrium at a time, on the branch that leads there from a state.

    Args:
        system, imposed, state: the rod, its command, where it is.
        time: [s] from the command's start.
        rate2: see `solver.equilibrium`.
        tolerance: convergence, of L.
        fresh: whether the DLO starts there: it has come without friction, and bent but once.

    Returns:
        Status, the state at rest, Newton iterations, and the number of negative eigenvalues of
        the stiffness (0: stable).
    """
    body = grown(system, growth(imposed, time))
    frames = state.frames.copy()
    usable, target, gap = targets(body, imposed, time, state.q, frames)
    if not usable:
        return NO_DIRECTION, state, 0, 0
    q, ref, history = state.q.copy(), state.reference, state.history
    around = _untouched(body.around) if fresh else body.around
    for a in range(gap.size):  # what the pins lack, each increment its share
        gap[a] -= np.dot(body.pins[a], q.ravel())
    count = _increments(body, q, target, gap, state.frames, frames)
    total, negative = 0, 0
    start = state.q
    load = body.load.ravel()
    for k in range(1, count + 1):
        change = np.zeros(q.size)
        share = k / count
        for i in range(q.size):
            if body.fixed[i]:
                wanted = start.ravel()[i] + share * (target.ravel()[i] - start.ravel()[i])
                change[i] = wanted - q.ravel()[i]
        matter = Material(body.stiffness, body.stiffness, body.law, around, history)
        iterations, negative, ref = solver.equilibrium(
            q, change, body.fixed, body.pins, gap / count, body.rule, matter, ref, load, body.mass,
            body.spin, rate2, body.length, tolerance,
        )  # fmt: skip
        total += abs(iterations)
        if iterations < 0 or not np.all(np.isfinite(q)):
            return NO_CONVERGENCE, state, total, negative
        if not fresh:
            _, other = forces.strains(q, body.rule, ref)
            history = remembered(q, other, body, history)
    stretch, other = forces.strains(q, body.rule, ref)
    if fresh:
        history = remembered(q, other, body, history)
        if history.anchor.shape[0] > 0:
            history = History(history.plastic, rest_anchor(q, body.rule))
    zero = np.zeros(q.shape)
    rest = Moving(
        time, 0.0, 0.0, q, zero, zero, zero, ref, frames, stretch, stretch, other, other, history
    )
    return DONE, rest, total, negative

