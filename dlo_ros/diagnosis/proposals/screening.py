# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Screening of effects before a fit: a linear test, then one simulation of each that is left.

The linear test takes the sensitivities of a coarser simulation with the residuals of the fine one;
effects that are neutral at first share a simulation.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.fitting.candidate_model import LARGEST_LOG_STEP, LOOSE, Model, names
from dlo_ros.diagnosis.fitting.evaluation import (
    CandidateEvaluation,
    differenced,
    differs_in_batch,
    earlier,
    evaluate,
)
from dlo_ros.diagnosis.fitting.levenberg_marquardt import Normal, solve, total
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Progress, Workers
from dlo_ros.diagnosis.proposals.candidate_effects import moved, shrunk, within_range
from dlo_ros.effects import Start, effects
from dlo_ros.errors import SimulationError
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

SHARES = (1.0, 0.4, 0.1)
"""Shares of the step of the linear test that are tried."""
GOOD_STEP = 0.5
"""Share of the predicted gain from which a step is not shortened."""
OTHER_PLACE = 0.7
"""Share of the best gain from which a second start of the same effect is tried, too."""
DRAWS = 400
AT_LEAST = 0.05
"""Smallest share of the squared residuals that a start away from neutral is predicted to leave."""


@dataclass(frozen=True)
class Prospect:
    """A start, with the sum of squared residuals that the linear test predicts for it.

    Args:
        own: accompanying change of the other open parameters, in the units of the fit.
        gain: predicted fall of minus twice the log likelihood; NaN for a start that is not neutral.
        by_chance: predicted gains for residuals that nothing explains, shape (DRAWS,).
    """

    start: Start
    sum_of_squares: float
    own: FloatArray
    gain: float = np.nan
    by_chance: FloatArray | None = None

    def beginning(self, before: Model, share: float = 1.0) -> Model:
        """The model with the effect after a share of the predicted step."""
        start = _part(self.start, share)
        model = before.at(before.theta() + share * self.own)
        return model.extended(start.effect, start.block, start.fitted)


Task = tuple[CandidateEvaluation, tuple[Start, ...]]


def _screen_sheet(problem: Problem, task: Task) -> list[Prospect]:
    """The linear test of neutral starts of different effects, all in one simulation."""
    before, starts = task
    sheet = before.model
    for start in starts:
        sheet = sheet.extended(start.effect, start.block, start.screened)
    try:
        at = evaluate(sheet, problem.drafts, problem.given)
    except SimulationError as err:
        LOG.info("%s: %s", ", ".join(s.effect for s in starts), err)
        return []
    at = replace(at, residuals=before.residuals)
    equations = total(at, problem.given)
    own = list(range(len(before.model.free)))
    natural = sheet.natural()
    alone = Normal(
        equations.hessian[np.ix_(own, own)], equations.gradient[own], equations.sum_of_squares
    )
    _, without = alone.minimum()
    drawn = _drawn(at)
    own_by_chance = _gain(alone.hessian, drawn[:, own])
    found, first = [], len(own)
    for start in starts:
        count = len(names(start.effect, start.block, start.screened))
        added = list(range(first, first + count))
        first += count
        pick = [*own, *added]
        part = Normal(
            equations.hessian[np.ix_(pick, pick)],
            equations.gradient[pick],
            equations.sum_of_squares,
        )
        step, _ = part.minimum()
        amounts = np.clip(step[len(own) :], -LOOSE * natural[added], LOOSE * natural[added])
        amounts = within_range(start, amounts)
        step, cost = _with(part, amounts)
        change = np.clip(step[: len(own)], -LARGEST_LOG_STEP, LARGEST_LOG_STEP)
        by_chance = _gain(part.hessian, drawn[:, pick]) - own_by_chance
        found.append(
            Prospect(_shifted(start, amounts), cost * at.excess, change, without - cost, by_chance)
        )
    return found


def _drawn(at: CandidateEvaluation) -> FloatArray:
    """J^T r of residuals whose pictures have been given random signs, shape (DRAWS, P).

    An error that repeats from picture to picture is lost by that; the noise keeps its size and its
    correlation along the DLO.
    """
    assert at.jacobians is not None
    rng = np.random.default_rng(0)
    result = np.zeros((DRAWS, len(at.model.free)))
    for residual, jacobian in zip(at.residuals, at.jacobians, strict=True):
        each = np.einsum("fpk,fk->fp", jacobian, residual) / at.excess
        result += rng.choice([-1.0, 1.0], (DRAWS, len(each))) @ each
    return result


def _gain(hessian: FloatArray, gradients: FloatArray) -> FloatArray:
    """Fall of the linearised cost for many gradients (D, P)."""
    return np.asarray(np.einsum("dp,pd->d", gradients, solve(hessian, gradients.T)))


def alarm(prospects: Sequence[Prospect]) -> tuple[float, float]:
    """The largest predicted gain of all, and the one that chance exceeds in 1 of 100 cases."""
    linear = [p for p in prospects if p.by_chance is not None]
    if not linear:
        return np.inf, 0.0
    most = np.max([p.by_chance for p in linear if p.by_chance is not None], axis=0)
    return max(p.gain for p in linear), float(np.percentile(most, 99.0))


