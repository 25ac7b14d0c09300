# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Part of the bending stiffness relaxes: a polymer that creeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from dlo_ros.effects.base import Body, Effect, PlainRod, Scene, Start, quantity

TIMES = (0.03, 0.3, 3.0)  # [s] from which one is looked for
TAKEN_SHARE = 0.6  # share of the stiffness with which it takes over what damping stood for
LARGEST_SHARE = 0.9  # of those that are looked for: something must hold the DLO up


@dataclass(frozen=True)
class Viscoelasticity(Effect):
    """Standard linear solid in bending: `share` of the stiffness relaxes within `time`.

    Moment B ((1 - share) kappa + q) [N m], dq/dt = share dkappa/dt - q / time, in 1/m and s: Zener,
    Elasticity and Anelasticity of Metals, 1948; step: Simo and Hughes, Computational Inelasticity,
    1998. Young's modulus is that of fast motion; a DLO at rest, also at its start, has 1 - share of
    it. With time to 0 it is `internal_damping` of share / (1 - share) time on (1 - share) E in
    bending, with time to infinity elastic with E.
    """

    name: ClassVar[str] = "viscoelasticity"
    title: ClassVar[str] = "creep"
    phrase: ClassVar[str] = "part of the DLO's stiffness gives way with time"
    remedy: ClassVar[str] = (
        "Nothing to mend: the material creeps. Let it rest for as long before each recording."
    )
    batched: ClassVar[bool] = False

    share: float = quantity(
        0.0, "", 0.0, 0.999, "of the bending stiffness that relaxes", natural=0.3,
        search=(0.0, LARGEST_SHARE),
    )  # fmt: skip
    time: float = quantity(
        1.0, "s", 1e-3, 1e4, "in which it relaxes", natural=1.0, search=(1e-2, 100.0)
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.relaxing = (self.share, self.time)

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """No relaxation at first, with a short, a middle and a long time."""
        return [
            Start(cls.name, {"share": 0.0, "time": time}, ("share",), ("share", "time"))
            for time in TIMES
        ]

    @classmethod
    def instead_of(
        cls, fitted: PlainRod, guessed: PlainRod, begun: Sequence[Start]
    ) -> tuple[Self, PlainRod] | None:
        """The creep whose slow motion is that of a softer rod that is damped more than guessed."""
        slow = fitted.relaxation_time - guessed.relaxation_time
        if slow <= 0.0:
            return None
        left = 1.0 - TAKEN_SHARE
        stiffer = fitted._replace(
            young_modulus=fitted.young_modulus / left, relaxation_time=guessed.relaxation_time
        )
        return cls(TAKEN_SHARE, slow * left / TAKEN_SHARE), stiffer

    def taken_for(self, beside: PlainRod) -> PlainRod:
        """See the class: the limit of a short time."""
        left = 1.0 - self.share
        slow = self.share / left * self.time
        return beside._replace(
            young_modulus=left * beside.young_modulus,
            relaxation_time=beside.relaxation_time + slow,
        )

    def giving_way(self, beside: PlainRod) -> tuple[float, PlainRod]:
        """See the base class."""
        return self.share, beside

    @classmethod
    def that_gives_way(
        cls, share: float, stiff: PlainRod, begun: Sequence[Start]
    ) -> tuple[Self, PlainRod]:
        """See the base class: the time is the middle one of the starts."""
        times = sorted(float(s.block["time"]) for s in begun)  # type: ignore[arg-type]  # one number
        return cls(share, times[len(times) // 2]), stiff
