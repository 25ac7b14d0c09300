# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A grip gives way: it turns under the DLO's moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity
from dlo_ros.effects.start import at_clamps

NATURAL = (
    0.3  # of 1/(weight per length L^2): the rope's own weight, held level, turns it by 0.15 rad
)


@dataclass(frozen=True)
class ClampCompliance(Effect):
    """A torsional spring between a grip and the DLO: angle = compliance times moment.

    angle = c M, M the moment at the end [N m], c in rad/(N m): a torsional spring at a support in
    Timoshenko, Young and Weaver, Vibration Problems in Engineering, 1974. With c = 0 the grip is
    rigid; with c to infinity the end is held in place and free to turn.

    The end stays where it is held. An end whose direction is free has no moment, and nothing turns.
    The spring is damped and relaxes as the DLO does, which softens or yields beside it. Its
    compliance is spread over the first knot span, see `Body.give_at_grips`; docs/effects.md tells
    how exact that is.
    """

    name: ClassVar[str] = "clamp_compliance"
    title: ClassVar[str] = "give of a grip"
    phrase: ClassVar[str] = "a grip turns under the moment of the DLO"
    remedy: ClassVar[str] = "Tighten the grip, or let it hold a longer piece of the DLO."
    group: ClassVar[str] = "clamps"

    start: float = quantity(
        0.0, "rad/(N m)", 0.0, 1e6, "at the start", natural=NATURAL, search=(0.0, 5.0)
    )
    end: float = quantity(
        0.0, "rad/(N m)", 0.0, 1e6, "at the end", natural=NATURAL, search=(0.0, 5.0)
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        start, end = body.grip_compliance or (0.0, 0.0)
        body.grip_compliance = (start + self.start, end + self.end)

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Each clamp alone, and both."""
        return at_clamps(cls.name, scene)
