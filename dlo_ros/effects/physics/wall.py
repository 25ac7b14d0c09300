# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO touches a straight wall, or lies on a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, Wall, quantity
from dlo_ros.effects.start import Reach
from dlo_ros.spline import FloatArray

OUT_OF_REACH = -100.0  # [m] beyond every rope
DEPTHS = (0.02, 0.08)  # of the length, that a wall may take of where shapes would be without it


@dataclass(frozen=True)
class StraightWall(Effect):
    """A frictionless half-plane; the DLO's own radius comes on top.

    Pressure in proportion to offset + D / 2 - n . x where that is positive [m], n = (sin angle,
    cos angle) in x and z: penalty contact, Wriggers, Computational Contact Mechanics, 2006. Free is
    where the coordinate along the normal is larger than `offset`; the normal is z turned by `angle`
    from x towards -z. A table has the angle 0 and its height as offset; one that is out of reach
    does nothing.
    """

    name: ClassVar[str] = "wall"
    title: ClassVar[str] = "wall or table"
    phrase: ClassVar[str] = "the DLO touches a wall or lies on a table"
    remedy: ClassVar[str] = (
        "Move away what the DLO touches, or measure its place and enter that under effects.wall."
    )
    group: ClassVar[str] = "surroundings"
    differentiable: ClassVar[bool] = False
    batched: ClassVar[bool] = False

    offset: float = quantity(
        OUT_OF_REACH, "m", OUT_OF_REACH, 100.0, "of the wall along its normal", role="point"
    )
    angle: float = quantity(
        0.0, "rad", -3.2, 3.2, "of its normal against z: positive clockwise, as the camera sees it"
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.walls.append(Wall(math.sin(self.angle), math.cos(self.angle), self.offset))

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """A table, and walls at both sides, that hold back what goes furthest, but no held end."""
        if scene.reach is None:
            return []
        far = _towards_free_side(scene.reach)
        held = _towards_free_side(scene.held_reach or (math.inf, -math.inf, math.inf))
        sides = (("table", 0.0), ("left", 0.5 * math.pi), ("right", -0.5 * math.pi))
        return [
            cls._start(offset, angle, form)
            for (form, angle), end, nearest in zip(sides, far, held, strict=True)
            for offset in (end + depth * scene.rope.length for depth in DEPTHS)
            if offset < nearest
        ]

    @classmethod
    def touching(cls, normal: FloatArray, offset: float) -> Start:
        """A wall at one place.

        Args:
            normal: unit normal towards the free side (x, z), shape (2,).
            offset: coordinate of the wall along it [m].
        """
        return cls._start(offset, math.atan2(normal[0], normal[1]), "touched")

    @classmethod
    def _start(cls, offset: float, angle: float, form: str) -> Start:
        keys = ("offset", "angle")
        return Start(
            cls.name, {keys[0]: offset, keys[1]: angle}, keys, keys, neutral=False, form=form
        )


def _towards_free_side(reach: Reach) -> tuple[float, float, float]:
    """Smallest coordinates along the normals of a table, a left and a right wall [m]."""
    left, right, low = reach
    return low, left, -right
