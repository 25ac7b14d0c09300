# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many parameter sets of one DLO simulated at once."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod.batch.parameter_sets import ParameterSets
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.dynamics import with_consistent_acceleration
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.state import State
from dlo_ros.rod.statics import settle
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray, SplineBasis


@dataclass(frozen=True)
class StartedSet:
    """A parameter set at the beginning of a simulation."""

    model: RodModel
    state: State
    stable: bool


def started_set(model: RodModel, boundary: Boundary, state: State, command: Command) -> StartedSet:
    """A parameter set, started as the simulation of another one was.

    Args:
        state: state of that other simulation at its start.

    Raises:
        SimulationError: it has no equilibrium.
    """
    if model.settings.simulation.start == "equilibrium":
        found = settle(model, boundary, state, command, state.stamp, fresh=True)
        return StartedSet(model, found.state, found.stable)
    return StartedSet(model, with_consistent_acceleration(model, boundary, state, command), True)


class SimulationBatch:
    """S parameter sets of a planar rod; see `RodBatch`.

    Args:
        sets: sets that could be started, by their number; the first among them.
        failures: the reason why the other sets could not be started, by their number.
        boundary: common to all.
        command: command that holds all the time.
        published: basis of the shapes.
    """

    def __init__(
        self, sets: Mapping[int, StartedSet], failures: Mapping[int, str], boundary: Boundary,
        command: Command, published: SplineBasis,
    ) -> None:  # fmt: skip
        self.failures = dict(failures)
        self.stable: Sequence[bool] = [
            k in sets and sets[k].stable for k in range(len(sets) + len(failures))
        ]
        self._numbers = sorted(sets)
        self._models = [sets[k].model for k in self._numbers]
        self._states = [sets[k].state for k in self._numbers]
        self._boundary, self._command = boundary, command
        self._published = published
        self._down = published.projection(self._models[0].basis)
        self._together: ParameterSets | None = None

    @classmethod
    def starting(
        cls, first: StartedSet, others: Sequence[RodSettings], boundary: Boundary, command: Command
    ) -> Generator[None, None, SimulationBatch]:
        """The first set and others that start where it is; it yields between them."""
        started, failures = {0: first}, {}
        for k, settings in enumerate(others, start=1):
            yield
            try:
                model = first.model.with_settings(settings)
                started[k] = started_set(model, boundary, first.state, command)
            except SimulationError as err:
                failures[k] = str(err)
        return cls(started, failures, boundary, command, boundary.published)

    @property
    def shapes(self) -> FloatArray:
        """The present control points in the published basis, shape (S, n, 4)."""
        return self._projected(np.array([state.q[None] for state in self._states]))[:, 0]

    def advance_through(self, stamps: Sequence[int]) -> FloatArray:
        """Simulate to a series of stamps [ns], growing; see `RodBatch.advance_through`.

        A set that fails keeps its last shape from there on.
        """
        if self._together is None:
            self._together = ParameterSets(self._models, self._boundary)
        tracks = self._together.follow(self._states, self._command, stamps)
        for row, why in tracks.failures.items():
            self.failures.setdefault(self._numbers[row], why)
        self._states = [
            replace(state, stamp=stamps[-1]) if self._numbers[row] in self.failures
            else tracks.state(row)
            for row, state in enumerate(self._states)
        ]  # fmt: skip
        return self._projected(tracks.shapes)

    def _projected(self, shapes: FloatArray) -> FloatArray:
        """Shapes (sets that started, T, m, 4) in the published basis, free of twist."""
        result = np.full((len(self.stable), shapes.shape[1], len(self._down), 4), np.nan)
        for row, number in enumerate(self._numbers):
            result[number] = self._down @ shapes[row]
        result[..., 3] = 0.0
        return result
