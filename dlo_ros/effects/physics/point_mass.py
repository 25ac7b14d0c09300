# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A mass fixed to the DLO: a connector, a marker, a hung weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class PointMass(Effect):
    """A point mass at the DLO's axis, with weight and inertia but no moment of inertia."""

    name: ClassVar[str] = "point_mass"

    mass: float = quantity(0.0, "kg", 0.0, 10.0, "the mass")
    position: float = quantity(0.0, "m", 0.0, 100.0, "where it is fixed, u")

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.within("point_mass.position", self.position)
        body.masses.append((self.mass, self.position))
