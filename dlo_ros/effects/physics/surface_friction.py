# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO rubs on the board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity

SHARES = (0.01, 0.1)  # of the weight, from which a friction is looked for


@dataclass(frozen=True)
class SurfaceFriction(Effect):
    """Coulomb friction per length against motion in the board's plane; below it the DLO sticks.

    |f| <= force [N/m], f against the velocity where it slides: Coulomb's law with the stick as a
    stiff spring to an anchor, Wriggers, Computational Contact Mechanics, 2006. With 0 there is
    none; a large one holds the DLO where it lies.
    """

    name: ClassVar[str] = "surface_friction"
    title: ClassVar[str] = "friction with the board"
    phrase: ClassVar[str] = "the DLO rubs on the board"
    remedy: ClassVar[str] = "Keep the DLO off the board, or make the board smoother."
    group: ClassVar[str] = "surroundings"
    smooth: ClassVar[bool] = False

    force: float = quantity(0.0, "N/m", 0.0, 100.0, "friction per length of DLO", tolerance=0.02)

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.friction = (body.friction or 0.0) + self.force

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Small and large friction."""
        key = ("force",)
        return [
            Start(cls.name, {key[0]: share * scene.rope.weight}, key, key, neutral=False)
            for share in SHARES
        ]
