# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The motion of one rod by the kernels of the lanes, all of which hold it, in one compiled call.

State and sensitivities go in and come out as arrays in space; a planar rod is made of them and
expanded to them here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.core import types
from numba.experimental import structref

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.batch.simd_integration import march_group, room_addresses
from dlo_ros.rod.batch.simd_sensitivity import sets_at, state_at
from dlo_ros.rod.boundary.conditions import THETA
from dlo_ros.rod.elements.planar_assembly import tangents
from dlo_ros.rod.elements.rod_tables import Reference
from dlo_ros.rod.lanes.simd_kernels import tensions
from dlo_ros.rod.lanes.simd_tables import addresses
from dlo_ros.rod.simd.eight_lanes import LANES, entry, put_entry, row_address, spread, store
from dlo_ros.rod.simd.row_operations import copy_numbers
from dlo_ros.rod.solve.generalised_alpha import DONE
from dlo_ros.spline import FloatArray


@structref.register
class _PreparedLanesType(types.StructRef):  # type: ignore  # numba carries no types
    """Type of `PreparedLanes` in compiled code."""


class PreparedLanes(structref.StructRefProxy):  # type: ignore[misc]
    """A reference to what `prepare` was given, under the same names."""


structref.define_proxy(
    PreparedLanes,
    _PreparedLanesType,
    ["sets", "tables", "room", "place", "motion", "variations", "rule", "reach", "directed"],
)


@njit()
def prepare(sets, tables, room, place, motion, variations, rule, reach, directed):
    """A rod in lanes as one object, see `prepared_rod`.

    Args:
        sets, tables, room, place: see `layout.Layout`.
        motion: room for its state, (1, rows, LANES).
        variations: parameters whose sensitivities are carried along.
        rule: quadrature of the rod.
        reach: distance of the second control point from an end [m].
        directed: whether the command gives start and end a direction, (2,).
    """
    return PreparedLanes(sets, tables, room, place, motion, variations, rule, reach, directed)


class StackedState(NamedTuple):
    """States of a rod in space, or derivatives by P parameters; arrays with a leading axis of P."""

    reference: Reference
    q: FloatArray  # (P, n, 4)
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    stretch: FloatArray  # (P, nb)
    stretch_before: FloatArray
    other: FloatArray  # (P, nb, 3)
    other_before: FloatArray


