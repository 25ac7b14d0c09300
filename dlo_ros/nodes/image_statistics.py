# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Statistics of a camera's images: rate, latency and losses."""

from __future__ import annotations

from collections import deque
from statistics import median

from dlo_ros.command import NANOSECONDS

REMEMBERED = 31
"""Images over which the usual interval and the usual latency are taken."""

LONGEST = 2.0
"""Seconds without an image after which the camera has paused instead of losing images."""

LATE = 1.6
"""Times the usual interval that two neighbouring images may lie apart."""


class ImageStatistics:
    """Rate, latency and losses by the stamps of images, in the order of their arrival."""

    def __init__(self) -> None:
        self.dropped = 0
        self._last: int | None = None
        self._intervals: deque[int] = deque(maxlen=REMEMBERED)
        self._latencies: deque[float] = deque(maxlen=REMEMBERED)

    def reset(self) -> None:
        """Time went back: the next image has no predecessor."""
        self._last = None

    def arrived(self, stamp: int) -> None:
        """Count an image.

        Args:
            stamp: stamp of the image [ns].
        """
        last, self._last = self._last, stamp
        if last is None or not 0 < stamp - last < LONGEST * NANOSECONDS:
            return
        interval = stamp - last
        if len(self._intervals) >= 5:
            usual = median(self._intervals)
            if interval > LATE * usual:
                self.dropped += round(interval / usual) - 1
        self._intervals.append(interval)

    def worked_off(self, latency: float) -> None:
        """Record the time from an image's stamp to its published spline [s]."""
        self._latencies.append(latency)

    @property
    def rate(self) -> float:
        """Images per second by their stamps; NaN before there are two."""
        return NANOSECONDS / median(self._intervals) if self._intervals else float("nan")

    @property
    def latency(self) -> float:
        """Median latency [s]; NaN before the first."""
        return median(self._latencies) if self._latencies else float("nan")
