# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many parameter sets at once: the planar rod of `dynamics`, eight sets to a vector register.

For thousands of hypotheses about one DLO under one command. The sets may differ in all that a
`RodModel` has but its basis: stiffness, rest strains, mass, drag, loads, relaxation time. Eight
sets share their steps: those that the set with the largest error needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError, InputError, SimulationError
from dlo_ros.rod import integration
from dlo_ros.rod.batch.simd_integration import DONE, NO_DIRECTION, march
from dlo_ros.rod.batch.simd_kernels import COLUMN, BatchLaw, Scratch, tables_of
from dlo_ros.rod.batch.simd_step import BatchState, Room, Sets
from dlo_ros.rod.batch.tracks import EndStates, Tracks
from dlo_ros.rod.boundary import conditions
from dlo_ros.rod.boundary.imposed_motion import NO_DIRECTION_TEXT, Boundary
from dlo_ros.rod.elements.rod_tables import DOF
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import true_command
from dlo_ros.rod.planar_model import IN_PLANE, expand, in_plane
from dlo_ros.rod.simd.eight_lanes import LANES, rows
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray

# Newton's method stops when its last correction is below this share of a step's tolerance; what
# is left is quadratically smaller.
NEWTON_SHARE = 0.05
ROUNDING = 1e-11  # of L: smaller corrections are not asked for


def follow_many(
    models: Sequence[RodModel],
    boundary: Boundary,
    states: Sequence[State],
    command: Command,
    stamps: Sequence[int],
) -> Tracks:
    """Integrate many parameter sets through stamps; see `ParameterSets` and its `follow`."""
    return ParameterSets(models, boundary).follow(states, command, stamps)


