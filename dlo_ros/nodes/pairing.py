# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Predicted splines interpolated to the instants of observed ones (no ROS here)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Sequence
from operator import itemgetter

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.spline import FloatArray

KEPT = 10.0
"""Seconds of predictions that are kept for observed splines that come late."""

GAP = 0.5
"""Predictions further apart than this [s] are not interpolated between."""

WAITING = 200
"""Observed splines that may wait for their prediction."""


class Pairing:
    """Interpolates predicted splines in time to the instants of observed ones, in either order."""

    def __init__(self) -> None:
        self._predictions: list[tuple[int, FloatArray]] = []
        self._waiting: deque[tuple[int, FloatArray]] = deque()
        self.missed = 0

    def clear(self) -> None:
        """Forget everything."""
        self._predictions.clear()
        self._waiting.clear()

    def forget_after(self, stamp: int) -> None:
        """Forget everything later than a stamp [ns], to which time went back."""
        kept = bisect_right(self._predictions, stamp, key=itemgetter(0))
        del self._predictions[kept:]
        self._waiting = deque(item for item in self._waiting if item[0] <= stamp)

    def predicted(self, stamp: int, control_points: FloatArray) -> None:
        """Take a prediction at a stamp [ns]; a later one for the same stamp replaces it."""
        at = bisect_left(self._predictions, stamp, key=itemgetter(0))
        if at < len(self._predictions) and self._predictions[at][0] == stamp:
            self._predictions[at] = (stamp, control_points)
        else:
            insort(self._predictions, (stamp, control_points), key=itemgetter(0))
        oldest = self._predictions[-1][0] - round(KEPT * NANOSECONDS)
        keep = bisect_left(self._predictions, oldest, key=itemgetter(0))
        del self._predictions[:keep]

    def observed(self, stamp: int, control_points: FloatArray) -> None:
        """Take an observed spline at a stamp [ns]."""
        self._waiting.append((stamp, control_points))
        if len(self._waiting) > WAITING:
            self._waiting.popleft()
            self.missed += 1

    def pairs(self) -> list[tuple[int, FloatArray, FloatArray]]:
        """Stamp, observed and predicted spline of each instant for which both are now known.

        What can have no prediction any more, since they begin later or have a gap there, is dropped
        and counted in `missed`.
        """
        found: list[tuple[int, FloatArray, FloatArray]] = []
        still: deque[tuple[int, FloatArray]] = deque()
        for stamp, observed in self._waiting:
            if not self._predictions or stamp > self._predictions[-1][0]:
                still.append((stamp, observed))
                continue
            predicted = interpolated(self._predictions, stamp)
            if predicted is None:
                self.missed += 1
            else:
                found.append((stamp, observed, predicted))
        self._waiting = still
        return found


def interpolated(predictions: Sequence[tuple[int, FloatArray]], stamp: int) -> FloatArray | None:
    """The prediction at a stamp, of third order in time where neighbours allow.

    Args:
        predictions: stamps [ns], growing, and control points, shape (n, 4).
        stamp: [ns].

    Returns:
        None where predictions are missing: outside of them, or in a gap.
    """
    after = bisect_left(predictions, stamp, key=itemgetter(0))
    if after == len(predictions):
        return None
    if predictions[after][0] == stamp:
        return predictions[after][1]
    if after == 0:
        return None
    around = predictions[max(after - 2, 0) : after + 2]
    inner = [s for s, _ in predictions[after - 1 : after + 1]]
    if inner[1] - inner[0] > GAP * NANOSECONDS:
        return None
    around = [(s, q) for s, q in around if abs(s - stamp) <= GAP * NANOSECONDS]
    # Lagrange's polynomial; linear interpolation at 50 Hz would be wrong by up to a * 50 us^2,
    # half a millimetre at 1 g.
    t = np.array([(s - stamp) / NANOSECONDS for s, _ in around])
    weights = [
        np.prod([t[j] / (t[j] - t[i]) for j in range(len(t)) if j != i]) for i in range(len(t))
    ]
    result = np.zeros_like(around[0][1])
    for weight, (_, q) in zip(weights, around, strict=True):
        result += weight * q
    return result
