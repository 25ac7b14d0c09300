# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The material damps more than configured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class InternalDamping(Effect):
    """Kelvin-Voigt damping of bending, stretch and twist, added to `damping.relaxation_time`.

    Moment B (kappa + t_r dkappa/dt) [N m], t_r the relaxation time [s]: Flügge, Viscoelasticity,
    1975. With t_r = 0 the material is elastic.
    """

    name: ClassVar[str] = "internal_damping"
    title: ClassVar[str] = "internal damping"
    phrase: ClassVar[str] = (
        "the material damps its own bending more or less than the parameter file says"
    )
    remedy: ClassVar[str] = "Nothing to mend by hand: the extended file corrects the damping."

    relaxation_time: float = quantity(
        0.0, "s", -10.0, 10.0, "added relaxation time", natural=20.0, adds_to="relaxation_time",
        sides=(("more", "less"),),
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.relaxation_time += self.relaxation_time
