# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Bent too far, the DLO keeps a set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity

CURVATURE_SHARES = (0.25, 0.5, 0.85)
"""Curvatures at which the DLO may have yielded, over those that occur."""
HARDENING = 0.35  # from which one is looked for


@dataclass(frozen=True)
class Plasticity(Effect):
    """The rest curvature follows past the yield, with linear kinematic hardening.

    Moment B (kappa - kappa_p) [N m] with |kappa - kappa_p - h kappa_p| <= yield_curvature [1/m] and
    h = hardening / (1 - hardening), so that the tangent stiffness past the yield is `hardening`
    times B: Prager, The Theory of Plasticity, 1955; implicit step: Simo and Hughes, Computational
    Inelasticity, 1998. On the way back it is elastic again over twice the yield curvature
    (Bauschinger). With `hardening` 1 or an infinite yield curvature bending is elastic, with 0
    ideally plastic.
    """

    name: ClassVar[str] = "plasticity"
    title: ClassVar[str] = "lasting bend"
    phrase: ClassVar[str] = "the DLO stays bent where it has been bent strongly"
    remedy: ClassVar[str] = "Bend the DLO less strongly, or straighten it before each recording."
    smooth: ClassVar[bool] = False

    yield_curvature: float = quantity(1e6, "1/m", 0.01, 1e6, "elastic curvature at the yield")
    hardening: float = quantity(
        0.5, "", 0.0, 1.0, "tangent stiffness past the yield, of that before", search=(0.0, 0.99)
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.yield_curvature = min(body.yield_curvature, self.yield_curvature)
        body.hardening = self.hardening

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Yield curvatures below the curvatures that occur."""
        keys = ("yield_curvature", "hardening")
        return [
            Start(cls.name, {keys[0]: share * scene.curvature, keys[1]: HARDENING}, keys, keys,
                  neutral=False)
            for share in CURVATURE_SHARES
        ]  # fmt: skip