def _with(equations: Normal, amounts: FloatArray) -> tuple[FloatArray, float]:
    """The minimum and its cost with the last unknowns given."""
    count = len(equations.gradient) - len(amounts)
    inner, cross = equations.hessian[:count, :count], equations.hessian[:count, count:]
    step = np.append(solve(inner, equations.gradient[:count] - cross @ amounts), amounts)
    return step, equations.sum_of_squares + float(
        step @ (equations.hessian @ step - 2 * equations.gradient)
    )


def _shifted(start: Start, amounts: FloatArray) -> Start:
    """The start at the predicted minimum."""
    return moved(start, [float(a) for a in amounts])


def _screen_alone(problem: Problem, task: Task) -> list[Prospect]:
    """The linear test around a start that is not neutral."""
    before, (start,) = task
    count = len(before.model.free)
    own = np.array(start.own) if start.own else np.zeros(count)
    extended = before.model.at(before.model.theta() + own)
    extended = extended.extended(start.effect, start.block, start.fitted)
    # A heavy mass: the derivatives from before say nothing there.
    afar = differs_in_batch([start.effect])
    try:
        at = evaluate(extended, problem.drafts, problem.given, derivatives=afar)
        if not afar and effects()[start.effect].differentiable:
            at = differenced(before, at, problem.drafts, problem.given)
    except SimulationError as err:
        LOG.info("%s: %s", start.effect, err)
        return []
    predicted = AT_LEAST * at.sum_of_squares
    if at.jacobians is not None:
        # Far from its start a linearisation predicts too much.
        step, left = total(at, problem.given).minimum()
        predicted = max(predicted, left * at.excess)
        own = own + np.clip(step[:count], -LARGEST_LOG_STEP, LARGEST_LOG_STEP)
    return [Prospect(start, predicted, own)]


def _screen(problem: Problem, task: Task) -> list[Prospect]:
    neutral = task[1][0].neutral
    return (_screen_sheet if neutral else _screen_alone)(problem, task)


def screen(
    team: Workers, before: CandidateEvaluation, starts: Sequence[Start], progress: Progress
) -> list[Prospect]:
    """The linear test of all starts; those that cannot be simulated are left out."""
    problem = team.problem
    bare = earlier(before, problem.recordings, problem.drafts, problem.given)
    sheets: list[list[Start]] = []
    tasks: list[Task] = []
    for start in starts:
        if not start.neutral:
            tasks.append((bare, (start,)))
            continue
        for sheet in sheets:
            alike = differs_in_batch([start.effect]) == differs_in_batch([sheet[0].effect])
            if alike and all(start.effect != other.effect for other in sheet):
                sheet.append(start)
                break
        else:
            sheets.append([start])
    tasks += [(bare, tuple(sheet)) for sheet in sheets]
    tasks.reverse()  # the largest first
    found: list[Prospect] = []
    for k, prospects in enumerate(team.each(_screen, tasks)):
        found += prospects
        progress("testing effects", (k + 1) / len(tasks))
    return found


def chosen(prospects: Sequence[Prospect], before: float) -> list[Prospect]:
    """The best start of every form of every effect, and a second place that is nearly as good."""
    groups: dict[tuple[str, str], list[Prospect]] = {}
    for p in sorted(prospects, key=lambda p: p.sum_of_squares):
        groups.setdefault((p.start.effect, p.start.form), []).append(p)
    result = []
    for group in groups.values():
        result.append(group[0])
        best = before - group[0].sum_of_squares
        result += [p for p in group[1:2] if before - p.sum_of_squares > OTHER_PLACE * best]
    return sorted(result, key=lambda p: p.sum_of_squares)


def _try(problem: Problem, task: tuple[CandidateEvaluation, Prospect]) -> Prospect | None:
    before, prospect = task
    best: Prospect | None = None
    for share in SHARES if prospect.start.neutral else (1.0, 0.0):
        extended = prospect.beginning(before.model, share)
        try:
            at = evaluate(extended, problem.drafts, problem.given, derivatives=False)
        except SimulationError:
            continue
        if best is None or at.sum_of_squares < best.sum_of_squares:
            best = Prospect(_part(prospect.start, share), at.sum_of_squares, share * prospect.own)
        if before.sum_of_squares - at.sum_of_squares > GOOD_STEP * (
            before.sum_of_squares - prospect.sum_of_squares
        ):
            break
    return best


def tried(
    team: Workers, before: CandidateEvaluation, prospects: Sequence[Prospect], progress: Progress
) -> list[Prospect]:
    """One simulation of each prospect, best first; E and mu keep their values.

    Args:
        before: see `evaluation.earlier`.
    """
    before = replace(before, jacobians=None)  # workers need not have them
    tasks = [(before, p) for p in prospects]
    found = []
    for k, prospect in enumerate(team.each(_try, tasks)):
        progress("trying effects", (k + 1) / len(tasks))
        if prospect is not None:
            found.append(prospect)
    return sorted(found, key=lambda p: p.sum_of_squares)


def _part(start: Start, share: float) -> Start:
    """The start after a share of the step of the linear test; others stay as they are."""
    if share == 1.0 or not start.neutral:
        return start
    return shrunk(start, share)
