# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rigid plug at the DLO's free end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.command import END
from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity

RIGID = 1e3  # bending stiffness of the plug over the DLO's, which leaves 1e-3 of the DLO's own bend
EXTENTS = (0.05, 0.12)  # of the length, from which a plug is looked for
LIGHT, HEAVY = 0.02, 0.5  # likewise, of the rope's mass


@dataclass(frozen=True)
class Connector(Effect):
    """A rigid end piece from u = L - extent to L, whose mass is spread evenly over it.

    kappa = 0 there, weight m g [N], centre of mass extent / 2 [m] before the tip, moment of inertia
    m extent^2 / 12 [kg m^2] about that: rigid tip body on a beam in Meirovitch, Fundamentals of
    Vibrations, 2001. With extent to 0 it is a `point_mass` at the end, with m to 0 a stiff end.

    An end that is held is held at the plug's tip. The mass comes on top of the DLO's own there. Two
    point masses stand for the plug's: at half the mass each and extent / sqrt(12) beside its middle
    they have its weight, its centre of mass and its moment of inertia.
    """

    name: ClassVar[str] = "connector"
    title: ClassVar[str] = "plug at the free end"
    phrase: ClassVar[str] = "a rigid plug with a mass sits on the free end"
    remedy: ClassVar[str] = (
        "Weigh the plug, measure its length, and enter both under effects.connector."
    )

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
        """A short and a long plug, of no mass where the end is free, and one of half the rope's.

        At a free end that nothing weighs down a rigid end shows hardly: it counts as nothing. Where
        the end is held, too, it does not.
        """
        keys, length = ("mass", "extent"), scene.rope.length
        free = END not in scene.held
        mass = 0.0 if free else LIGHT * scene.rope.mass
        found = [
            Start(
                cls.name, {"mass": mass, "extent": share * length}, keys[:1] if free else (), keys,
                neutral=free,
            )
            for share in EXTENTS
        ]  # fmt: skip
        heavy = {"mass": HEAVY * scene.rope.mass, "extent": EXTENTS[-1] * length}
        return [*found, Start(cls.name, heavy, (), keys, neutral=False, form="heavy")]
