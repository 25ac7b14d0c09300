# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO rubs on the board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class SurfaceFriction(Effect):
    """Coulomb friction per length against motion in the board's plane; below it the DLO sticks."""

    name: ClassVar[str] = "surface_friction"

    force: float = quantity(0.0, "N/m", 0.0, 100.0, "friction per length of DLO")

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.friction = (body.friction or 0.0) + self.force
