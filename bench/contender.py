# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The interface through which simulators are compared."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.reference import reference
from bench.tasks import Task
from dlo_ros.spline import FloatArray

Setting = Mapping[str, Any]
MARGIN = 0.98  # a chosen setting keeps this share of the error, so that rounding decides nothing
SLOW = 0.3  # [s] runs that take longer are timed once in the search


class Failure(Exception):
    """A simulation that blew up or did not converge."""


@dataclass(frozen=True)
class Prepared:
    """A simulation ready to run.

    Args:
        run: simulates the whole task from its start, as often as wanted; this is timed.
        curves: function that makes the shapes (instants, points, 2) [m] out of what `run` returned;
            not timed.
    """

    run: Callable[[], Any]
    curves: Callable[[Any], FloatArray]


class Contender(ABC):
    """One simulator in one form.

    Args:
        name: the simulator's name in tables.
    """

    name: str
    size: str  # which key of a setting is the number of elements
    stretch = True  # whether its rod can stretch
    drag = False  # whether it damps a motion by drag instead of Kelvin-Voigt damping

    @abstractmethod
    def settings(self, task: Task) -> Iterable[list[Setting]]:
        """Settings to try, in lists from cheap to expensive; a list is left once it is good
        enough.
        """

    @abstractmethod
    def prepare(self, task: Task, setting: Setting) -> Prepared:
        """Build the simulation of a task."""

    def error(self, task: Task, setting: Setting) -> float:
        """Error over L; infinite where it fails.

        No setting counts that is right by luck. A settled shape must be right at the end and when
        it is held for as long once more, so that it does not just pass by the right one; and every
        setting must be as good with a quarter more elements, so that no two errors cancel.
        """
        right = reference(task, stretch=self.stretch, drag=self.drag)
        finer = {**setting, self.size: int(np.ceil(1.25 * setting[self.size]))}
        trials = [(task, setting), (task, finer)]
        if not task.moving:
            trials.insert(1, (replace(task, duration=2.0 * task.duration), setting))
        worst = 0.0
        for part, chosen in trials:
            try:
                prepared = self.prepare(part, chosen)
                worst = max(worst, task.error(prepared.curves(prepared.run()), right))
            except Failure:
                return np.inf
            if worst > max(task.levels):
                break
        return worst


@dataclass(frozen=True)
class Choice:
    """The cheapest setting that was found.

    Args:
        contender, task, level, setting: simulator, simulation, accuracy and setting that belong
            together.
        error: measured error of the shapes, over L.
        rough: cost in the search [ms of CPU per simulated second].
    """

    contender: Contender
    task: Task
    level: float
    setting: Setting
    error: float
    rough: float


def cpu_time(run: Callable[[], Any], at_least: float) -> float:
    """CPU time of one call [s], the mean over as many as fill a time."""
    count, began = 0, time.process_time()
    while True:
        run()
        count += 1
        used = time.process_time() - began
        if used >= at_least:
            return used / count


def search(contender: Contender, task: Task) -> dict[float, Choice]:
    """The cheapest setting for every level of a task; levels not reached are missing."""
    tried: list[tuple[float, float, Setting]] = []
    best = dict.fromkeys(task.levels, np.inf)
    for chain in contender.settings(task):
        for setting in chain:
            try:
                cost = cpu_time(contender.prepare(task, setting).run, 0.0)
            except Failure:
                continue
            error = contender.error(task, setting)
            reached = [level for level in task.levels if error <= MARGIN * level]
            if reached:
                tried.append((cost, error, setting))
            best.update({level: min(best[level], cost) for level in reached})
            missing = [best[level] for level in task.levels if level not in reached]
            if not missing or cost > 2.0 * max(missing):
                break
    found = {}
    for level in task.levels:
        good = sorted((t for t in tried if t[1] <= MARGIN * level), key=lambda t: t[0])[:8]
        choice: Choice | None = None
        for rough, error, setting in good[:1] if good and good[0][0] > SLOW else good:
            run = contender.prepare(task, setting).run
            # The best of three: a busy machine only ever adds.
            used = min(cpu_time(run, 0.01) for _ in range(3)) if rough < SLOW else rough
            cost = 1e3 * used / task.duration
            if choice is None or cost < choice.rough:
                choice = Choice(contender, task, level, setting, error, cost)
        if choice is not None:
            found[level] = choice
    return found
