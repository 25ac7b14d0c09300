# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The air resists with the square of speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from dlo_ros.effects.base import Body, Effect, PlainRod, Start, quantity


@dataclass(frozen=True)
class QuadraticDrag(Effect):
    """Force per length -c |v_n| v_n [N/m], where v_n is the velocity across the DLO [m/s].

    That of a cylinder in a cross flow: c = 1/2 rho C_D D [N s^2/m^3] with the air's density rho and
    a drag coefficient C_D of about 1: Hoerner, Fluid-Dynamic Drag, 1965. It is added to the linear
    drag; nothing resists motion along the DLO. With c = 0 there is none.
    """

    name: ClassVar[str] = "quadratic_drag"
    title: ClassVar[str] = "drag that grows with the square of speed"
    phrase: ClassVar[str] = "the air slows fast motion across the DLO more than slow motion"
    remedy: ClassVar[str] = (
        "Nothing to mend: air slows all fast motion. Slower motion shows less of it."
    )
    group: ClassVar[str] = "surroundings"
    batched: ClassVar[bool] = False

    coefficient: float = quantity(
        0.0, "N s^2/m^3", 0.0, 1e4, "drag over the square of the velocity across the DLO"
    )

    @classmethod
    def instead_of(
        cls, fitted: PlainRod, guessed: PlainRod, begun: Sequence[Start]
    ) -> tuple[Self, PlainRod] | None:
        """See the class: what a linear drag is above its guess is as strong in a swing."""
        if fitted.air_drag <= guessed.air_drag:
            return None
        more = fitted.air_drag - guessed.air_drag
        return cls(more / fitted.speed), fitted._replace(air_drag=guessed.air_drag)

    def taken_for(self, beside: PlainRod) -> PlainRod:
        """See the class."""
        return beside._replace(air_drag=beside.air_drag + self.coefficient * beside.speed)

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.quadratic_drag = (body.quadratic_drag or 0.0) + self.coefficient
