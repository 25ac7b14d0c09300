# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Predicted shapes of the DLO, brought to the instant of an image."""

from __future__ import annotations

from collections import deque

from dlo_ros.command import NANOSECONDS
from dlo_ros.spline import FloatArray

RECENT = 0.5
"""Seconds by which the stamps of a prediction and an image may differ: half a swing at 1 Hz."""

KEPT = 200
"""Predictions that are kept, the last ones to come: four seconds of a simulator's at 50 Hz."""


class Predictions:
    """The last predictions that came, in any order of their stamps."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, FloatArray]] = deque(maxlen=KEPT)

    def add(self, stamp: int, control_points: FloatArray) -> None:
        """Take control points, shape (n, 4), predicted for a stamp [ns]; the last one counts."""
        self._kept.appendleft((stamp, control_points))

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()

    def at(self, stamp: int) -> FloatArray | None:
        """Control points at the stamp of an image [ns], shape (n, 4).

        They are interpolated between the predictions before and after it where both are recent,
        else those of the nearest one; None where no prediction is recent.
        """
        recent = [one for one in self._kept if abs(one[0] - stamp) <= RECENT * NANOSECONDS]
        before = max((s for s, _ in recent if s <= stamp), default=None)
        after = min((s for s, _ in recent if s >= stamp), default=None)
        found = {s: shape for s, shape in reversed(recent) if s in (before, after)}
        if before is None or after is None:
            return next(iter(found.values()), None)
        one, other = found[before], found[after]
        if before == after or len(one) != len(other):
            return one
        share = (stamp - before) / (after - before)
        return (1.0 - share) * one + share * other
