# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO is flat: it bends more easily about one axis of its section than about the other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity

ANGLES = (0.0, 0.25 * math.pi)  # from which it is looked for; with E they span all small ratios


@dataclass(frozen=True)
class Anisotropy(Effect):
    """Two bending stiffnesses: B about an axis of the section, `ratio` times B about the other.

    Moments M1 = B kappa1, M2 = ratio B kappa2 about the section's principal axes [N m], curvatures
    in 1/m: Love, A Treatise on the Mathematical Theory of Elasticity, 1927. `angle` is from the
    first material director, the clamp's y axis, to the axis of B, towards the second. With the
    angle 0 nothing changes in the board's plane, with the ratio 1 nowhere. Torsion stays that of
    the round section.
    """

    name: ClassVar[str] = "anisotropy"
    title: ClassVar[str] = "flat section"
    phrase: ClassVar[str] = (
        "the DLO is flat and bends more easily about one axis of its section than about the other"
    )
    remedy: ClassVar[str] = (
        "Nothing to mend: a flat cable is like that. Clamp it the same way round in all recordings."
    )

    ratio: float = quantity(
        1.0, "", 0.01, 100.0, "the other bending stiffness over B", role="ratio", tolerance=0.1,
        spatial=True, sides=(("larger", "smaller"),),
    )  # fmt: skip
    angle: float = quantity(
        0.0, "rad", -1.6, 1.6, "of the axis of B in the material frame", role="angle", spatial=True
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.bend[:, 1] *= self.ratio
        body.section_angle += self.angle

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """A round section, along its directors and between them; nowhere in the plane alone."""
        keys = ("ratio", "angle")
        return [
            Start(cls.name, {"ratio": 1.0, "angle": angle}, keys[:1], keys)
            for angle in ANGLES
            if scene.spatial
        ]
