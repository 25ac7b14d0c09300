# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Tasks on one set of recordings, shared out among a few processes."""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings

Progress = Callable[[str, float], None]
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Problem:
    """The recordings that are to be explained.

    Args:
        given: the parameter file, for what is known beforehand.
        drafts: recordings with a coarse simulation, perhaps shortened, to try effects with.
    """

    given: Settings
    drafts: tuple[Recording, ...]


_problem: Problem | None = None
"""Set in every worker process, so that recordings are not sent with every task."""


def _adopt(problem: Problem) -> None:
    global _problem
    _problem = problem
    logging.disable(logging.WARNING)  # what is only tried need not be told


class Workers:
    """Runs tasks on one problem, in several processes where there are several."""

    def __init__(self, problem: Problem, pool: ProcessPoolExecutor | None) -> None:
        self.problem = problem
        self._pool = pool

    def each(
        self, task: Callable[[Problem, Item], Result], items: Sequence[Item]
    ) -> Iterator[Result]:
        """The results of a task in the order of its items."""
        if self._pool is None:
            for item in items:
                yield task(self.problem, item)
        else:
            yield from self._pool.map(partial(_run, task), items)


def _run(task: Callable[[Problem, Any], Any], item: Any) -> Any:
    assert _problem is not None
    return task(_problem, item)


@contextmanager
def workers(problem: Problem, count: int) -> Iterator[Workers]:
    """Worker processes for a problem, forked, so that compiled code is loaded already."""
    methods = multiprocessing.get_all_start_methods()
    if count <= 1 or "fork" not in methods:
        yield Workers(problem, None)
        return
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(count, context, initializer=_adopt, initargs=(problem,))
    try:
        yield Workers(problem, pool)
    finally:
        pool.shutdown(cancel_futures=True)
