"""Compiled motion of eight parameter sets in step: the generalised-alpha method of `engine`.

The sets share their steps, whose lengths follow the set with the largest error, and Newton's
method goes on until all of them have converged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from dlo_ros.rod.engine import (
    ALPHA_F,
    ALPHA_M,
    BETA,
    DONE,
    FIRST_STEP,
    GAMMA,
    MAX_NEWTON,
    NO_CONVERGENCE,
    NO_DIRECTION,
    SMALLEST_STEP,
)
from dlo_ros.rod.grips import Imposed, impose
from dlo_ros.rod.lanes_kernels import Law, Scratch, assemble, residual, solve, strains, tensions
from dlo_ros.rod.lanes_vector import largest, load, root, spread, store
from dlo_ros.spline import FloatArray


class Sets(NamedTuple):
    """Constants of all sets: arrays (C, ..., LANES), x and z of a control point in turn.

    Here and in `Motion` the first axis counts groups of LANES sets; within a group it is gone.
    """

    law: Law  # without damping
    mass: FloatArray  # (4 n,) lower rows [kg]
    drag: FloatArray  # (4 n,) [N s/m]
    load: FloatArray  # (2 n,) [N]
    relaxation_time: FloatArray  # (1,) [s]


class Motion(NamedTuple):
    """Where all sets are; arrays (C, ..., LANES)."""

    q: FloatArray  # (2 n,) [m]
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    stretch: FloatArray  # (nb,) now, and one step ago
    stretch_before: FloatArray
    bend: FloatArray
    bend_before: FloatArray
    tension: FloatArray  # (nb,) with weights, as `assemble` takes it


class Room(NamedTuple):
    """Scratch of one step; arrays (..., LANES) but for the target."""

    law: Law  # of the incremental potential
    scratch: Scratch
    matrix: FloatArray  # (4 n,)
    rhs: FloatArray  # (2 n,)
    q: FloatArray  # (2 n,)
    q_star: FloatArray
    v_star: FloatArray
    lag: FloatArray
    auxiliary: FloatArray
    target: FloatArray  # (n, 2)
    pins: FloatArray  # (0, 3)
    theta: FloatArray  # (2,)


@njit(cache=True, nogil=True)
def _damped(relaxation, now, before, weights, stiffness, rest, out_stiffness, out_rest):
    """Stiffness and rest strains of one step's incremental potential; see `engine`."""
    t_r = load(relaxation, 0)
    factor = 1.0 + weights[0] * t_r
    inverse = 1.0 / factor
    for e in range(stiffness.shape[0]):
        past = weights[1] * load(now, e) + weights[2] * load(before, e)
        store(out_stiffness, e, load(stiffness, e) * factor)
        store(out_rest, e, (load(rest, e) - t_r * past) * inverse)


@njit(cache=True, nogil=True)
def _predict(sets, motion, room, h, c_mass, c_drag):
    """What the step starts from: predictions, matrix and right-hand side."""
    n = motion.q.shape[0] // 2
    for i in range(4 * n):
        store(room.matrix, i, c_mass * load(sets.mass, i) + c_drag * load(sets.drag, i))
    for i in range(2 * n):
        aux, v = load(motion.auxiliary, i), load(motion.velocity, i)
        q_star = load(motion.q, i) + h * v + (h * h * (0.5 - BETA)) * aux
        v_star = v + (h * (1.0 - GAMMA)) * aux
        store(room.q_star, i, q_star)
        store(room.v_star, i, v_star)
        store(room.q, i, q_star + (h * h * BETA) * aux)
        store(room.lag, i, (ALPHA_F / (1.0 - ALPHA_F)) * load(motion.acceleration, i)
              - (ALPHA_M / (1.0 - ALPHA_F)) * aux)  # fmt: skip
    for i in range(n):
        for c in range(2):
            x = load(sets.load, 2 * i + c)
            for j in range(max(0, i - 3), min(n, i + 4)):
                k, at = 2 * j + c, 4 * i + 3 - i + j if j <= i else 4 * j + 3 - j + i
                q_star = load(room.q_star, k)
                x += load(sets.mass, at) * (c_mass * q_star + load(room.lag, k))
                x += load(sets.drag, at) * (c_drag * q_star - load(room.v_star, k))
            store(room.rhs, 2 * i + c, x)


