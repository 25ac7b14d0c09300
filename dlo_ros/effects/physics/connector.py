# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rigid plug at the DLO's free end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.command import END
from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity

RIGID = 1e3  # bending stiffness of the plug over the DLO's, which leaves 1e-3 of the DLO's own bend
EXTENTS = (0.05, 0.15)  # of the length, from which a plug is looked for
HEAVY = 0.5  # likewise, of the rope's mass


@dataclass(frozen=True)
class Connector(Effect):
    """A rigid end piece from u = L - extent to L, whose mass is spread evenly over it.

    The mass comes on top of the DLO's own there. Two point masses stand for the plug's: at half the
    mass each and extent / sqrt(12) beside its middle they have its weight, its centre of mass and
    its moment of inertia.
    """

    name: ClassVar[str] = "connector"
    title: ClassVar[str] = "plug at the free end"
    phrase: ClassVar[str] = "a rigid plug with a mass sits on the free end"
    varied_in_batch: ClassVar[bool] = True

    mass: float = quantity(0.0, "kg", 0.0, 10.0, "its mass", tolerance=0.1)
    extent: float = quantity(0.0, "m", 0.0, 100.0, "its length", role="extent", search=(0.01, 0.4))

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.within("connector.extent", self.extent)
        rigid = body.coverage(body.length - self.extent, body.length)
        body.bend /= 1.0 + (1.0 / RIGID - 1.0) * rigid[:, None]
        middle, apart = body.length - 0.5 * self.extent, self.extent / math.sqrt(12.0)
        body.masses += [(0.5 * self.mass, middle + side * apart) for side in (1.0, -1.0)]

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """A short and a long plug of about half the rope's mass, where the end is free."""
        if END in scene.held:
            return []
        keys = ("mass", "extent")
        return [
            Start(
                cls.name, {"mass": HEAVY * scene.rope.mass, "extent": share * scene.rope.length},
                (), keys, neutral=False,
            )
            for share in EXTENTS
        ]  # fmt: skip
