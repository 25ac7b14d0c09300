# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO resists twist more or less than a solid round rod of its material."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class TwistingStiffness(Effect):
    """A twisting stiffness C that is `ratio` times G J, that of a round section.

    Torque C tau [N m], tau the twist [rad/m]; G J = E pi D^4 / (64 (1 + nu)) with rod.poisson_ratio
    nu (Saint-Venant's torsion: Timoshenko and Goodier, Theory of Elasticity, 1970). Strands that
    slide on one another resist twist less, a braid around them more. With the ratio 1 nothing
    changes, and in the board's plane never.
    """

    name: ClassVar[str] = "twisting_stiffness"
    title: ClassVar[str] = "twisting stiffness"
    phrase: ClassVar[str] = (
        "the DLO's twisting stiffness is larger or smaller than that of a solid rod of its material"
    )
    remedy: ClassVar[str] = "Nothing to mend: a stranded or braided cable is no solid rod."
    in_setup: ClassVar[bool] = True

    ratio: float = quantity(
        1.0, "", 0.01, 100.0, "over that of a round section of the same material", role="ratio",
        tolerance=0.7, spatial=True, sides=(("larger", "smaller"),),
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.twisting_ratio *= self.ratio
