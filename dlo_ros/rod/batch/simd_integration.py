# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled motion of many parameter sets, eight in step; see `adaptive_integration` for the method.

The sets of a group share their steps, whose lengths follow the set with the largest error, and
Newton's method goes on until all of them have converged.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.adaptive_integration import FIRST_STEP, SAME_INSTANT, next_stop
from dlo_ros.rod.batch.simd_sensitivity import (
    impose_variants,
    last_corner,
    propagate,
    remember,
    sets_at,
    state_at,
)  # fmt: skip
from dlo_ros.rod.batch.simd_step import (
    Room,
    accept,
    rate_weights,
    try_step,
)  # fmt: skip
from dlo_ros.rod.boundary.conditions import Imposed, impose
from dlo_ros.rod.lanes.simd_kernels import BatchLaw, Scratch, tensions
from dlo_ros.rod.lanes.simd_tables import TARGET, addresses
from dlo_ros.rod.simd.eight_lanes import LANES, address, entry, load, spread, store
from dlo_ros.rod.solve.dense_output import place_weights, speed_weights
from dlo_ros.rod.solve.generalised_alpha import DONE, NO_CONVERGENCE, NO_DIRECTION, SMALLEST_STEP
from dlo_ros.rod.solve.integrator_state import assign
from dlo_ros.rod.solve.newton_in_lanes import UNKNOWN_PACE


@linked(from_python=True)
def march(sets, tables, imposed, frames, motion, place, room, clock, reach, limit, corners, stops,
          tolerance, newton, variations, shapes, speeds, twists, derivatives, status):  # fmt: skip
    """Integrate all sets to a series of times, one group of LANES after the other.

    Args:
        frames: frames of both ends, (C, 2, FRAME), updated in place.
        motion: states of the sets, updated in place, (C, rows, LANES).
        place: first rows of their parts, see `layout.Layout`.
        clock: time from the command's start, last and next step [s], carried along, (C, 3).
        reach: distance of the second control point from an end [m].
        limit: moves of a control point beyond this are taken as divergence [m].
        corners, stops: see `adaptive_integration.march`.
        tolerance: error that one step may add [m], in the mean over the rod.
        newton: convergence of Newton's method [m].
        variations: those of no parameter, see `single_rod`.
        shapes: output, (C, S, d n, LANES).
        speeds: output, velocities, likewise; (C, 0, d n, LANES) where they are not wanted.
        twists: output, twist strain [rad/m], (C, S, nb, LANES); nothing in the plane.
        derivatives: none, (S, 0, d n, LANES).
        status: output, how each group ended and its steps, rejected ones included, (C, 2).
    """
    common = addresses(tables)
    space = room_addresses(room)
    for c in range(clock.shape[0]):
        group, state = sets_at(sets, c), state_at(motion, c, place)
        tensions(state.stretch, group.law, common, state.tension)
        status[c, 0], status[c, 1] = march_group(
            group, common, imposed, frames[c], state, space, room.target, clock[c], reach, limit,
            corners, stops, tolerance, newton, place, variations, shapes[c], speeds[c], twists[c],
            derivatives,
        )  # fmt: skip


@njit(from_python=False)
def room_addresses(room):
    """The room of a step as addresses."""
    law, scratch = room.law, room.scratch
    return Room(
        BatchLaw(address(law.stretch), address(law.stretch_rest), address(law.bend),
            address(law.bend_rest)),
        Scratch(address(scratch.gradient), address(scratch.step), address(scratch.band),
                address(scratch.point), address(scratch.line), address(scratch.tangent)),
        address(room.matrix), address(room.rhs), address(room.q), address(room.q_star),
        address(room.v_star), address(room.lag), address(room.auxiliary), address(room.target),
    )  # fmt: skip