@njit(cache=True, nogil=True)
def _newton(tables, room, tension, limit, tolerance):
    """Solve the step's equations from room.q.

    Args:
        limit, tolerance: a control point's root mean square move in the last iteration [m] that
            is too large, and that is small enough.

    Returns:
        Whether all sets have converged, and the smallest pivot.
    """
    lo, hi = tables.lo, tables.hi
    scratch = room.scratch
    if hi <= lo:
        return True, 1.0
    for iteration in range(MAX_NEWTON):
        assemble(room.q, tables, room.law, scratch, room.matrix, tension, iteration == 0)
        residual(room.q, room.matrix, room.rhs, scratch, lo, hi)
        pivot = solve(scratch, lo, hi)
        square = spread(0.0)
        for i in range(2 * lo, 2 * hi):
            x = load(scratch.step, i)
            square += x * x
            store(room.q, i, load(room.q, i) + x)
        move = np.sqrt(largest(square) / (hi - lo))
        if not move < limit:
            return False, pivot
        if move < tolerance:
            return True, pivot
    return False, 0.0


@njit(cache=True, nogil=True)
def _step(sets, tables, motion, room, h, weights, limit, newton):
    """Try a step of length h whose target is in place.

    Returns:
        Whether it converged on the branch, and the estimated error of the worst set [m].
    """
    c_mass = (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h)
    c_drag = GAMMA / (BETA * h)
    base, law, relaxation = sets.law, room.law, sets.relaxation_time
    _damped(relaxation, motion.stretch, motion.stretch_before, weights, base.stretch,
            base.stretch_rest, law.stretch, law.stretch_rest)  # fmt: skip
    _damped(relaxation, motion.bend, motion.bend_before, weights, base.bend,
            base.bend_rest, law.bend, law.bend_rest)  # fmt: skip
    _predict(sets, motion, room, h, c_mass, c_drag)
    n = motion.q.shape[0] // 2
    for i in range(n):
        if not tables.lo <= i < tables.hi:
            store(room.q, 2 * i, spread(room.target[i, 0]))
            store(room.q, 2 * i + 1, spread(room.target[i, 1]))
    converged, pivot = _newton(tables, room, motion.tension, limit, newton)
    # A negative pivot: the step has left the branch that a smaller one would follow.
    if not converged or (not pivot > 0.0 and h > 10.0 * SMALLEST_STEP):
        return False, np.inf
    total = spread(0.0)
    rate = 1.0 / (BETA * h * h)
    for i in range(2 * n):
        store(room.auxiliary, i, rate * (load(room.q, i) - load(room.q_star, i)))
    for i in range(tables.lo, tables.hi):
        x = load(room.auxiliary, 2 * i) - load(motion.auxiliary, 2 * i)
        z = load(room.auxiliary, 2 * i + 1) - load(motion.auxiliary, 2 * i + 1)
        total += root(x * x + z * z)
    jump = largest(total) / max(tables.hi - tables.lo, 1)
    return True, abs(BETA - 1.0 / 6.0) * h * h * jump


@njit(cache=True, nogil=True)
def _accept(tables, motion, room, h):
    """Move on to what `_step` has found."""
    c_mass = (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h)
    c_drag = GAMMA / (BETA * h)
    for i in range(motion.q.shape[0]):
        q = load(room.q, i)
        d = q - load(room.q_star, i)
        store(motion.q, i, q)
        store(motion.velocity, i, load(room.v_star, i) + c_drag * d)
        store(motion.acceleration, i, c_mass * d - load(room.lag, i))
        store(motion.auxiliary, i, load(room.auxiliary, i))
    for e in range(motion.bend.shape[0]):
        store(motion.stretch_before, e, load(motion.stretch, e))
        store(motion.bend_before, e, load(motion.bend, e))
    strains(motion.q, tables, motion.stretch, motion.bend)
    tensions(motion.stretch, room.law, tables.rule.stretch_linear, motion.tension)


