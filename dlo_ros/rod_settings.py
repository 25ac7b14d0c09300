# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Settings of the physics: the part of a parameter file that a rod model may know."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from dlo_ros.effects import Body, RopeScale, Values, build, effects
from dlo_ros.effects.base import PREFIX
from dlo_ros.parameter_cameras import Vector
from dlo_ros.spline import FloatArray, SplineBasis

EFFECTS_PREFIX = PREFIX
DEFAULT_MODEL = "spline"  # the rod model of this package, see `dlo_ros.rod.model_registry`
STANDARD_GRAVITY = 9.81  # [m/s^2] by which a weight is measured, however gravity is configured


def kink_curvature(body: Body) -> FloatArray:
    """Rest curvature of the kinks [1/m], shape (nb,): angles, however long the DLO is."""
    result = np.zeros(len(body.points))
    for angle, place in body.kinks:
        hat = body.hat(place, KINK * body.length)
        result += angle / (body.lengthening * (hat @ body.weight)) * hat
    return result


@dataclass(frozen=True)
class RodParameters:
    """Material and geometry of a round DLO, SI units."""

    length: float
    diameter: float
    young_modulus: float
    density: float
    poisson_ratio: float = 0.33
    density_std: float = 0.0
    specific_modulus_std: float = 0.0
    diameter_std: float = 0.0
    length_std: float = 0.0
    control_points: int = 10

    @property
    def area(self) -> float:
        """Cross-section area A [m^2]."""
        return math.pi * self.diameter**2 / 4.0

    @property
    def second_moment(self) -> float:
        """Second moment of area I = pi D^4 / 64 [m^4]."""
        return math.pi * self.diameter**4 / 64.0

    @property
    def bending_stiffness(self) -> float:
        """B = E I [N m^2]."""
        return self.young_modulus * self.second_moment

    @property
    def shear_modulus(self) -> float:
        """G = E / (2 (1 + nu)) [Pa]."""
        return self.young_modulus / (2.0 * (1.0 + self.poisson_ratio))

    @property
    def linear_density(self) -> float:
        """Mass per length [kg/m]."""
        return self.density * self.area

    @property
    def specific_modulus(self) -> float:
        """E / mu [m^2/s^2], which is all that settled shapes determine."""
        return self.young_modulus / self.density


@dataclass(frozen=True)
class DampingParameters:
    """Damping and how well it is known; a standard deviation of 0 means a guess."""

    air_drag: float = 0.01
    air_drag_std: float = 0.0
    relaxation_time: float = 0.002
    relaxation_time_std: float = 0.0


@dataclass(frozen=True)
class SimulationParameters:
    """Discretisation, start and rate of the simulation."""

    tolerance: float = 2e-4
    start: str = "equilibrium"
    rate: float = 50.0
    model: str = DEFAULT_MODEL


@dataclass(frozen=True)
class LimitParameters:
    """Limits of the load on the DLO: bend radius [m] and tension [N]; 0 where there is no limit."""

    bend_radius: float = 0.0
    tension: float = 0.0


KINK = 0.02
"""Least reach of a kink to either side of its place, over the length: a sharper one asks for
hundreds of knot spans. It cuts a corner of 0.3 rad by 1e-4 of the length, one of 0.7 by 5e-4."""


@dataclass(frozen=True)
class RodSettings:
    """All that a simulated DLO depends on.

    Args:
        rod: material and size of the DLO.
        gravity: [m/s^2], shape (3,).
        damping: damping of the motion.
        simulation: numerical parameters of the simulation.
        effects: values of those that the model contains, by name and key.
    """

    rod: RodParameters
    gravity: Vector = (0.0, 0.0, -9.81)
    damping: DampingParameters = field(default_factory=DampingParameters)
    simulation: SimulationParameters = field(default_factory=SimulationParameters)
    effects: Values = field(default_factory=dict)

    def check_effects(self) -> None:
        """Refuse effects that leave no DLO.

        Raises:
            ParameterError: which quantity, its value, what is allowed.
        """
        if self.effects:
            self._published_body.check()

    @property
    def slips(self) -> bool:
        """Whether a grip slips (maybe by nothing), so that the path of the motion counts."""
        return bool(self.effects) and self._published_body.slip is not None

    @property
    def batched(self) -> bool:
        """Whether parameter sets may be simulated together, see `Effect`."""
        return all(effects()[name].batched for name in self.effects)

    @property
    def gives(self) -> bool:
        """Whether a grip gives (maybe by nothing), so that the DLO bends sharply beside it."""
        return bool(self.effects) and self._published_body.grip_compliance is not None

    @cached_property
    def _published_body(self) -> Body:
        """The body in the published basis, see `body`."""
        return self.body(SplineBasis(self.rod.control_points, self.rod.length))

    def body(self, basis: SplineBasis, section: Vector = (1.0, 1.0, 1.0)) -> Body:
        """Material, mass and loads of the DLO, effects included, in a spline basis.

        Args:
            section: see `dlo_ros.rod.model.RodModel`.

        Raises:
            ParameterError: an effect acts on a place that is not on the DLO.
        """
        points, weight = basis.quadrature(3)
        nb = weight.size
        body = Body(
            basis, points, weight, self.rod.bending_stiffness * np.full((nb, 2), section[:2]),
            np.zeros((nb, 2)), np.zeros(nb), self.rod.linear_density, self.damping.air_drag,
            self.damping.relaxation_time, np.array(self.gravity),
        )  # fmt: skip
        for effect in build(self.effects):
            effect.shape_body(body)
        body.bend_rest[:, 0] += kink_curvature(body)
        body.give_at_grips()
        return body

    @property
    def scale(self) -> RopeScale:
        """Scale by which the numbers of effects are measured."""
        rod, damping = self.rod, self.damping
        weight, mass = rod.linear_density * STANDARD_GRAVITY, rod.linear_density * rod.length
        return RopeScale(rod.length, weight, mass, damping.air_drag, damping.relaxation_time)

    def with_effects(self, effects: Values) -> Self:
        """These settings with other effects, by name and key, and no others."""
        return replace(self, effects=effects)

    def with_material(self, young_modulus: float, density: float) -> Self:
        """These settings with another E [Pa] and mu [kg/m^3]."""
        return replace(self, rod=replace(self.rod, young_modulus=young_modulus, density=density))
