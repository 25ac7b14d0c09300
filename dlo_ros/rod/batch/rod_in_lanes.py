# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One rod in the vector lanes, with the parameters whose sensitivities it carries along."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError
from dlo_ros.rod.batch import single_rod
from dlo_ros.rod.batch.layout import Layout
from dlo_ros.rod.batch.sensitivity_lanes import NO_PARAMETERS, variations_of
from dlo_ros.rod.batch.single_rod import StackedState
from dlo_ros.rod.boundary.imposed_motion import NO_DIRECTION_TEXT, Boundary
from dlo_ros.rod.compiled_rod import Compiled
from dlo_ros.rod.elements.rod_tables import DOF, Reference
from dlo_ros.rod.integration import Track, accuracy, corners_of
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.sensitivity.sensitivity_state import SensitivityState
from dlo_ros.rod.simd.eight_lanes import rows
from dlo_ros.rod.solve.generalised_alpha import DONE, NO_DIRECTION
from dlo_ros.rod.state import State, Strains


class RodInLanes:
    """A rod whose numbers all lanes hold, laid out for compiled code once and followed often.

    Args:
        model: the rod; what it is made of must be plain, see `RodModel.plain`.
        boundary: what the command holds: clamps or held tips at the ends, or nothing.
        rod: the rod for compiled code with the variants of its parameters; None: it has none.
        flat: whether it stays in the plane y = 0.
    """

    def __init__(
        self, model: RodModel, boundary: Boundary, rod: Compiled | None, *, flat: bool
    ) -> None:
        self._model, self._boundary, self._rod, self._flat = model, boundary, rod, flat
        layout = Layout([model], boundary, flat=flat)
        self._variations = NO_PARAMETERS if rod is None else variations_of(model, rod, layout)
        self._prepared: Any = single_rod.prepare(
            layout.sets, layout.tables, layout.room, layout.place, rows(1, layout.place[-1]),
            self._variations, model.rule, boundary.reach * model.body.lengthening,
            np.array([boundary.clamped_start, boundary.clamped_end]),
        )  # fmt: skip

    def follow(
        self,
        state: State,
        command: Command,
        stamps: Sequence[int],
        *,
        speeds: bool,
        stepwise: bool = False,
    ) -> Track | None:
        """Integrate through stamps, as `dynamics.follow` does; None where that does not converge.

        Args:
            command: command with all effects applied.
            speeds: whether the velocities are wanted; with parameters they are given anyway.
            stepwise: whether every stamp ends a step.

        Raises:
            CommandError: the command gives an end no direction.
        """
        times = (np.asarray(stamps, dtype=np.int64) - command.stamp) / NANOSECONDS
        clock = np.array(
            ((state.stamp - command.stamp) / NANOSECONDS, state.last_step, state.next_step)
        )
        before, v = None if self._rod is None else state.sensitivity, self._variations
        p, shape = len(v.step), (len(times), len(state.q), DOF)
        shapes, derivatives = np.empty(shape), np.empty((shape[0], p, *shape[1:]))
        velocities = np.empty(shape if speeds or p else (0, *shape[1:]))
        twists = np.empty((shape[0], 0 if self._flat else len(state.strains.stretch)))
        frames, moved, changed = state.frames.copy(), _stacked(state), NOTHING
        if before is not None:
            v.frames[...], v.increments[...] = before.frames, 0.0
            changed = _copied(before)
        length = self._model.basis.length
        corners = corners_of([self._model], command)
        if stepwise:
            corners = np.union1d(corners, times)
        status, steps = single_rod.march(
            self._prepared, self._boundary.imposed(command), clock, frames, moved, changed,
            length, corners, times, *accuracy([self._model]), shapes,
            velocities, twists, derivatives,
        )  # fmt: skip
        if status == NO_DIRECTION:
            raise CommandError(NO_DIRECTION_TEXT)
        if status != DONE:
            return None
        q, velocity, acceleration, auxiliary, stretch, stretch_before, other, other_before = (
            x[0] for x in moved[1:]
        )
        end = State(
            int(stamps[-1]) if len(stamps) else state.stamp, q, velocity, acceleration, auxiliary,
            Reference(*(x[0] for x in moved.reference)), frames, Strains(stretch, other),
            Strains(stretch_before, other_before), state.internal, float(clock[1]),
            float(clock[2]), None if before is None else self._sensitivity(changed, before),
        )  # fmt: skip
        if not len(velocities):
            velocities = np.zeros(shape)
        return Track(
            end, shapes, velocities, np.zeros((0, 0)) if self._flat else twists, derivatives, steps
        )

    def _sensitivity(self, changed: StackedState, before: SensitivityState) -> SensitivityState:
        """The derivatives of the state at the end."""
        rod, c = self._rod, changed
        assert rod is not None
        return SensitivityState(
            rod.step, rod.moves, rod.rates, rod.kind, c.q, c.velocity, c.acceleration, c.auxiliary,
            c.reference, self._variations.frames.copy(), c.stretch, c.stretch_before, c.other,
            c.other_before, before.internal,
        )  # fmt: skip


def _stacked(state: State) -> StackedState:
    """A copy of a state as the only one of its stack."""
    now, before = state.strains, state.previous
    parts = (state.q, state.velocity, state.acceleration, state.auxiliary, now.stretch,
             before.stretch, now.other, before.other)  # fmt: skip
    return StackedState(
        Reference(*(x[None].copy() for x in state.reference)), *(x[None].copy() for x in parts)
    )


def _copied(v: SensitivityState) -> StackedState:
    """A copy of a state's derivatives."""
    parts = (v.q, v.velocity, v.acceleration, v.auxiliary, v.stretch, v.stretch_before, v.other,
             v.other_before)  # fmt: skip
    return StackedState(Reference(*(x.copy() for x in v.reference)), *(x.copy() for x in parts))


NOTHING = StackedState(
    Reference(*(np.zeros((0,) * d) for d in (3, 3, 3, 2))),
    *(np.zeros((0,) * d) for d in (3, 3, 3, 3, 2, 2, 3, 3)),
)
"""Derivatives by no parameter."""