@linked()
def march_group(sets, tables, imposed, frames, motion, room, target, clock, reach, limit, corners,
                stops, tolerance, newton, place, variations, shapes, speeds, twists,
                derivatives):  # fmt: skip
    """Integrate one group; `adaptive_integration.march` says how steps are chosen."""
    steps, pace = 0, UNKNOWN_PACE
    theta, pins, tried = np.zeros(2), np.zeros((0, 3)), frames.copy()
    at_rest = False  # whether the target is one that no longer changes
    groups, corner, varied_at_rest = derivatives.shape[1], last_corner(variations.imposed), False
    size, k = tables.dof * tables.n, 0
    # Places and velocities before a step, of the motion and of its derivatives.
    before, between = np.empty((1 + groups, 2 * size, LANES)), target.copy()
    while k < stops.size and stops[k] <= clock[0] + SAME_INSTANT:
        _at_end(motion, place, variations, shapes, speeds, twists, derivatives, k, size)
        k += 1
    while k < stops.size:
        end = next_stop(corners, clock[0], stops[-1])
        remaining = end - clock[0]
        proposal = clock[2] if clock[2] > 0.0 else FIRST_STEP
        h = remaining / max(1.0, np.ceil(remaining / proposal * 0.999))
        while True:
            steps += 1
            if not at_rest:
                # A frame depends on its way, to which a rejected step does not belong.
                assign(tried, frames)
                if tables.dof == 4:
                    theta[0] = entry(motion.q, 3 * LANES)
                    theta[1] = entry(motion.q, (4 * tables.n - 1) * LANES)
                if not impose(imposed, clock[0] + h, theta, reach, tried, target, pins):
                    return NO_DIRECTION, steps
                at_rest = imposed.times.size == 0 or clock[0] >= imposed.times[-1] - 1e-9
            weights = rate_weights(h, clock[1])
            done, error, pace = try_step(
                sets, tables, motion, room, h, weights, limit, newton, pace
            )
            if done and (error <= 2.0 * tolerance or h < 10.0 * SMALLEST_STEP):
                break
            h *= max(0.2, 0.8 * (tolerance / error) ** (1.0 / 3.0)) if done else 0.25
            if h < SMALLEST_STEP:
                return NO_CONVERGENCE, steps
        now = end if h >= remaining * (1.0 - 1e-12) else clock[0] + h
        if stops[k] < now - SAME_INSTANT:
            _keep(motion, size, before[0])
            for g in range(groups):
                _keep(state_at(variations.changes, g, place), size, before[1 + g])
        if groups > 0:
            remember(tables, motion, variations)
        accept(tables, motion, room, h)
        if groups > 0:
            if not varied_at_rest:
                impose_variants(tables, variations, clock[0] + h)
                varied_at_rest = clock[0] + h >= corner
            propagate(sets, tables, motion, room, h, weights, place, variations)
        while k < stops.size and stops[k] < now - SAME_INSTANT:
            share = (stops[k] - clock[0]) / h
            _interpolate(before[0], motion, place_weights(h, share), size, shapes[k])
            if speeds.shape[0] > 0:
                _interpolate(before[0], motion, speed_weights(h, share), size, speeds[k])
            impose(imposed, stops[k], theta, reach, frames.copy(), between, pins)
            for i in range(size):
                if entry(tables.fixed, i) == TARGET:
                    store(shapes[k], i, spread(entry(between, i)))
            for e in range(twists.shape[1]):
                twist = load(motion.bend_before, 3 * e + 2)
                store(twists[k], e, twist + share * (load(motion.bend, 3 * e + 2) - twist))
            for g in range(groups):
                change = state_at(variations.changes, g, place)
                _interpolate(before[1 + g], change, place_weights(h, share), size,
                             derivatives[k, g])  # fmt: skip
            k += 1
        assign(frames, tried)
        growth = 2.0
        if error > 0.0:
            growth = min(2.0, 0.9 * (tolerance / error) ** (1.0 / 3.0))
        # A step cut short by a stop says nothing against a longer one.
        clock[2] = max(h * growth, min(proposal, h * 10.0) * 0.2)
        clock[0], clock[1] = now, h
        while k < stops.size and stops[k] <= now + SAME_INSTANT:
            _at_end(motion, place, variations, shapes, speeds, twists, derivatives, k, size)
            k += 1
    return DONE, steps


@linked()
def _at_end(motion, place, variations, shapes, speeds, twists, derivatives, k, size):
    """Write what stop k wants of the present state."""
    for i in range(size):
        store(shapes[k], i, load(motion.q, i))
        if speeds.shape[0] > 0:
            store(speeds[k], i, load(motion.velocity, i))
    for e in range(twists.shape[1]):
        store(twists[k], e, load(motion.bend, 3 * e + 2))
    for g in range(derivatives.shape[1]):
        change = state_at(variations.changes, g, place)
        for i in range(size):
            store(derivatives[k, g], i, load(change.q, i))


@njit(from_python=False)
def _keep(state, size, rows):
    """Keep places and velocities, d n numbers each, which a step changes."""
    for i in range(size):
        store(rows, i, load(state.q, i))
        store(rows, size + i, load(state.velocity, i))


@njit(from_python=False)
def _interpolate(before, after, weights, size, out):
    """Write what lies between two states, see `dense_output`.

    Args:
        before: rows, see `_keep`.
        after: state at the end of the step.
    """
    a, b, c, d = weights
    for i in range(size):
        x = a * load(before, i) + b * load(before, size + i)
        store(out, i, x + c * load(after.q, i) + d * load(after.velocity, i))


__all__ = ["DONE", "NO_CONVERGENCE", "NO_DIRECTION", "Imposed", "march"]
