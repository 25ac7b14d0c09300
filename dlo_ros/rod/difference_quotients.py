# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities of a rod model that has none of its own: central difference quotients."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from copy import copy
from typing import ClassVar

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.errors import InputError
from dlo_ros.observation import Observation
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.protocol import RodSimulation, RodSimulationClass
from dlo_ros.rod.sensitivity_parameters import POSES, STEP, changed, variation_of
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

WIDENING = 100.0
"""Distance of two variants over that of the sensitivities themselves, `variation_of`.

Those follow the steps of one integration. Two integrations of their own may differ by rounding and
by the tolerance of their iterations, which a wider quotient divides by more.
"""


class DifferenceQuotients(RodSimulation):
    """A simulation beside two others for each parameter, one above its value and one below.

    It costs 1 + 2 P simulations.

    Args:
        middle: the simulation itself, which has no parameters.
        parameters: P names, see `sensitivity_parameters`; poses of clamps are none of them.
        sides: the simulations above and below each parameter's value in turn, 2 P of them, at the
            same instant; none where it has not started.
        kind: class of simulations of the same model, which makes the sides at the start; None:
            the simulation has started.

    Raises:
        InputError: an unknown parameter, or the pose of a clamp.
    """

    differentiable: ClassVar[bool] = True

    def __init__(
        self, middle: RodSimulation, parameters: Sequence[str],
        sides: Sequence[RodSimulation] = (), kind: RodSimulationClass | None = None,
    ) -> None:  # fmt: skip
        _amounts(middle.settings, parameters)
        self.parameters = tuple(parameters)
        self._kind = kind
        self._sides = list(sides)
        self._set_middle(middle)

    @classmethod
    def of_present(cls, middle: RodSimulation, parameters: Sequence[str]) -> DifferenceQuotients:
        """Difference quotients of a simulation that goes on from its present state."""
        sides = [middle.fork(s, loads=False) for s in variants(middle.settings, parameters)]
        return cls(middle, parameters, sides)

    def _set_middle(self, middle: RodSimulation) -> None:
        self._middle = middle
        self.settings, self.motion, self.published = (
            middle.settings, middle.motion, middle.published,
        )  # fmt: skip
        self.stable, self.resolution = middle.stable, middle.resolution

    def starting(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """Start the simulation, then those beside it with the same resolution."""
        if self._kind is None:
            raise InputError("the simulation has started already")
        yield from self._middle.starting(observations, last_stamp)
        sides = []
        for settings in variants(self.settings, self.parameters):
            side = self._kind(settings, self.motion, spans=self._middle.basis.even_spans)
            yield from side.starting(observations, last_stamp)
            sides.append(side)
        self._sides = sides
        self._set_middle(self._middle)

    def judging(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """Find the resolution of the simulation itself."""
        yield from self._middle.judging(observations, last_stamp)
        self.resolution = self._middle.resolution

    def warn_of_instability(self) -> None:
        """Log the warning of the simulation itself."""
        self._middle.warn_of_instability()

    @property
    def stamp(self) -> int:
        """The simulated instant, as it is seen [ns]."""
        return self._middle.stamp

    @property
    def basis(self) -> SplineBasis:
        """The basis of the simulation itself."""
        return self._middle.basis

    def true_shape(self) -> FloatArray:
        """The true shape of the simulation itself, (m, 4)."""
        return self._middle.true_shape()

    def prediction(self) -> Prediction:
        """The present shape with its sensitivities."""
        return self._joined([self._middle.prediction()], [[s.prediction()] for s in self._sides])[0]

    def advance_through(self, stamps: Sequence[int]) -> list[Prediction]:
        """Simulate to a series of stamps [ns], growing.

        Raises:
            InputError: not started, or a stamp lies before the present instant.
            SimulationError: one of the simulations cannot follow; all stay where they were.
        """
        everything = [one.fork(one.settings) for one in (self._middle, *self._sides)]
        tracks = [one.advance_through(stamps) for one in everything]
        self._set_middle(everything[0])
        self._sides = everything[1:]
        return self._joined(tracks[0], tracks[1:])

    def _joined(
        self, middle: list[Prediction], sides: Sequence[list[Prediction]]
    ) -> list[Prediction]:
        """Predictions of the simulation with the derivatives that the others give."""
        if not self.parameters:
            return middle
        above, below = np.array(_amounts(self.settings, self.parameters)).T
        width = (above - below)[:, None, None]
        result = []
        for k, one in enumerate(middle):
            points = np.array([track[k].control_points[:, :3] for track in sides])
            result.append(one._replace(sensitivity=(points[0::2] - points[1::2]) / width))
        return result

    def fork(
        self, settings: RodSettings, motion: Motion | None = None, *, loads: bool | None = None
    ) -> DifferenceQuotients:
        """All simulations with other parameters; see `RodSimulation.fork`."""
        result = copy(self)
        result._set_middle(self._middle.fork(settings, motion, loads=loads))
        result._sides = [
            side.fork(s, motion, loads=False)
            for side, s in zip(self._sides, variants(settings, self.parameters), strict=True)
        ]
        return result

    def update(self, settings: RodSettings) -> None:
        """Change the parameters of all simulations; see `RodSimulation.update`."""
        self._middle.update(settings)
        for side, other in zip(self._sides, variants(settings, self.parameters), strict=True):
            side.update(other)
        self._set_middle(self._middle)

    def hold(self, stamp: int) -> None:
        """Stand still until a stamp [ns]."""
        for one in (self._middle, *self._sides):
            one.hold(stamp)

    def resettle(self, stamp: int) -> Prediction:
        """Come to rest at a stamp [ns]; see `RodSimulation.resettle`."""
        everything = [one.fork(one.settings) for one in (self._middle, *self._sides)]
        rests = [one.resettle(stamp) for one in everything]
        self._set_middle(everything[0])
        self._sides = everything[1:]
        return self._joined(rests[:1], [[rest] for rest in rests[1:]])[0]

    def with_sensitivities(self, parameters: Sequence[str], present: Command) -> RodSimulation:
        """The present simulation, with sensitivities to what happens from now on."""
        return DifferenceQuotients.of_present(self._middle.fork(self.settings), parameters)


def _amounts(settings: RodSettings, parameters: Sequence[str]) -> list[tuple[float, float]]:
    """Amounts by which the variants above and below each parameter differ from it.

    They are in its own unit, or of its logarithm; see `ParameterVariation.amounts`.

    Raises:
        InputError: an unknown parameter, or the pose of a clamp.
    """
    for name in parameters:
        if name in POSES:
            raise InputError(
                f"no sensitivity to '{name}': this rod model has none of its own, and difference "
                "quotients vary material, damping, gravity, length and effects only"
            )
    found = [variation_of(settings, name) for name in parameters]
    return [each.amounts(WIDENING * STEP * each.natural) for each in found]


def variants(settings: RodSettings, parameters: Sequence[str]) -> list[RodSettings]:
    """The settings with each of P parameters above and below its value, 2 P of them."""
    amounts = _amounts(settings, parameters)
    return [
        changed(settings, name, amount)
        for name, pair in zip(parameters, amounts, strict=True)
        for amount in pair
    ]
