# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The bending stiffness changes steadily along the DLO."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class StiffnessGradient(Effect):
    """A bending stiffness that changes along the DLO.

    B(u) = B (1 + change (u / L - 1/2)) [N m^2]; a choice of the simplest change, no source. With 0
    it is even, and B is that in the middle.
    """

    name: ClassVar[str] = "stiffness_gradient"
    title: ClassVar[str] = "stiffness gradient"
    phrase: ClassVar[str] = "the DLO is stiffer towards the end or stiffer towards the start"
    remedy: ClassVar[str] = (
        "Nothing to mend, unless one end is worn or taped. Keep start and end the same way round."
    )
    in_setup: ClassVar[bool] = True
    idealised: ClassVar[bool] = True

    change: float = quantity(
        0.0, "", -1.9, 1.9, "relative change from start to end", tolerance=0.3,
        sides=(("stiffer towards the end", "stiffer towards the start"),),
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.bend *= 1.0 + self.change * (body.points / body.length - 0.5)[:, None]