@linked()
def _put(numbers, every, lane, rows):
    """Write every so many numbers to a lane of rows."""
    flat = numbers.ravel()
    for i in range(0, flat.size, every):
        put_entry(rows, LANES * (i // every) + lane, flat[i])


@linked()
def _get(rows, every, lane, numbers):
    """Write a lane of rows to every so many numbers, and zeros between."""
    flat = numbers.ravel()
    for i in range(flat.size):
        flat[i] = entry(rows, LANES * (i // every) + lane) if i % every == 0 else 0.0


@linked()
def _read(states, flat, place, rows):
    """Write states to lanes, rows (G, ..., LANES) for `state_at`."""
    moved, bent = (2, 3) if flat else (1, 1)
    for a in range(states.q.shape[0]):
        to, lane, ref = state_at(rows, a // LANES, place), a % LANES, states.reference
        _put(states.q[a], moved, lane, to.q)
        _put(states.velocity[a], moved, lane, to.velocity)
        _put(states.acceleration[a], moved, lane, to.acceleration)
        _put(states.auxiliary[a], moved, lane, to.auxiliary)
        _put(states.stretch[a], 1, lane, to.stretch)
        _put(states.stretch_before[a], 1, lane, to.stretch_before)
        _put(states.other[a], bent, lane, to.bend)
        _put(states.other_before[a], bent, lane, to.bend_before)
        if not flat:
            _put(ref.tangent[a], 1, lane, to.frame.tangent)
            _put(ref.rate[a], 1, lane, to.frame.rate)
            _put(ref.director[a], 1, lane, to.frame.director)
            _put(ref.twist[a], 1, lane, to.frame.twist)


@linked()
def _write(rows, flat, place, states):
    """Write the lanes of states to where `_read` has them from."""
    moved, bent = (2, 3) if flat else (1, 1)
    for a in range(states.q.shape[0]):
        there, lane, ref = state_at(rows, a // LANES, place), a % LANES, states.reference
        _get(there.q, moved, lane, states.q[a])
        _get(there.velocity, moved, lane, states.velocity[a])
        _get(there.acceleration, moved, lane, states.acceleration[a])
        _get(there.auxiliary, moved, lane, states.auxiliary[a])
        _get(there.stretch, 1, lane, states.stretch[a])
        _get(there.stretch_before, 1, lane, states.stretch_before[a])
        _get(there.bend, bent, lane, states.other[a])
        _get(there.bend_before, bent, lane, states.other_before[a])
        if not flat:
            _get(there.frame.tangent, 1, lane, ref.tangent[a])
            _get(there.frame.rate, 1, lane, ref.rate[a])
            _get(there.frame.director, 1, lane, ref.director[a])
            _get(there.frame.twist, 1, lane, ref.twist[a])


@linked(from_python=True)
def march(rod, imposed, clock, frames, state, change, limit, corners, stops, tolerance, newton,
          shapes, speeds, twists, derivatives):  # fmt: skip
    """Integrate to a series of times.

    Args:
        rod: a `PreparedLanes`, with P parameters.
        imposed: its command.
        clock, frames: see `IntegratorState`; they become those at the end.
        state: `StackedState` of the rod alone; becomes that at the end.
        change: `StackedState` of its derivatives, likewise.
        limit, corners, tolerance, newton: see `simd_integration.march`.
        stops: times [s] from the command's start, growing, (S,).
        shapes: output, control points, (S, n, 4).
        speeds: output, their velocities, likewise; (0, n, 4) where they are not wanted.
        twists: output, twist strain [rad/m], (S, nb); (S, 0) in the plane.
        derivatives: output, (S, P, n, 4).

    Returns:
        Status and the steps taken; where it fails, state and derivatives are those at the start.
    """
    tables, place, v, rows = addresses(rod.tables), rod.place, rod.variations, rod.motion
    flat, size, count, groups = tables.dof == 2, tables.dof * tables.n, stops.size, v.heavier.size
    every = 2 if flat else 1
    _read(state, flat, place, rows)
    for i in range(rows.shape[1]):
        store(rows, i, spread(entry(rows, LANES * i)))
    for i in range(groups * v.changes.shape[1]):
        store(v.changes, i, spread(0.0))
    _read(change, flat, place, v.changes)
    sets, motion = sets_at(rod.sets, 0), state_at(rows, 0, place)
    tensions(motion.stretch, sets.law, tables, motion.tension)
    carried, moved = frames.copy(), np.empty((count, size, LANES))
    speed = np.empty((speeds.shape[0], size, LANES))
    twisted = np.empty((count, twists.shape[1], LANES))
    varied = np.empty((count, groups, size, LANES))
    status, steps = march_group(
        sets, tables, imposed, carried, motion, room_addresses(rod.room), rod.room.target, clock,
        rod.reach, limit, corners, stops, tolerance, newton, place, v, moved, speed, twisted,
        varied,
    )  # fmt: skip
    if status != DONE:
        return status, steps
    _write(rows, flat, place, state)
    _write(v.changes, flat, place, change)
    for end in range(2):
        if rod.directed[end]:
            copy_numbers(frames[end], carried[end])
        frames[end, THETA] = state.q[0, -end, 3]
    if flat:
        tangents(state.q[0], rod.rule, state.reference.tangent[0], state.reference.rate[0])
    for k in range(count):
        _get(row_address(moved, k * size), every, 0, shapes[k])
        _get(row_address(twisted, k * twists.shape[1]), 1, 0, twists[k])
        if speeds.shape[0] > 0:
            _get(row_address(speed, k * size), every, 0, speeds[k])
        for a in range(v.step.size):
            at = (k * groups + a // LANES) * size
            _get(row_address(varied, at), every, a % LANES, derivatives[k, a])
    return status, steps
