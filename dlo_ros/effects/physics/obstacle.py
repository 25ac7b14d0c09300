# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO touches a peg that the model does not know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Peg, Scene, Start, quantity


@dataclass(frozen=True)
class Obstacle(Effect):
    """A round peg that stands on the board, frictionless; the DLO's own radius comes on top.

    Pressure in proportion to how deep the axis is within radius + D / 2 of the peg's [m], radially
    outwards: penalty contact, Wriggers, Computational Contact Mechanics, 2006. A very large peg is
    a `wall`; one that is not reached does nothing.
    """

    name: ClassVar[str] = "obstacle"
    title: ClassVar[str] = "peg"
    phrase: ClassVar[str] = "the DLO touches something that the simulation does not know"
    remedy: ClassVar[str] = (
        "Move away what the DLO touches, or measure its place and enter that under "
        "effects.obstacle."
    )
    group: ClassVar[str] = "surroundings"
    smooth: ClassVar[bool] = False
    differentiable: ClassVar[bool] = False

    x: float = quantity(0.0, "m", -100.0, 100.0, "of the peg's axis", role="point")
    z: float = quantity(-99.0, "m", -100.0, 100.0, "of the peg's axis", role="point")
    radius: float = quantity(
        0.005, "m", 1e-4, 10.0, "of the peg itself", role="extent", search=(0.002, 0.3)
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.pegs.append(Peg(self.x, self.z, self.radius))

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """None: pegs are sought beside outlier frames, by `dlo_ros.diagnosis.contact`."""
        return []
