# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many parameter sets at once: the rod of `dynamics`, eight sets to a vector register.

For thousands of hypotheses about one DLO under one command. The sets may differ in all that a
`RodModel` has but its basis: stiffness, rest strains, mass, drag, loads, relaxation time. Eight
sets share their steps: those that the set with the largest error needs. Where all of them stay in
the plane y = 0 they move with x and z alone, else in space with twist.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError, InputError, SimulationError
from dlo_ros.rod import integration
from dlo_ros.rod.batch.layout import Layout
from dlo_ros.rod.batch.sensitivity_lanes import NO_PARAMETERS
from dlo_ros.rod.batch.simd_integration import DONE, NO_DIRECTION, march
from dlo_ros.rod.batch.tracks import EndStates, Tracks
from dlo_ros.rod.boundary import conditions
from dlo_ros.rod.boundary.imposed_motion import NO_DIRECTION_TEXT, Boundary
from dlo_ros.rod.elements.rod_tables import DOF
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.motion_validation import in_order
from dlo_ros.rod.packing import true_command
from dlo_ros.rod.planar_model import expand, in_plane
from dlo_ros.rod.simd.eight_lanes import LANES, rows
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray

SAME_FRAME = 1e-9  # vectors and angles [rad] of frames that differ by less are the same


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
        InputError: there is no model, one has another basis or is not linear, or the boundary has
            pins (control points held in the middle).
    """

    def __init__(self, models: Sequence[RodModel], boundary: Boundary) -> None:
        self.models, self.boundary = tuple(models), boundary
        self._check()
        self._layouts: dict[bool, Layout] = {}

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
            if model.stiffness.bend[:, 2].any():
                raise InputError(
                    f"parameter sets: the two directions of bending of set {k} are coupled; "
                    "simulate such sets one by one"
                )

    def follow(
        self,
        states: Sequence[State],
        command: Command,
        stamps: Sequence[int],
        *,
        flat: bool | None = None,
        speeds: bool = False,
    ) -> Tracks:
        """Integrate all sets through stamps, as `dynamics.follow` does one.

        A group of eight sets that does not converge is simulated set by set, so that one bad set
        spoils no other; so is a set in space whose held ends have turned otherwise than those of
        its group.

        Args:
            states: one state for each set, all at the same instant.
            stamps: [ns], growing, none before the states'.
            flat: whether all sets stay in the plane y = 0; None: it is found out.
            speeds: whether the velocities at the stamps are wanted.

        Raises:
            InputError: the states do not fit the sets, or stamps do not grow from theirs on.
            CommandError: the command gives an end no direction.
        """
        commanded, command = command, self._true(command)
        self._check_states(states)
        in_order(states[0].stamp, stamps)
        if flat is None:
            flat = self._in_plane(states, command)
        layout = self.layout(flat=flat)
        motion = layout.motion(states)
        lengthening = self.models[0].body.lengthening
        length, n = self.models[0].basis.length, self.models[0].basis.control_points
        times = (np.asarray(stamps, dtype=np.int64) - command.stamp) / NANOSECONDS
        clock = self._clock(states, command, layout)
        # A group has the command's frames of its held ends, whatever the set.
        frames = np.array([state.frames for state in states])
        alone = flat or len(states) == 1
        others = [] if alone else self._other_frames(states, frames, layout)
        frames = frames[layout.order[:, 0]]
        shapes = rows(len(clock), len(times), layout.place[1])
        velocities = rows(len(clock), len(times) if speeds else 0, layout.place[1])
        status = np.empty((len(clock), 2), np.int64)
        twists = rows(len(clock), len(times), 0 if flat else len(states[0].strains.stretch))
        corners = integration.corners_of(self.models, command)
        march(
            layout.sets, layout.tables, self.boundary.imposed(command), frames, motion,
            layout.place, layout.room, clock, self.boundary.reach * lengthening, length, corners,
            times, *integration.accuracy(self.models), NO_PARAMETERS, shapes,
            velocities, twists, rows(len(times), 0, 0), status,
        )  # fmt: skip
        if np.any(status[:, 0] == NO_DIRECTION):
            raise CommandError(NO_DIRECTION_TEXT)
        count = len(states)
        moved, speed, twisted = (
            x.transpose(0, 3, 1, 2).reshape(len(clock) * LANES, *x.shape[1:3])[:count]
            for x in (shapes, velocities, twists)
        )
        moved, speed = (x.reshape(*x.shape[:2], n, layout.dof) for x in (moved, speed))
        stamp = int(stamps[-1]) if len(stamps) else states[0].stamp
        directed = np.array([[self.boundary.clamped_start], [self.boundary.clamped_end]])
        ends = EndStates(
            self.models, tuple(states), layout.unpacked(motion), clock, frames, directed, stamp
        )
        tracks = Tracks(
            expand(moved, states[0].q), expand(speed, states[0].q), twisted,
            status[:, 1].repeat(LANES)[:count], {}, ends,
        )  # fmt: skip
        for group in np.flatnonzero(status[:, 0] != DONE):
            others += np.unique(layout.order[group]).tolist()
        for k in sorted(set(others)):
            self._alone(k, tracks, commanded, stamps, flat=flat)
        return tracks

    def layout(self, *, flat: bool) -> Layout:
        """The sets in lanes, in the plane or in space."""
        if flat not in self._layouts:
            self._layouts[flat] = Layout(self.models, self.boundary, flat=flat)
        return self._layouts[flat]

    def _true(self, command: Command) -> Command:
        """The command with the sets' effects, which must agree on it."""
        true = true_command(self.models[0], command)
        for k, model in enumerate(self.models[1:], start=1):
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

    def _alone(
        self, k: int, tracks: Tracks, command: Command, stamps: Sequence[int], *, flat: bool
    ) -> None:
        """Simulate set k by itself and enter what comes out."""
        before = tracks.ends.before[k]
        try:
            track = integration.integrate(
                self.models[k], self.boundary, before, command, stamps, flat=flat
            )
        except (SimulationError, ZeroDivisionError) as err:  # the latter: coinciding points
            tracks.failures[k] = str(err)
            tracks.shapes[k] = tracks.speeds[k] = tracks.twists[k] = np.nan
            return
        tracks.shapes[k] = track.shapes
        if tracks.speeds.shape[1]:
            tracks.speeds[k] = track.speeds
        if not flat:
            tracks.twists[k] = track.twists
        tracks.steps[k] += track.steps
        tracks.ends.alone[k] = track.state

    def _check_states(self, states: Sequence[State]) -> None:
        """Whether the states fit the sets and each other."""
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

    def _in_plane(self, states: Sequence[State], command: Command) -> bool:
        """Whether all sets stay in the plane y = 0."""
        first = self.models[0]
        if not all(model.planar for model in self.models[1:]):
            return False
        # All states as one, with the ends that lie worst: the check is the same for every row.
        ends = np.concatenate([state.frames for state in states])
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
        return in_plane(first, together, command)

    def _other_frames(
        self, states: Sequence[State], frames: FloatArray, layout: Layout
    ) -> list[int]:
        """Sets whose held ends have other frames or angles than the first of their group."""
        angles = np.array([state.q[[0, -1], 3] for state in states])[:, :, None]
        known = np.concatenate([frames[:, :, : conditions.THETA], angles], axis=2)
        known[:, [not self.boundary.clamped_start, not self.boundary.clamped_end]] = 0.0
        first = known[layout.order[np.arange(len(states)) // LANES, 0]]
        return np.flatnonzero(np.abs(known - first).max(axis=(1, 2)) > SAME_FRAME).tolist()

    def _clock(self, states: Sequence[State], command: Command, layout: Layout) -> FloatArray:
        """Time from the command's start, last and next step of each group [s], (C, 3)."""
        result = np.zeros((len(layout.order), 3))
        result[:, 0] = (states[0].stamp - command.stamp) / NANOSECONDS
        steps = np.array([(state.last_step, state.next_step) for state in states])[layout.order]
        # Strain rates of states with different pasts start anew from the present.
        same = np.ptp(steps[:, :, 0], axis=1) == 0.0
        result[same, 1] = steps[same, 0, 0]
        result[:, 2] = steps[:, :, 1].min(axis=1)
        return result
