"""Tries effects: a linear test of every beginning, then a fit of the best ones.

Every task is a simulation of all recordings, so tasks go to a few processes.
"""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from dlo_ros.diagnosis import judging
from dlo_ros.diagnosis.candidates import Start, moved
from dlo_ros.diagnosis.fitting import Evaluation, Normal, evaluate, fit, total
from dlo_ros.diagnosis.measured import Recording
from dlo_ros.diagnosis.model import LOOSE, Model, names
from dlo_ros.errors import SimulationError
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

FIRST_ITERATIONS = 2
MORE_ITERATIONS = 8
PROMISING = 4.0
"""Excess over the noise, against the best candidate's, up to which a fit is carried on."""
AT_LEAST = 3
OTHER_PLACE = 0.7
"""Share of the best gain from which another beginning of the same effect is fitted, too."""

Progress = Callable[[str, float], None]
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Problem:
    """What is to be explained.

    Args:
        recordings: with their noise.
        given: the parameter file, for what is known beforehand.
    """

    recordings: tuple[Recording, ...]
    given: Settings

    @property
    def count(self) -> int:
        """Numbers that were measured."""
        return sum(len(r.times) * len(r.noise) for r in self.recordings)


@dataclass(frozen=True)
class Candidate:
    """A fitted extension.

    Args:
        effect: the one that was added last.
        form: see `Start`.
        at: the fit, with derivatives.
        score: see `judging.predictive_score`; lower is better.
        structure: what repeats from frame to frame, in units of the noise.
    """

    effect: str
    form: str
    at: Evaluation
    score: float
    structure: float


_problem: Problem | None = None
"""Set in every worker process, so that recordings are not sent with every task."""


def _adopt(problem: Problem) -> None:
    global _problem
    _problem = problem


class Workers:
    """Carries out tasks on one problem, in processes where there are several."""

    def __init__(self, problem: Problem, pool: ProcessPoolExecutor | None) -> None:
        self.problem = problem
        self._pool = pool

    def each(
        self, task: Callable[[Problem, Item], Result], items: Sequence[Item]
    ) -> Iterator[Result]:
        """The results in the order of the items."""
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
    """Processes for a problem; forked, so that compiled code is there already."""
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


@dataclass(frozen=True)
class Prospect:
    """A start and the squared residuals that the linearised model promises from there."""

    start: Start
    power: float


def _screen_sheet(problem: Problem, task: tuple[Model, tuple[Start, ...]]) -> list[Prospect]:
    """The linear test of neutral starts of different effects, all in one simulation."""
    model, starts = task
    sheet = model
    for start in starts:
        sheet = sheet.extended(start.effect, start.block, start.screened)
    try:
        at = evaluate(sheet, problem.recordings, problem.given)
        equations = total(at, problem.given)
    except SimulationError as err:
        LOG.info("%s: %s", ", ".join(s.effect for s in starts), err)
        return []
    own = list(range(len(model.free)))
    natural = sheet.natural()
    found, first = [], len(own)
    for start in starts:
        count = len(names(start.effect, start.block, start.screened))
        added = list(range(first, first + count))
        first += count
        pick = [*own, *added]
        part = Normal(
            equations.hessian[np.ix_(pick, pick)], equations.gradient[pick], equations.power
        )
        step, cost = part.minimum()
        amounts = np.clip(step[len(own) :], -LOOSE * natural[added], LOOSE * natural[added])
        found.append(Prospect(_shifted(start, amounts), cost * at.excess))
    return found


def _shifted(start: Start, amounts: FloatArray) -> Start:
    """The start at the promised minimum; a log ratio is neutral at 1."""
    if start.effect == "stiff_segment" or start.effect == "camera_scale":
        return replace(start, block={**start.block, "ratio": float(np.exp(amounts[0]))})
    if start.effect == "point_mass":
        amounts = np.maximum(amounts, 0.0)
    return moved(start, [float(a) for a in amounts])


def _screen_alone(problem: Problem, task: tuple[Model, tuple[Start, ...]]) -> list[Prospect]:
    """The linear test around a start that is not neutral."""
    model, (start,) = task
    extended = model.extended(start.effect, start.block, start.fitted)
    try:
        at = evaluate(extended, problem.recordings, problem.given)
    except SimulationError as err:
        LOG.info("%s: %s", start.effect, err)
        return []
    _, promised = total(at, problem.given).minimum()
    # Far from its start a linearisation promises what it cannot keep.
    return [Prospect(start, max(promised * at.excess, 0.05 * at.power))]


