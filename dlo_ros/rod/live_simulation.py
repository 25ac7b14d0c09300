# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The simulation as a live node needs it: fed piece by piece, never losing its last good state."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.errors import CommandError, DloError, InputError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.rod.model_registry import rod_simulation, simulation_of
from dlo_ros.rod.motion_rehearsal import Fork
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.protocol import RodSimulation
from dlo_ros.rod_settings import RodSettings

LOG = logging.getLogger(__name__)

EARLY = 5.0  # [s] after the start: simulated again in less than a second
CORRECTION = 0.02  # change of ln(E/mu) that is worth it


class LiveSimulation:
    """A simulation that takes commands, parameters and its start in any order.

    Args:
        settings: the parameter file.

    Raises:
        ParameterError: there is no such rod model as simulation.model names.
    """

    def __init__(self, settings: RodSettings) -> None:
        rod_simulation(settings.simulation.model)
        self.settings = settings
        self.motion = Motion()
        self._simulation: RodSimulation | None = None
        self._first: tuple[Observation, ...] = ()
        self._held = False

    @property
    def started(self) -> bool:
        """Whether there is a state to advance from."""
        return self._simulation is not None

    @property
    def ready(self) -> bool:
        """Whether a command is known, without which a start is refused."""
        return bool(self.motion.commands)

    @property
    def control_points(self) -> int:
        """Control points of the simulation's own basis, 0 before the start."""
        return self._simulation.basis.control_points if self._simulation else 0

    def set_command(self, command: Command) -> None:
        """Take an imposed motion; it replaces the old one from its start on.

        Soon after a start under another command than the one that held then, the simulation is run
        again from there: a first shape may overtake its command.

        Raises:
            InputError: it counts other control points than the parameter file.
        """
        if command.control_points != self.settings.rod.control_points:
            raise InputError(
                f"the command counts {command.control_points} control points; "
                f"rod.control_points is {self.settings.rod.control_points}"
            )
        held = self._imposed_at_start()
        self.motion.add(command)
        if self._simulation and self._elapsed <= EARLY and self._imposed_at_start() != held:
            self._start_again(self._simulation)

    def _imposed_at_start(self) -> tuple[object, ...]:
        """Names and poses that are imposed where the simulation started."""
        if not self._first or (command := self.motion.at(self._first[-1].stamp)) is None:
            return ()
        position, rotation = command.sample(self._first[-1].stamp)
        return (command.names, position.tobytes(), rotation.tobytes())

    @property
    def _elapsed(self) -> float:
        """Seconds that have been simulated."""
        if self._simulation is None:
            return 0.0
        return (self._simulation.stamp - self._first[-1].stamp) / NANOSECONDS

    def _start_again(self, simulation: RodSimulation) -> bool:
        """Whether the run could be repeated from its start to where it is."""
        again = simulation_of(self.settings, self.motion, loads=True)
        try:
            again.start(self._first)
            again.advance(simulation.stamp)
        except DloError as err:
            LOG.warning("the simulation is not run again from its start: %s", err)
            return False
        self._simulation = again
        return True

    def start(self, observations: Sequence[Observation]) -> None:
        """Start from the first observed shapes as simulation.start says.

        Raises:
            InputError, SimulationError: see `RodSimulation.starting`; nothing is changed then.
        """
        simulation = simulation_of(self.settings, self.motion, loads=True)
        simulation.start(observations)
        self._simulation = simulation
        self._first = tuple(observations)
        self._held = False

    def advance(self, stamp: int) -> Prediction:
        """Simulate to a stamp [ns] and return the shape there.

        After a motion that could not be followed the DLO comes to rest under the first command
        that it can be led to.

        Raises:
            InputError, SimulationError: the last good shape is held.
        """
        simulation = self._simulation
        if simulation is None:
            raise InputError("the simulation has no initial shape yet")
        try:
            lead = simulation.resettle if self._held else simulation.advance
            prediction = lead(stamp)
        except (SimulationError, CommandError):
            simulation.hold(max(stamp, simulation.stamp))
            self._held = True
            raise
        self._held = False
        return prediction

    def rehearsing(self, command: Command, parameters: Sequence[str]) -> Fork | None:
        """The simulation under a command on trial, `motion_rehearsal.Fork`; None: not started."""
        simulation = self._simulation
        return None if simulation is None else Fork.of(simulation, command, parameters)

    def update(self, settings: RodSettings) -> None:
        """Change parameters while running.

        Soon after the start a change of E/mu corrects the guess that the simulation started with:
        it is run again from its start, so that the wrong guess leaves no oscillation behind. Later
        the motion goes on from the present state.

        Raises:
            ParameterError: effects leave no DLO; nothing is changed then.
        """
        settings.check_effects()
        before, self.settings = self.settings, settings
        simulation = self._simulation
        if simulation is None:
            return
        ratio = settings.rod.specific_modulus / before.rod.specific_modulus
        if (
            self._elapsed <= EARLY
            and abs(np.log(ratio)) > CORRECTION
            and self._start_again(simulation)
        ):
            return
        simulation.update(settings)

    def reset(self) -> None:
        """Forget the state; commands are kept."""
        self._simulation = None
