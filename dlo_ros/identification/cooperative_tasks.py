# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Long work in short pieces, so that callbacks of a node need not wait for all of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import TypeVar

Result = TypeVar("Result")
SHORT, LONG = None, True
Pieces = Generator[bool | None, None, Result]
"""Work that can be left and taken up again; it yields `LONG` where the next piece is a long one."""


def exhausted(pieces: Generator[object, None, Result]) -> Result:
    """The result of work after all its pieces, done at once."""
    while True:
        try:
            next(pieces)
        except StopIteration as done:
            result: Result = done.value
            return result


class Worker:
    """Does as much of some work as fits into a time budget, again and again.

    Args:
        budget: processor time of a turn [s], including what its caller has done before; infinite:
            all work is done at once. At least one piece is done in every turn.
        clock: function that returns the time by which the budget counts [s].
    """

    def __init__(self, budget: float, clock: Callable[[], float]) -> None:
        self.budget, self.clock = budget, clock
        self._work: Pieces[None] | None = None

    @property
    def busy(self) -> bool:
        """Whether some work is unfinished."""
        return self._work is not None

    def drop(self) -> None:
        """Discard the unfinished work."""
        self._work = None

    def turn(self, begin: float, due: Callable[[], Pieces[None]]) -> None:
        """Go on with the work, or with what is due where there is none.

        Args:
            begin: start of the turn, by the clock [s].
        """
        if self._work is None:
            self._work = due()
        now = self.clock()
        for long in self._work:
            before, now = now, self.clock()
            # The next piece may take as long as this one; a long one has a turn for itself.
            full = 2.0 * now - before - begin > self.budget
            if full or (long and math.isfinite(self.budget)):
                return
        self._work = None
