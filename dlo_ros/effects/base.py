# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What an effect is, and the rod that it may change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import ParameterError
from dlo_ros.spline import FloatArray, SplineBasis

SHORTEST = 0.1  # of the configured length that effects may leave


class Peg(NamedTuple):
    """A round peg that stands on the board, frictionless."""

    x: float  # [m]
    z: float  # [m]
    radius: float  # of the peg itself [m]


@dataclass
class Body:
    """The rod while it is put together; an effect changes its numbers in place.

    Args:
        basis: of the simulation, over the configured length L.
        points: material coordinates of the quadrature points [m], shape (nb,).
        weight: their weights [m], shape (nb,); the cells of this width tile the DLO.
        bend: bending stiffness about both material directors [N m^2], shape (nb, 2).
        bend_rest: curvature at rest about them [1/m], shape (nb, 2); in the board's plane the
            first director is +y.
        twist_rest: twist at rest [rad/m], shape (nb,).
        line_density: mass per length [kg/m].
        air_drag: force per length over velocity [N s/m^2].
        relaxation_time: of Kelvin-Voigt damping [s].
        gravity: [m/s^2], shape (3,).
        force: dead force per length [N/m], shape (3,).
        masses: masses fixed to the DLO, each as mass [kg] and place u [m].
        kinks: in the board's plane, each as angle [rad] and place u [m].
        half_curvature: curvature at which the tangent bending stiffness has halved [1/m].
        yield_curvature: elastic curvature past which bending yields [1/m].
        hardening: tangent bending stiffness past the yield over that before it, 0 to 1.
        friction: Coulomb friction with the board per length [N/m]; None: the board is not touched.
        pegs: that the DLO may touch.
        lengthening: true length over configured length.
        slip: free length gained through a grip during the motion [m].
    """

    basis: SplineBasis
    points: FloatArray
    weight: FloatArray
    bend: FloatArray
    bend_rest: FloatArray
    twist_rest: FloatArray
    line_density: float
    air_drag: float
    relaxation_time: float
    gravity: FloatArray
    force: FloatArray = field(default_factory=lambda: np.zeros(3))
    masses: list[tuple[float, float]] = field(default_factory=list)
    kinks: list[tuple[float, float]] = field(default_factory=list)
    half_curvature: float = math.inf
    yield_curvature: float = math.inf
    hardening: float = 0.0
    friction: float | None = None
    pegs: list[Peg] = field(default_factory=list)
    lengthening: float = 1.0
    slip: float = 0.0

    def check(self) -> None:
        """Refuse a rod that effects have made impossible.

        Raises:
            ParameterError: which quantity is negative or vanishes, its value, what is allowed.
        """
        for name, value, unit in (
            ("damping.air_drag + effects.air_drag.coefficient", self.air_drag, "N s/m^2"),
            (
                "damping.relaxation_time + effects.internal_damping.relaxation_time",
                self.relaxation_time,
                "s",
            ),
            ("the mass per length", self.line_density, "kg/m"),
        ):
            if not value >= 0.0:
                raise ParameterError(f"{name} is {value:g} {unit} in all; it must not be negative")
        if not np.all(self.bend > 0.0):
            raise ParameterError(
                f"effects leave a bending stiffness of {self.bend.min():g} N m^2; it must be "
                "positive"
            )
        least = self.length * self.lengthening + min(self.slip, 0.0)
        if not least >= SHORTEST * self.length:
            raise ParameterError(
                f"effects.length_error and effects.clamp_slip leave {least:g} m of a DLO of "
                f"{self.length:g} m; at least {SHORTEST * self.length:g} m must be left"
            )

    @property
    def length(self) -> float:
        """Configured length L [m], over which u counts."""
        return self.basis.length

    def within(self, key: str, place: float) -> None:
        """Refuse a place that is not on the DLO.

        Raises:
            ParameterError: names effects.KEY, the place and the length.
        """
        if not -1e-3 * self.length <= place <= 1.001 * self.length:
            raise ParameterError(
                f"effects.{key} is {place:g} m; it must lie on the DLO, 0 to {self.length:g} m"
            )

    def hat(self, place: float) -> FloatArray:
        """1 at a place, 0 a knot span away from it, at the quadrature points, shape (nb,)."""
        away = np.abs(self.points - place) / self.basis.span_length
        return np.maximum(1.0 - away, 0.0)

    def coverage(self, start: float, stop: float) -> FloatArray:
        """Share in [start, stop] at the quadrature points, shape (nb,).

        It rises and falls over a knot span to either side, since the spline's curvature cannot
        jump; what of that would lie beyond an end of the DLO is folded back. So its integral is
        that of the interval, and an interval up to an end is whole there.
        """
        start, stop = (min(max(u, 0.0), self.length) for u in (start, stop))
        total = np.zeros_like(self.points)
        for at in (self.points, -self.points, 2.0 * self.length - self.points):
            total += self._step(at - start) - self._step(at - stop)
        return total

    def _step(self, beyond: FloatArray) -> FloatArray:
        """The integral of a hat as wide as two knot spans: 0 far before and 1 far behind 0."""
        s = np.clip(beyond / self.basis.span_length, -1.0, 1.0)
        result: FloatArray = 0.5 + s - 0.5 * s * np.abs(s)
        return result


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect.

    Args:
        name: key in reports and, after `effects.NAME.`, in the parameter file.
        neutral: value with which the effect does nothing (for a place: any).
        unit: SI unit, empty where there is none.
        lower, upper: range, both ends allowed.
        description: a few words.
        array: whether several values, equally spaced along u, may be given.
    """

    name: str
    neutral: float
    unit: str
    lower: float
    upper: float
    description: str
    array: bool = False


def quantity(
    neutral: float, unit: str, lower: float, upper: float, description: str, *, array: bool = False
) -> Any:
    """A dataclass field that is a parameter of an effect; see `Quantity`."""
    data = {"unit": unit, "lower": lower, "upper": upper, "text": description, "array": array}
    return field(default=neutral, metadata=data)


class Effect:
    """One cause of a difference between the plain model and a real DLO.

    A subclass is a frozen dataclass whose fields are made by `quantity`. It overrides what it
    changes; everything else stays as it is.
    """

    name: ClassVar[str]

    def shape_body(self, body: Body) -> None:
        """Change the rod: stiffness, rest strain, mass, load, damping, surroundings."""

    def impose(self, command: Command) -> Command:
        """What is truly imposed where `command` was commanded."""
        return command

    def later(self) -> float:
        """How much later than its commands say the DLO is seen to move [s]."""
        return 0.0

    def measured(self, points: FloatArray) -> FloatArray:
        """Where the camera sees points (m, 3) of the board frame that are truly at `points`."""
        return points

    def true(self, points: FloatArray) -> FloatArray:
        """The inverse of `measured`."""
        return points

    @classmethod
    def quantities(cls) -> tuple[Quantity, ...]:
        """The effect's parameters."""
        result = []
        for f in fields(cls):  # type: ignore[arg-type]  # subclasses are dataclasses
            data: Mapping[str, Any] = f.metadata
            neutral: Any = f.default
            result.append(
                Quantity(f.name, neutral, data["unit"], data["lower"], data["upper"],
                         data["text"], data["array"])
            )  # fmt: skip
        return tuple(result)
