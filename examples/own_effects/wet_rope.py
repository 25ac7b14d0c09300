# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Water in the rope: an effect of another package, complete."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects import Body, Effect, quantity


@dataclass(frozen=True)
class WetRope(Effect):
    """Water that the rope has soaked up, from its end to a height along the rope.

    It adds mass and weight, no stiffness. The linear density of the model is the same all along
    the rope, so the water hangs on it as masses, one at each quadrature point.
    """

    name: ClassVar[str] = "wet_rope"

    water: float = quantity(0.0, "kg/m", 0.0, 10.0, "mass of water per length")
    dry: float = quantity(0.0, "m", 0.0, 100.0, "where the wet part begins, u", role="place")

    def shape_body(self, body: Body) -> None:
        """Change the rod."""
        body.within("wet_rope.dry", self.dry)
        wet = body.coverage(self.dry, body.length)
        for place, share, width in zip(body.points, wet, body.weight, strict=True):
            body.masses.append((float(self.water * share * width), float(place)))