class ParameterSets:
    """Parameter sets of one DLO, laid out for compiled code once and simulated as often as wanted.

    Args:
        models: one rod model for each set, S in all, with the same basis; steps keep the smallest
            simulation.tolerance among them.
        boundary: common to all sets: clamps or held tips at the ends, or none.

    Raises:
        InputError: there is no model, one has another basis or leaves the plane y = 0, or the
            boundary has pins (control points held in the middle).
    """

    def __init__(self, models: Sequence[RodModel], boundary: Boundary) -> None:
        self.models, self.boundary = tuple(models), boundary
        self._check()
        first = self.models[0]
        n, nb = first.basis.control_points, len(first.rule.weight)
        # Each end holds two control points at most, so what is free is in one piece.
        free = np.flatnonzero(~boundary.fixed.reshape(n, DOF)[:, 0])
        lo, hi = (int(free[0]), int(free[-1]) + 1) if len(free) else (n, n)
        self._tables = tables_of(first.rule, lo, hi)
        # Number of the set in each lane: the last one fills up.
        self._order = np.minimum(np.arange(-(-len(models) // LANES) * LANES), len(models) - 1)
        self._order = self._order.reshape(-1, LANES)
        stiff = [model.stiffness for model in self.models]
        weight = first.rule.weight
        self._sets = Sets(
            BatchLaw(
                self._lanes([weight * s.stretch for s in stiff]),
                self._lanes([s.stretch_rest for s in stiff]),
                self._lanes([weight * s.bend[:, 0] for s in stiff]),
                self._lanes([s.bend_rest[:, 0] for s in stiff]),
            ),
            self._lanes([model.mass for model in self.models]),
            self._lanes([model.drag for model in self.models]),
            self._lanes([model.load[:, IN_PLANE] for model in self.models]),
            self._lanes([[m.body.relaxation_time] for m in self.models]),
        )
        many = 2 * n + COLUMN - 1  # the factorisation reaches beyond the last column
        self._room = Room(
            BatchLaw(rows(nb), rows(nb), rows(nb), rows(nb)),
            Scratch(rows(2 * n), rows(many), rows(COLUMN * many), rows(42), rows(16), rows(2 * nb)),
            rows(4 * n), rows(2 * n), rows(2 * n), rows(2 * n), rows(2 * n), rows(2 * n),
            rows(2 * n), np.zeros((n, 2)),
        )  # fmt: skip
        tolerance = min(m.settings.simulation.tolerance for m in self.models)
        self._tolerance = integration.STEP_SHARE * tolerance * first.basis.length

    def _check(self) -> None:
        if not self.models:
            raise InputError("parameter sets: there is none; at least one is needed")
        if len(self.boundary.pins):
            raise InputError(
                "parameter sets: the command holds control points in the middle of the DLO; many "
                "sets at once know clamps and held ends only, simulate such sets one by one"
            )
        first = self.models[0]
        if self.boundary.basis != first.basis:
            raise InputError("parameter sets: the boundary has another basis than the first set")
        for k, model in enumerate(self.models):
            ends = (model.full_start, model.full_end)
            if model.basis != first.basis or ends != (first.full_start, first.full_end):
                raise InputError(
                    f"parameter sets: set {k} has another basis or other free ends than the first "
                    "set; all need the same"
                )
            if not model.plain or model.body.lengthening != first.body.lengthening:
                raise InputError(
                    f"parameter sets: set {k} softens, yields, touches something, slips through a "
                    "grip or is longer than the first; simulate such sets one by one"
                )
            if not model.planar:
                raise InputError(
                    f"parameter sets: set {k} has rest strains or loads out of the plane y = 0; "
                    "simulate such sets one by one"
                )

    def follow(self, states: Sequence[State], command: Command, stamps: Sequence[int]) -> Tracks:
        """Integrate all sets through stamps, as `dynamics.follow` does one.

        A group of eight sets that does not converge is simulated set by set, so that one bad set
        spoils no other.

        Args:
            states: one state for each set, all at the same instant and in the plane y = 0.
            stamps: [ns], growing, none before the states'.

        Raises:
            InputError: the states do not fit the sets, or a motion leaves the plane.
            CommandError: the command gives an end no direction.
        """
        commanded, command = command, self._true(command)
        frames = np.array([state.frames for state in states])
        self._check_states(states, frames, command)
        q, velocity, acceleration, auxiliary = (
            self._lanes(np.array([getattr(state, name) for state in states])[:, :, IN_PLANE])
            for name in ("q", "velocity", "acceleration", "auxiliary")
        )
        motion = BatchState(
            q, velocity, acceleration, auxiliary,
            self._lanes([state.strains.stretch for state in states]),
            self._lanes([state.previous.stretch for state in states]),
            self._lanes(np.array([state.strains.other for state in states])[:, :, 0]),
            self._lanes(np.array([state.previous.other for state in states])[:, :, 0]),
            rows(len(self._order), len(states[0].strains.stretch)),
        )  # fmt: skip
        lengthening = self.models[0].body.lengthening
        length, n = self.models[0].basis.length, self.models[0].basis.control_points
        times = (np.asarray(stamps, dtype=np.int64) - command.stamp) / NANOSECONDS
        clock = self._clock(states, command)
        # In the plane the held ends' frames are those of the command, whatever set.
        frames = frames[self._order[:, 0]]
        shapes, status = rows(len(clock), len(times), 2 * n), np.empty((len(clock), 2), np.int64)
        march(
            self._sets, self._tables, self.boundary.imposed(command), frames, motion, self._room,
            clock, self.boundary.reach * lengthening, length, times, self._tolerance,
            max(NEWTON_SHARE * self._tolerance, ROUNDING * length), shapes, status,
        )  # fmt: skip
        if np.any(status[:, 0] == NO_DIRECTION):
            raise CommandError(NO_DIRECTION_TEXT)
        count = len(states)
        flat = shapes.transpose(0, 3, 1, 2).reshape(-1, len(times), n, 2)[:count]
        stamp = int(stamps[-1]) if len(stamps) else states[0].stamp
        directed = np.array([[self.boundary.clamped_start], [self.boundary.clamped_end]])
        ends = EndStates(self.models, tuple(states), motion, clock, frames, directed, stamp)
        tracks = Tracks(expand(flat, states[0].q), status[:, 1].repeat(LANES)[:count], {}, ends)
        for group in np.flatnonzero(status[:, 0] != DONE):
            for k in np.unique(self._order[group]):
                self._alone(int(k), tracks, commanded, stamps)
        return tracks

    def _true(self, command: Command) -> Command:
        """The command with the sets' effects, which must agree on it."""
        true = true_command(self.models[0], command)
        for k, model in enumerate(self.models):
            other = true_command(model, command)
            if not (
                np.array_equal(other.positions, true.positions)
                and np.array_equal(other.rotations, true.rotations)
            ):
                raise InputError(
                    f"parameter sets: effects of set {k} change what is imposed otherwise than "
                    "those of the first; simulate such sets one by one"
                )
        return true

    def _alone(self, k: int, tracks: Tracks, command: Command, stamps: Sequence[int]) -> None:
        """Simulate set k by itself and enter what comes out."""
        before = tracks.ends.before[k]
        try:
            track = integration.integrate(
                self.models[k], self.boundary, before, command, stamps, flat=True
            )
        except (SimulationError, ZeroDivisionError) as err:  # the latter: coinciding points
            tracks.failures[k] = str(err)
            tracks.shapes[k] = np.nan
            return
        tracks.shapes[k] = track.shapes
        tracks.steps[k] += track.steps
        tracks.ends.alone[k] = track.state

    def _check_states(self, states: Sequence[State], frames: FloatArray, command: Command) -> None:
        """Whether the states fit the sets, each other and the plane."""
        first = self.models[0]
        n = first.basis.control_points
        if len(states) != len(self.models):
            raise InputError(
                f"parameter sets: {len(states)} states for {len(self.models)} sets; one for each "
                "is needed"
            )
        for k, state in enumerate(states):
            if state.stamp != states[0].stamp or state.q.shape != (n, DOF):
                raise InputError(
                    f"parameter sets: the state of set {k} has {len(state.q)} control points at "
                    f"{state.stamp} ns; needed are {n} at {states[0].stamp} ns as in the first"
                )
        # All states as one, with the ends that lie worst: the check is the same for every row.
        ends = frames.reshape(-1, frames.shape[2])
        ends = ends[np.argsort(ends[:, conditions.DIRECTOR + 1])[:2]]
        together = replace(
            states[0],
            q=np.concatenate([state.q for state in states]),
            velocity=np.concatenate([state.velocity for state in states]),
            acceleration=np.concatenate([state.acceleration for state in states]),
            auxiliary=np.concatenate([state.auxiliary for state in states]),
            reference=states[0].reference._replace(
                director=np.concatenate([state.reference.director for state in states])
            ),
            frames=ends,
        )
        if in_plane(first, together, command):
            return
        for k, (model, state) in enumerate(zip(self.models, states, strict=True)):
            if not in_plane(model, state, command):
                raise InputError(
                    f"parameter sets: the motion of set {k} is not in the plane y = 0; simulate "
                    "such sets one by one"
                )

    def _clock(self, states: Sequence[State], command: Command) -> FloatArray:
        """Time from the command's start, last and next step of each group [s], (C, 3)."""
        result = np.zeros((len(self._order), 3))
        result[:, 0] = (states[0].stamp - command.stamp) / NANOSECONDS
        steps = np.array([(state.last_step, state.next_step) for state in states])[self._order]
        # Strain rates of states with different pasts start anew from the present.
        same = np.ptp(steps[:, :, 0], axis=1) == 0.0
        result[same, 1] = steps[same, 0, 0]
        result[:, 2] = steps[:, :, 1].min(axis=1)
        return result

    def _lanes(self, values: Sequence[object] | FloatArray) -> FloatArray:
        """Values of each set as an array (C, rows, LANES)."""
        flat = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
        result = rows(len(self._order), flat.shape[1])
        result[...] = flat[self._order].transpose(0, 2, 1)
        return result