@njit(cache=True, nogil=True)
def _rate_weights(h, last):
    """Weights of the strains now, one and two steps ago in the strain rate [1/s]."""
    if last <= 0.0:
        return 1.0 / h, -1.0 / h, 0.0
    r = h / last
    return (1.0 + 2.0 * r) / (h * (1.0 + r)), -(1.0 + r) / h, r * r / (h * (1.0 + r))


@njit(cache=True, nogil=True)
def march(sets, tables, imposed, frames, motion, room, clock, reach, limit, stops, tolerance,
          newton, shapes, status):  # fmt: skip
    """Integrate all sets to a series of times, one group of LANES after the other.

    Args:
        frames: of both ends, (C, 2, FRAME), carried along.
        motion: where the sets are, carried along.
        clock: time from the command's start, last and next step [s], carried along, (C, 3).
        reach: distance of the second control point from an end [m].
        limit: moves of a control point beyond this are taken as divergence [m].
        stops: times [s] from the command's start, growing, (S,).
        tolerance: error that one step may add [m], in the mean over the rod.
        newton: convergence of Newton's method [m].
        shapes: output, (C, S, 2 n, LANES).
        status: output, how each group ended and its steps, rejected ones included, (C, 2).
    """
    for c in range(clock.shape[0]):
        law = sets.law
        group = Sets(
            Law(law.stretch[c], law.stretch_rest[c], law.bend[c], law.bend_rest[c]),
            sets.mass[c], sets.drag[c], sets.load[c], sets.relaxation_time[c],
        )  # fmt: skip
        place = Motion(
            motion.q[c], motion.velocity[c], motion.acceleration[c], motion.auxiliary[c],
            motion.stretch[c], motion.stretch_before[c], motion.bend[c], motion.bend_before[c],
            motion.tension[c],
        )  # fmt: skip
        tensions(place.stretch, group.law, tables.rule.stretch_linear, place.tension)
        status[c, 0], status[c, 1] = _march_group(
            group, tables, imposed, frames[c], place, room, clock[c], reach, limit, stops,
            tolerance, newton, shapes[c],
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _march_group(sets, tables, imposed, frames, motion, room, clock, reach, limit, stops,
                 tolerance, newton, shapes):  # fmt: skip
    """Integrate one group; `engine.march` says how steps are chosen."""
    steps = 0
    at_rest = False  # whether the target is one that no longer changes
    for k in range(stops.size):
        while clock[0] < stops[k] - 1e-12:
            end = stops[k]
            after = np.searchsorted(imposed.times, clock[0] + 1e-9, side="right")
            if after < imposed.times.size and imposed.times[after] < end - 1e-9:
                end = imposed.times[after]
            remaining = end - clock[0]
            proposal = clock[2] if clock[2] > 0.0 else FIRST_STEP
            h = remaining / max(1.0, np.ceil(remaining / proposal * 0.999))
            while True:
                steps += 1
                if not at_rest:
                    time = clock[0] + h
                    if not impose(imposed, time, room.theta, reach, frames, room.target, room.pins):
                        return NO_DIRECTION, steps
                    at_rest = imposed.times.size == 0 or clock[0] >= imposed.times[-1] - 1e-9
                weights = _rate_weights(h, clock[1])
                done, error = _step(sets, tables, motion, room, h, weights, limit, newton)
                if done and (error <= 2.0 * tolerance or h < 10.0 * SMALLEST_STEP):
                    break
                h *= max(0.2, 0.8 * (tolerance / error) ** (1.0 / 3.0)) if done else 0.25
                if h < SMALLEST_STEP:
                    return NO_CONVERGENCE, steps
            _accept(tables, motion, room, h)
            growth = 2.0
            if error > 0.0:
                growth = min(2.0, 0.9 * (tolerance / error) ** (1.0 / 3.0))
            # A step cut short by a stop says nothing against a longer one.
            clock[2] = max(h * growth, min(proposal, h * 10.0) * 0.2)
            clock[1] = h
            clock[0] = end if h >= remaining * (1.0 - 1e-12) else clock[0] + h
        for i in range(motion.q.shape[0]):
            store(shapes[k], i, load(motion.q, i))
    return DONE, steps


__all__ = ["DONE", "NO_CONVERGENCE", "NO_DIRECTION", "Imposed", "march"]
