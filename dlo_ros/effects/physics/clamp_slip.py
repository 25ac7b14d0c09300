# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO creeps through a grip while it is moved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity

EVENLY = -1.0  # [s] onset of a slip that has none
SUDDEN = 0.1  # [s] that a grip takes that gives way at one moment
ONSETS = (0.5, 1.0, 1.5, 2.0, 2.5, 4.0, 7.0)
"""Moments at which a grip that gives way is looked for [s]."""
GRADUAL, SLOW_ONSETS = 2.0, (0.0, 1.0)
"""Time that a grip takes that gives way little by little, and moments at which it begins [s]."""
LONG = 60.0  # [s] within which it is


@dataclass(frozen=True)
class ClampSlip(Effect):
    """Free length gained through a grip; the material coordinate is spread evenly over the DLO.

    Geometry, no source: true free length = L + length s [m]. Without an onset s is the part of
    their commanded path that the imposed points have travelled, and `length` is gained at the end
    of the commanded motion. With one the grip gives way at that moment: s = r^2 (3 - 2 r) with
    r = (t - onset) / duration from 0 to 1, times in s. Before the onset the DLO is that without
    the effect, after the duration one with a `length_error` of `length`.
    """

    name: ClassVar[str] = "clamp_slip"
    title: ClassVar[str] = "slip through a clamp"
    phrase: ClassVar[str] = "the DLO slips through a clamp while it moves"
    remedy: ClassVar[str] = "Tighten the clamp, or line it with rubber, and record again."
    group: ClassVar[str] = "clamps"
    batched: ClassVar[bool] = False

    length: float = quantity(
        0.0, "m", -1.0, 1.0, "free length gained by the end of the motion", tolerance=0.005,
        sides=(("of free length gained", "of free length lost"),),
    )  # fmt: skip

    onset: float = quantity(
        EVENLY, "s", EVENLY, 1e4, "when the grip gives way, from the first frame; negative: evenly",
        role="place", search=(0.0, LONG), once=True,
    )  # fmt: skip

    duration: float = quantity(
        SUDDEN, "s", 1e-2, 1e4, "how long the grip takes to give way, where it has an onset",
        search=(2e-2, LONG), once=True,
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.slip = (body.slip or 0.0) + self.length
        if self.onset >= 0.0:
            body.slip_step = (self.onset, self.duration)

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Evenly, and from several moments on, all at once or little by little."""
        size = ("length",)
        found = [Start(cls.name, {"length": 0.0}, size, size, form="even")]
        steps = [(onset, SUDDEN, "sudden") for onset in ONSETS]
        steps += [(onset, GRADUAL, "gradual") for onset in SLOW_ONSETS]
        for onset, duration, form in steps:
            block = {"length": 0.0, "onset": onset, "duration": duration}
            found.append(Start(cls.name, block, size, tuple(block), form=form))
        return found
