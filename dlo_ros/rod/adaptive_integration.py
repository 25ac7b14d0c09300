# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled motion of the rod through a series of instants, with control of the error.

Every step is made by `generalised_alpha`, its sensitivities by `propagation`.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.sensitivity.propagation import propagate_step
from dlo_ros.rod.solve.dense_output import interpolate, interpolate_speed
from dlo_ros.rod.solve.equation_system import ITSELF, targets
from dlo_ros.rod.solve.generalised_alpha import (
    DONE,
    NO_CONVERGENCE,
    NO_DIRECTION,
    SMALLEST_STEP,
    step,
)
from dlo_ros.rod.solve.integrator_state import LAST, NEXT, TIME, another, assign, commit
from dlo_ros.rod.solve.newton_in_lanes import UNKNOWN_PACE, lane_addresses

FIRST_STEP = 1e-3  # [s]
SAME_INSTANT = 1e-12  # [s]
SAME_TIME = 1e-5
"""Time [s] within which a corner of the imposed motion and a stop are one: stamps are rounded, and
after a step between the two, of nanoseconds, the error control would have to begin anew."""


@njit(from_python=False)
def next_stop(corners, now, stop):
    """The next corner of the imposed motion, or the stop itself."""
    after = np.searchsorted(corners, now + SAME_TIME, side="right")
    if after < corners.size and corners[after] < stop - SAME_TIME:
        return corners[after]
    return stop


@linked(from_python=True)
def march(
    rod, state, corners, stops, tolerance, newton, varying, shapes, speeds, twists, derivatives
):
    """Integrate to a series of times.

    Args:
        rod: a `PreparedRod`, with the variants of P parameters.
        state: state at the start; holds the state at the end afterwards (where it fails: the last
            good one).
        corners: times [s] at which the imposed motion bends more sharply than a step may pass by.
        stops: times [s] from the command's start, growing, (S,); the last ends a step, others lie
            within steps, between the ends of which the motion is interpolated.
        tolerance: error that one step may add [m], in the mean over the rod.
        newton: error that Newton's method may leave, of L.
        varying: the state's derivatives by the parameters, see `propagation`; changed likewise.
        shapes, speeds: output, control points and their velocities, (S, n, d).
        twists: output, twist strain [rad/m], (S, nb); (0, 0) in the plane.
        derivatives: output, (S, P, n, d).

    Returns:
        Status and the steps taken.
    """
    return _march(
        rod.system, rod.imposed, lane_addresses(rod.lanes), state, another(state), corners, stops,
        tolerance, newton, varying, shapes, speeds, twists, derivatives,
    )  # fmt: skip


@linked()
def _march(system, imposed, lanes, state, new, corners, stops, tolerance, newton, varying, shapes,
           speeds, twists, derivatives):  # fmt: skip
    """See `march`.

    Args:
        lanes: addresses, see `newton_in_lanes`.
        new: room for a state.
    """
    steps, count, k, pace = 0, derivatives.shape[1], 0, np.array(UNKNOWN_PACE)
    clock, d_before, d_speed = state.clock, varying.q.copy(), varying.velocity.copy()
    while k < stops.size and stops[k] <= clock[TIME] + SAME_INSTANT:
        _at_end(state, varying, shapes[k], speeds[k], twists[k], derivatives[k])
        k += 1
    while k < stops.size:
        limit = next_stop(corners, clock[TIME], stops[-1])
        remaining = limit - clock[TIME]
        proposal = clock[NEXT] if clock[NEXT] > 0.0 else FIRST_STEP
        pieces = max(1.0, np.ceil(remaining / proposal * 0.999))
        h = remaining / pieces
        while True:
            steps += 1
            status, error = step(system, imposed, state, h, newton, new, lanes, pace)
            if status == NO_DIRECTION:
                return status, steps
            if status == DONE and (error <= 2.0 * tolerance or h < 10.0 * SMALLEST_STEP):
                break
            if status == DONE:
                h *= max(0.2, 0.8 * (tolerance / error) ** (1.0 / 3.0))
            else:
                h *= 0.25
            if h < SMALLEST_STEP:
                return NO_CONVERGENCE, steps
        if h >= remaining * (1.0 - 1e-12):
            new.clock[TIME] = limit
        if count > 0:
            assign(d_before, varying.q)
            assign(d_speed, varying.velocity)
            propagate_step(system, imposed, state, new, varying)
        longer = 2.0
        if error > 0.0:
            longer = min(2.0, 0.9 * (tolerance / error) ** (1.0 / 3.0))
        # A step cut short by a stop says nothing against a longer one.
        new.clock[NEXT] = max(h * longer, min(proposal, h * 10.0) * 0.2)
        while k < stops.size and stops[k] <= new.clock[TIME] + SAME_INSTANT:
            if stops[k] >= new.clock[TIME] - SAME_INSTANT:
                _at_end(new, varying, shapes[k], speeds[k], twists[k], derivatives[k])
            else:
                share = (stops[k] - clock[TIME]) / h
                _between(system, imposed, state, new, share, shapes[k], speeds[k], twists[k])
                if count > 0:
                    interpolate(
                        d_before, d_speed, varying.q, varying.velocity, h, share, derivatives[k]
                    )  # fmt: skip
            k += 1
        commit(new, state)
    return DONE, steps


@linked()
def _at_end(state, varying, shape, speed, twist, derivatives):
    """Write what is wanted of a state."""
    assign(shape, state.q)
    assign(speed, state.velocity)
    for i in range(twist.size):
        twist[i] = state.other[i, 2]
    for a in range(derivatives.shape[0]):
        assign(derivatives[a], varying.q[a])


@linked()
def _between(system, imposed, old, new, share, shape, speed, twist):
    """Write what is wanted of the motion when a share of a step is over."""
    h = new.clock[LAST]
    interpolate(old.q, old.velocity, new.q, new.velocity, h, share, shape)
    interpolate_speed(old.q, old.velocity, new.q, new.velocity, h, share, speed)
    for i in range(twist.size):
        twist[i] = old.other[i, 2] + share * (new.other[i, 2] - old.other[i, 2])
    time = old.clock[TIME] + share * h
    _, target, _ = targets(system, ITSELF, imposed, time, old.q, old.frames.copy())
    place, held = shape.ravel(), target.ravel()
    for i in range(place.size):
        if system.fixed[i]:
            place[i] = held[i]
