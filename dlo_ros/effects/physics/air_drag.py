# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The air resists more than configured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class AirDrag(Effect):
    """Linear drag of the air, added to `damping.air_drag`.

    Force per length -c v [N/m]: c the coefficient [N s/m^2], v the velocity [m/s]. A cylinder in
    creeping flow: Stokes, On the Effect of the Internal Friction of Fluids on the Motion of
    Pendulums, 1851. With c = 0 there is none but the configured one.
    """

    name: ClassVar[str] = "air_drag"
    title: ClassVar[str] = "air drag"
    phrase: ClassVar[str] = "the air slows the DLO more or less than the parameter file says"
    remedy: ClassVar[str] = "Nothing to mend by hand: the extended file corrects the drag."
    group: ClassVar[str] = "surroundings"

    coefficient: float = quantity(
        0.0, "N s/m^2", -1000.0, 1000.0, "added drag", adds_to="air_drag",
        sides=(("more", "less"),),
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.air_drag += self.coefficient
