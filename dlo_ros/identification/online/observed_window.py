# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The recent past that the live estimator simulates again: commands and observations."""

from __future__ import annotations

from bisect import bisect_right

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.identification.cooperative_tasks import Pieces
from dlo_ros.inference.forecast import Window
from dlo_ros.inference.observation_operator import noise_unit
from dlo_ros.observation import Observation
from dlo_ros.rod.boundary.shape_orientation import along
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.rod.protocol import RodSimulation
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod_settings import RodSettings

MOST_COMMANDS = 10_000  # that are remembered; 20 s of poses that are sent one by one at 500 Hz
COMPARED = 50  # last observations among which one that came twice is looked for


class ObservedWindow:
    """Recent commands and observations.

    Args:
        motion: the imposed motion, which goes on.
        length: L [m].
    """

    def __init__(self, motion: Motion, length: float) -> None:
        self.motion = motion
        self.observations: list[Observation] = []
        self.noise_unit: float | None = None  # of the first picture with measured points
        self.anchor: RodSimulation | None = None  # the state at the beginning, once it has moved
        self._length = length

    @property
    def elapsed(self) -> float:
        """Time from the first observation to the last [s]."""
        return (self.observations[-1].stamp - self.observations[0].stamp) / NANOSECONDS

    def impose(self, command: Command) -> bool:
        """Take an imposed motion; whether it bears on observations that there are already."""
        self.motion.add(command)
        # A robot that sends pose after pose does so for hours.
        del self.motion.commands[:-MOST_COMMANDS]
        return bool(self.observations) and command.stamp < self.observations[-1].stamp

    def add(self, observation: Observation) -> bool:
        """Take an observation; whether it is new and the latest.

        One that is older than the last is put in its place; one from before the window is dropped.
        """
        observation = along(self.motion, observation, self._length)
        seen = self.observations
        if any(o.stamp == observation.stamp for o in seen[-COMPARED:]):
            return False
        late = bool(seen) and observation.stamp < seen[-1].stamp
        if late and observation.stamp < seen[0].stamp:
            return False
        seen.append(observation)
        if self.noise_unit is None:
            self.noise_unit = noise_unit([observation], self._length)
        if late:
            seen.sort(key=lambda o: o.stamp)
        return not late

    def after(self, stamp: int) -> list[Observation]:
        """The observations later than a stamp [ns]."""
        return self.observations[bisect_right(self.observations, stamp, key=lambda o: o.stamp) :]

    def forget(self) -> None:
        """Keep the last observation alone."""
        self.observations = self.observations[-1:]

    def move(self, anchor: RodSimulation) -> None:
        """Begin anew, without observations, at the present state of a simulation."""
        self.observations, self.anchor = [], anchor

    def manipulation(self) -> Window | None:
        """Commands and observations since the start; None once the beginning has been dropped."""
        if self.anchor is not None:
            return None
        commands, seen = tuple(self.motion.commands), tuple(self.observations)
        return Window("the present motion", commands, seen, noise_unit=self.noise_unit)

    def started(
        self, settings: RodSettings, spans: int, *, loads: bool = False
    ) -> Pieces[RodSimulation]:
        """A simulation at the beginning of the window, with sensitivities, or with loads instead.

        Args:
            spans: knot spans, where it starts from the first observations.

        Raises:
            SimulationError: it cannot start.
        """
        if self.anchor is not None:
            return self.anchor.fork(settings, loads=loads)
        names = () if loads else MATERIAL
        simulation = simulation_of(
            settings, self.motion, parameters=names, spans=spans, loads=loads
        )
        yield from simulation.starting(self.observations[:2], self.observations[-1].stamp)
        return simulation