def _screen(problem: Problem, task: tuple[Model, tuple[Start, ...]]) -> list[Prospect]:
    neutral = task[1][0].neutral
    return (_screen_sheet if neutral else _screen_alone)(problem, task)


def screen(
    team: Workers, model: Model, starts: Sequence[Start], progress: Progress
) -> list[Prospect]:
    """The linear test of all starts; those that cannot be simulated are left out."""
    sheets: list[list[Start]] = []
    tasks: list[tuple[Model, tuple[Start, ...]]] = []
    for start in starts:
        if not start.neutral:
            tasks.append((model, (start,)))
            continue
        for sheet in sheets:
            if all(start.effect != other.effect for other in sheet):
                sheet.append(start)
                break
        else:
            sheets.append([start])
    tasks += [(model, tuple(sheet)) for sheet in sheets]
    tasks.reverse()  # the largest first
    found: list[Prospect] = []
    for k, prospects in enumerate(team.each(_screen, tasks)):
        found += prospects
        progress("testing effects", (k + 1) / len(tasks))
    return found


def _fit_start(problem: Problem, task: tuple[Model, Start]) -> Evaluation | None:
    model, start = task
    for share in (1.0, 0.4, 0.1):
        begin = start if share == 1.0 else _nearer(start, share)
        extended = model.extended(begin.effect, begin.block, begin.fitted)
        try:
            at = evaluate(extended, problem.recordings, problem.given)
            return fit(at, problem.recordings, problem.given, FIRST_ITERATIONS)
        except SimulationError:
            if not start.neutral:
                return None
    return None


def _nearer(start: Start, share: float) -> Start:
    block = dict(start.block)
    for key in start.screened:
        value = block[key]
        if key == "ratio":
            assert isinstance(value, float)
            block[key] = value**share
        elif isinstance(value, tuple):
            block[key] = tuple(share * v for v in value)
        else:
            block[key] = share * value
    return replace(start, block=block)


def _carry_on(problem: Problem, at: Evaluation) -> Evaluation:
    return fit(at, problem.recordings, problem.given, MORE_ITERATIONS)


def _chosen(prospects: Sequence[Prospect], before: float) -> list[Prospect]:
    """The best start of every form of every effect, and another place nearly as good."""
    groups: dict[tuple[str, str], list[Prospect]] = {}
    for p in sorted(prospects, key=lambda p: p.power):
        groups.setdefault((p.start.effect, p.start.form), []).append(p)
    result = []
    for group in groups.values():
        result.append(group[0])
        best = before - group[0].power
        result += [p for p in group[1:2] if before - p.power > OTHER_PLACE * best]
    return sorted(result, key=lambda p: p.power)


def search(
    team: Workers,
    before: Evaluation,
    starts: Sequence[Start],
    progress: Progress,
    most: int | None = None,
) -> list[Candidate]:
    """Fit effects in addition to a model; the best fit of each form of each effect, best first.

    Args:
        before: the fitted model without them.
        starts: from where.
        progress: called with what is being done and the share of it that is done.
        most: starts that are fitted, the most promising ones; default: all.
    """
    problem = team.problem
    prospects = _chosen(screen(team, before.model, starts, progress), before.power)[:most]
    tasks = [(before.model, p.start) for p in prospects]
    first: dict[tuple[str, str], Evaluation] = {}
    for k, (p, at) in enumerate(zip(prospects, team.each(_fit_start, tasks), strict=True)):
        progress("fitting effects", (k + 1) / len(tasks))
        key = (p.start.effect, p.start.form)
        if at is not None and (key not in first or at.cost < first[key].cost):
            first[key] = at
    order = sorted(first, key=lambda key: first[key].cost)
    if not order:
        return []
    noise = problem.count
    limit = noise + PROMISING * max(first[order[0]].power - noise, 0.1 * noise)
    carried = [key for k, key in enumerate(order) if first[key].power < limit or k < AT_LEAST]
    fits = dict(first)
    for k, (key, at) in enumerate(
        zip(carried, team.each(_carry_on, [first[key] for key in carried]), strict=True)
    ):
        progress("fitting the most likely effects", (k + 1) / len(carried))
        fits[key] = at
    found = [candidate(key[0], key[1], at, problem.given) for key, at in fits.items()]
    return sorted(found, key=lambda c: c.score)


def candidate(effect: str, form: str, at: Evaluation, given: Settings) -> Candidate:
    """Judge a fit."""
    score = judging.predictive_score(at, given)
    return Candidate(effect, form, at, score, judging.structure(at.residuals))
