# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO softens in bending, as a bundle whose strands begin to slide does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity

CURVATURE_SHARES = (1.0, 4.0)
"""Curvatures at which the stiffness may have halved, over those that occur."""


@dataclass(frozen=True)
class NonlinearStiffness(Effect):
    """Softening: tangent stiffness B / (1 + (kappa / h)^2), so the moment is an arc tangent.

    M = B h atan(kappa / h) [N m], h the `half_curvature` [1/m]; a choice of a smooth softening law
    with one number, no source. With h to infinity it is linear; far beyond h the moment stays below
    pi B h / 2.
    """

    name: ClassVar[str] = "nonlinear_stiffness"
    title: ClassVar[str] = "softening"
    phrase: ClassVar[str] = "the DLO is softer where it is bent strongly"
    remedy: ClassVar[str] = (
        "Nothing to mend: many cables soften as they bend. Smaller bends show less of it."
    )
    smooth: ClassVar[bool] = False

    half_curvature: float = quantity(
        1e6, "1/m", 0.01, 1e6, "curvature at which the tangent stiffness has halved"
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.half_curvature = min(body.half_curvature, self.half_curvature)

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Half curvatures near the curvatures that occur."""
        key = ("half_curvature",)
        return [
            Start(cls.name, {key[0]: factor * scene.curvature}, key, key, neutral=False)
            for factor in CURVATURE_SHARES
        ]
