# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Synchronisation of several sensors by approximate stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from statistics import median
from typing import Generic, TypeVar

Item = TypeVar("Item")

WAITING = 30  # items of a sensor that may wait for the others'; the oldest are dropped
USUAL_PERIOD = 50_000_000  # [ns] of the first sensor, until two of its stamps are known
SHARE = 0.5  # of the first sensor's period, which two stamps of one instant may be apart
RECENT = 15  # intervals of the first sensor, whose median is its period: lost items lengthen a few


class ApproximateTime(Generic[Item]):
    """Finds for each item of the first sensor the item of every other one nearest in time.

    Args:
        names: names of the sensors; the first one's stamps count.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        self.unmatched = 0
        self._waiting: dict[str, deque[tuple[int, Item]]] = {}
        self._period = USUAL_PERIOD
        self._recent: deque[int] = deque(maxlen=RECENT)
        self._before: int | None = None
        self.clear()

    def clear(self) -> None:
        """Drop the items that wait."""
        self._waiting = {name: deque(maxlen=WAITING) for name in self.names}
        self._before = None

    def add(self, name: str, stamp: int, item: Item) -> list[dict[str, tuple[int, Item]]]:
        """Take an item.

        Args:
            name: name of the sensor.
            stamp: [ns]; those of one sensor grow.
            item: item that the sensor produced at that instant.

        Returns:
            The sets that are complete now, with their stamps [ns], in the order of time.
        """
        waiting = self._waiting[name]
        if waiting and stamp <= waiting[-1][0]:
            return []
        if name == self.names[0]:
            if self._before is not None and stamp > self._before:
                self._recent.append(stamp - self._before)
                self._period = int(median(self._recent))
            self._before = stamp
            self.unmatched += len(waiting) == WAITING
        waiting.append((stamp, item))
        return self._complete()

    def rest(self) -> list[dict[str, tuple[int, Item]]]:
        """The sets that can be made of the items that wait, where no more will come."""
        return self._complete(more=False)

    def _complete(self, *, more: bool = True) -> list[dict[str, tuple[int, Item]]]:
        first, *others = (self._waiting[name] for name in self.names)
        result = []
        while first:
            stamp = first[0][0]
            # The nearest is known once another has come that is no earlier.
            if more and any(not other or other[-1][0] < stamp for other in others):
                break
            found = {self.names[0]: first.popleft()}
            for name, other in zip(self.names[1:], others, strict=True):
                while len(other) > 1 and abs(other[1][0] - stamp) <= abs(other[0][0] - stamp):
                    other.popleft()
                if other and abs(other[0][0] - stamp) <= SHARE * self._period:
                    found[name] = other[0]
            if len(found) == len(self.names):
                for other in others:
                    other.popleft()
                result.append(found)
            else:
                self.unmatched += 1
        return result
