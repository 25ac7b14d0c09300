# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A stiff cantilever by linear beam theory: a rod model of another package, complete."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from copy import copy

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import Motion
from dlo_ros.effects import build
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.protocol import RodSimulation
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import SplineBasis


class LinearCantilever(RodSimulation):
    """A DLO that is clamped at its start and sags a little; it has no inertia.

    The deflection is w(u) = rho A g u^2 (u^2 - 4 L u + 6 L^2) / (24 E I), the cantilever under its
    own weight of Euler and Bernoulli, with the part of g across the clamp's direction.

    Args:
        settings: settings; rod, gravity, and effects on gravity, the clamp and the measurement are
            used.
        motion: the imposed motion.
        parameters, spans, loads: ignored: the model has no derivatives, no resolution and no loads.

    Raises:
        SimulationError: an effect changes the rod otherwise, which this model does not know.
    """

    def __init__(
        self, settings: RodSettings, motion: Motion, *, parameters: Sequence[str] = (),
        spans: int | None = None, loads: bool = False,
    ) -> None:  # fmt: skip
        self.motion, self.parameters = motion, ()
        self.published = SplineBasis(settings.rod.control_points, settings.rod.length)
        self._stamp: int | None = None
        self.update(settings)

    def update(self, settings: RodSettings) -> None:
        """Take other parameters; there is no state that they could leave behind."""
        plain = vars(settings.with_effects({}).body(self.published))
        for name, values in settings.effects.items():
            body = vars(settings.with_effects({name: values}).body(self.published))
            if any(k != "gravity" and not np.array_equal(body[k], plain[k]) for k in plain):
                raise SimulationError(f"effects.{name}: a linear cantilever knows no such effect")
        self.settings, self._gravity = settings, settings.body(self.published).gravity

    def starting(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """Begin at the first observation, for `moving` at the second, whatever shape it has."""
        self._stamp = observations[self.settings.simulation.start == "moving"].stamp
        self.prediction()
        yield

    @property
    def stamp(self) -> int:
        """The simulated instant [ns]."""
        if self._stamp is None:
            raise InputError("the simulation has no initial shape yet")
        return self._stamp

    def prediction(self) -> Prediction:
        """The shape at the present instant."""
        return self._at(self.stamp)

    def _at(self, stamp: int) -> Prediction:
        """The shape at an instant [ns], from the clamp that is imposed then."""
        camera = MeasurementMap(self.settings)
        instant = stamp - camera.later
        command = self.motion.at(instant)
        if command is None or "start" not in command.names:
            raise InputError("a linear cantilever needs a dlo/command that holds its start")
        for effect in build(self.settings.effects):
            command = effect.impose(command)
        position, rotation = command.sample(instant)
        clamp = command.names.index("start")
        along = Rotation.from_quat(rotation[clamp]).apply([1.0, 0.0, 0.0])
        across = self._gravity - (self._gravity @ along) * along
        rod = self.settings.rod
        u = np.linspace(0.0, rod.length, 4 * rod.control_points)
        sag = u**2 * (u**2 - 4.0 * rod.length * u + 6.0 * rod.length**2)
        sag *= rod.linear_density / (24.0 * rod.bending_stiffness)
        points = position[clamp] + np.outer(u, along) + np.outer(sag, across)
        shape = np.zeros((rod.control_points, 4))
        shape[:, :3] = self.published.fit(u, points)
        return Prediction(stamp, camera.measured(shape))

    def advance_through(self, stamps: Sequence[int]) -> list[Prediction]:
        """The shapes at a series of stamps [ns]."""
        if stamps and stamps[0] < self.stamp:
            raise InputError("the simulation cannot go back; reset it")
        predictions = [self._at(stamp) for stamp in stamps]
        self._stamp = stamps[-1] if stamps else self.stamp
        return predictions

    def fork(
        self, settings: RodSettings, motion: Motion | None = None, *, loads: bool | None = None
    ) -> LinearCantilever:
        """Another one at the same instant."""
        twin = copy(self)
        twin.motion = motion or self.motion
        twin.update(settings)
        return twin

    def hold(self, stamp: int) -> None:
        """Go to an instant [ns]: it stands still as long as its clamp does."""
        self._stamp = stamp

    def resettle(self, stamp: int) -> Prediction:
        """The shape at an instant [ns], which is one at rest."""
        return self.advance(stamp)
