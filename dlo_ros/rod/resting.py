"""Compiled search for static equilibrium under imposed motion, led along a path."""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod import forces, solver
from dlo_ros.rod.grips import DIRECTOR, TANGENT
from dlo_ros.rod.material import room
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
PUSH = 2e-3  # of L: how far an unstable equilibrium is left at once
ESCAPES = 4


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
        Status, the state at rest, Newton iterations, the number of negative eigenvalues of the
        stiffness (0: stable), and whether an unstable equilibrium was left on the way.
    """
    body = grown(system, growth(imposed, time))
    frames = state.frames.copy()
    usable, target, gap = targets(body, imposed, time, state.q, frames)
    if not usable:
        return NO_DIRECTION, state, 0, 0, False
    q, ref, history = state.q.copy(), state.reference, state.history
    around = _untouched(body.around) if fresh else body.around
    for a in range(gap.size):  # what the pins lack, each increment its share
        gap[a] -= np.dot(body.pins[a], q.ravel())
    count = _increments(body, q, target, gap, state.frames, frames)
    total, negative, buckled = 0, 0, False
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
            return NO_CONVERGENCE, state, total, negative, False
        if not fresh:
            _, other = forces.strains(q, body.rule, ref)
            history = remembered(q, other, body, history)
    matter = Material(body.stiffness, body.stiffness, body.law, around, history)
    for _ in range(ESCAPES):
        if negative <= 0:
            break
        buckled = True
        iterations, negative, ref = _escape(q, body, matter, ref, load, rate2, tolerance)
        total += abs(iterations)
    stretch, other = forces.strains(q, body.rule, ref)
    if fresh:
        history = remembered(q, other, body, history)
        if history.anchor.shape[0] > 0:
            history = History(history.plastic, rest_anchor(q, body.rule))
    zero = np.zeros(q.shape)
    rest = Moving(
        time, 0.0, 0.0, q, zero, zero, zero, ref, frames, stretch, stretch, other, other, history
    )
    return DONE, rest, total, negative, buckled


@njit(cache=True, nogil=True)
def _escape(q, body, matter, ref, load, rate2, tolerance):
    """Leave an unstable equilibrium, as a DLO that buckles does, and settle beside it.

    It goes along its softest motion, to the side where the energy is lower. Where nothing decides
    between the sides, it is the one to which the DLO's softest point moves along the axes.

    Returns:
        Iterations, negative eigenvalues and reference frame as `solver.equilibrium`; q is changed
        where an equilibrium was found.
    """
    mode = solver.softest(
        q, body.fixed, body.pins, body.rule, matter, ref, body.mass, body.spin, rate2
    )
    response = room(body.rule.weight.size)
    reach = PUSH * body.length
    energies = np.empty(2)
    for side in range(2):
        trial = q + (1.0 - 2.0 * side) * reach * mode
        energies[side] = forces.energy_of(trial, body.rule, ref, matter, response)
        energies[side] -= np.dot(load, trial.ravel())
    sign = 1.0 if energies[0] <= energies[1] else -1.0
    if abs(energies[0] - energies[1]) < 1e-9 * np.abs(energies).max():
        sign = 1.0 if mode.sum() >= 0.0 else -1.0
    trial = q + sign * reach * mode
    iterations, negative, frame = solver.equilibrium(
        trial, np.zeros(q.size), body.fixed, body.pins, np.zeros(body.pins.shape[0]), body.rule,
        matter, ref, load, body.mass, body.spin, rate2, body.length, tolerance,
    )  # fmt: skip
    if iterations < 0 or not np.all(np.isfinite(trial)):
        return abs(iterations), 1, ref
    q[:, :] = trial
    return iterations, negative, frame
