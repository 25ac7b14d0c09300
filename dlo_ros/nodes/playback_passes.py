# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Passes of a recording that is played in a loop: messages of the present and the earlier pass.

When the clock goes back, messages of the earlier pass are still on their way, for instance splines
of images that the observer had not processed. Their stamps lie ahead of the new clock.
"""

from __future__ import annotations

import time

from dlo_ros.command import NANOSECONDS

AHEAD = 0.5
"""Seconds that a stamp may lie ahead of the clock because the clock itself arrives late."""

UNDER_WAY = 10.0
"""Seconds of wall time that a message may be under way: ten images that wait, a second each."""


class PlaybackPasses:
    """Recognises, after a jump of the clock to an earlier time, messages sent before the jump.

    Some cameras stamp ahead of the clock of the recording; their lead is measured while no message
    of an earlier pass can be under way.
    """

    def __init__(self) -> None:
        self._end = 0
        self._jumped_at = 0.0
        self._lead = 0

    def went_back(self, before: int) -> None:
        """Record that the clock went back from a time [ns]."""
        self._end = before
        self._jumped_at = time.monotonic()

    def is_earlier(self, stamp: int, now: int) -> bool:
        """Whether a message that arrives now belongs to a pass before.

        Args:
            stamp: stamp of the message [ns].
            now: the clock [ns].
        """
        jumped = now < self._end and time.monotonic() - self._jumped_at < UNDER_WAY
        if not jumped:
            if now:
                self._lead = max(self._lead, stamp - now)
            return False
        return stamp - now > self._lead + AHEAD * NANOSECONDS
