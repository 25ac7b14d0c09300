# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The search among effects: a coarse fit of every effect, a full fit of the promising ones."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.contact import peg_places
from dlo_ros.diagnosis.contact.contact_search import peg_of
from dlo_ros.diagnosis.fitting.candidate_model import Model
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, earlier
from dlo_ros.diagnosis.fitting.levenberg_marquardt import CONTINUED, attempt, fit, renewed
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Progress, Workers
from dlo_ros.diagnosis.proposals.screening import Prospect, chosen, tried
from dlo_ros.diagnosis.residuals import residual_autocovariance
from dlo_ros.effects import Start, effects
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

FIRST_ITERATIONS = 1
ROUND_ITERATIONS = 3
ROUNDS = 3
MORE_ITERATIONS = 8
PROMISING = 4.0
"""Excess over the noise, against the best candidate's, up to which a fit is continued."""
FALLING = 0.5
"""Excess of a fit over that one round before, below which it is continued in any case."""
SETTLED = 0.95
"""Excess of a fit over that one round before, from which the fit has converged."""
COARSE_ENOUGH = 10.0
"""Root autocovariance over that of an explanation, from which the coarse simulation is enough."""
CARRIED = 3
"""Fits that are continued in any case, where none explains the data."""
LIKELY = 2.0
MOST_LIKELY = 4
"""Excess against the best candidate's, and number of fits, up to which they are carried to the end
where none explains the data."""
SECONDS = 6
"""Effects that are fitted beside another one, ranked by the residual of one simulation of each; the
right one has been among the first four."""
PLACES = 3
"""Rank of an effect without derivatives, by its promise, up to which every form of it is fitted."""
AS_PROMISING = 3.0
"""Squared residuals over the best trial's, up to which further forms of an effect are fitted."""


@dataclass(frozen=True)
class Candidate:
    """A fitted extension of the plain model.

    Args:
        effect: name of the effect that was added last.
        form: see `Start`.
        at: the fit, with derivatives.
        score: see `residual_autocovariance.predictive_score`; lower is better.
        root_autocovariance: root autocovariance of the residuals from frame to frame, in units of
            the noise.
    """

    effect: str
    form: str
    at: CandidateEvaluation
    score: float
    root_autocovariance: float


def _fit_draft(problem: Problem, task: tuple[Model, Prospect]) -> CandidateEvaluation | None:
    model, prospect = task
    return attempt(prospect.beginning(model), problem.drafts, problem.given, FIRST_ITERATIONS)


def _continue(problem: Problem, at: CandidateEvaluation) -> CandidateEvaluation:
    return fit(at, problem.drafts, problem.given, ROUND_ITERATIONS, damping=CONTINUED)


def _carry_on(problem: Problem, task: tuple[Model, bool]) -> CandidateEvaluation | None:
    model, coarse = task
    recordings = _whole(problem) if coarse else problem.recordings
    at = attempt(model, recordings, problem.given, MORE_ITERATIONS, damping=CONTINUED)
    return at and renewed(at, recordings, problem.given)


def _whole(problem: Problem) -> list[Recording]:
    """The recordings in full length with the coarse simulation."""
    return [
        replace(r, spans=d.spans, tolerance=d.tolerance)
        for r, d in zip(problem.recordings, problem.drafts, strict=True)
    ]


def _complete(problem: Problem, model: Model) -> CandidateEvaluation | None:
    return attempt(model, _whole(problem), problem.given, 0)


def differentiable(effect: str) -> bool:
    """Whether a motion is differentiable once an effect acts."""
    return effects()[effect].differentiable


def _worth(prospects: Sequence[Prospect]) -> tuple[list[Prospect], list[Prospect]]:
    """The prospects that are worth a fit, and the rest.

    These are the best one of every effect and all that come near the best of all; of a nonsmooth
    effect that ranks high, every form.
    """
    first: list[Prospect] = []
    rest: list[Prospect] = []
    known: dict[str, int] = {}
    forms: set[tuple[str, str]] = set()
    for p in prospects:
        effect, form = p.start.effect, (p.start.effect, p.start.form)
        known.setdefault(effect, len(known))
        worth = p.sum_of_squares < AS_PROMISING * prospects[0].sum_of_squares
        worth |= not differentiable(effect) and known[effect] < PLACES and form not in forms
        if worth or not any(q.start.effect == effect for q in first):
            first.append(p)
            forms.add(form)
        else:
            rest.append(p)
    return first, rest


def search(
    team: Workers,
    before: CandidateEvaluation,
    prospects: Sequence[Prospect],
    progress: Progress,
    enough: float,
    *,
    thorough: bool = True,
) -> list[Candidate]:
    """Fit effects in addition to a model; the best fit of each form of each effect, best first.

    Args:
        before: the fitted model without them.
        prospects: see `screening.screen`.
        progress: function that is called with the name of the present step and the fraction of it
            that is done.
        enough: root autocovariance of the residuals with which an effect explains the data.
        thorough: whether, where none explains the data, these are fitted, too: less promising
            starting values, unlikely effects, and pegs that increase the residual where tried.
    """
    problem = team.problem
    short = earlier(before, problem.recordings, problem.drafts, problem.given)
    first, rest = _worth(tried(team, short, chosen(prospects, short.sum_of_squares), progress))
    smooth = [p for p in first if differentiable(p.start.effect)]
    nonsmooth = [p for p in first if not differentiable(p.start.effect)]
    if not thorough:
        nonsmooth = [p for p in nonsmooth if p.sum_of_squares < short.sum_of_squares]
        likely = list(dict.fromkeys(p.start.effect for p in smooth))[:SECONDS]
        smooth = [p for p in smooth if p.start.effect in likely]
    # In motion no other effect explains the data as well as a peg; its derivatives take long.
    moving = sum(len(r.times) for r in problem.recordings) >= residual_autocovariance.FEW
    groups = [smooth, nonsmooth] if moving else [first]
    found: dict[tuple[str, str], Candidate] = {}
    least = np.inf
    for some in (*groups, rest) if thorough else groups:
        fitted, least = _fitted(team, before.model, some, progress, enough, least)
        for c in fitted:
            known = ", ".join(before.model.effects) or "nothing"
            LOG.info(
                "%s %s beside %s: score %.1f, root autocovariance %.2f of the noise",
                c.effect, c.form, known, c.score, c.root_autocovariance,
            )  # fmt: skip
            key = (c.effect, c.form)
            if key not in found or c.at.cost < found[key].at.cost:
                found[key] = c
        if any(c.root_autocovariance < enough for c in found.values()):
            break
    return sorted(found.values(), key=lambda c: c.score)


@dataclass(frozen=True)
class _Draft:
    """A fit with the coarse simulation, and its excess one round before."""

    start: Start
    at: CandidateEvaluation
    before: float

    def excess(self, noise: float) -> float:
        """Sum of squared residuals beyond that of the noise; at least a tenth of the latter."""
        return max(self.at.sum_of_squares - noise, 0.1 * noise)


def _fitted(
    team: Workers, before: Model, prospects: Sequence[Prospect], progress: Progress,
    enough: float, least: float,
) -> tuple[list[Candidate], float]:  # fmt: skip
    """Fit prospects coarsely, and the promising ones to convergence with the fine simulation.

    Args:
        least: smallest excess of what was fitted before.

    Returns:
        The fits and the smallest excess now.
    """
    problem = team.problem
    noise = problem.count
    tasks = [(before, p) for p in prospects]
    drafts: list[_Draft] = []
    for k, (p, at) in enumerate(zip(prospects, team.each(_fit_draft, tasks), strict=True)):
        progress("fitting effects", (k + 1) / len(tasks))
        if at is not None:
            drafts.append(_Draft(p.start, at, p.sum_of_squares - noise))
    for _ in range(ROUNDS):
        pick = [
            k for k in _promising(drafts, noise, enough, least)
            if drafts[k].excess(noise) < SETTLED * drafts[k].before
        ]  # fmt: skip
        ats = [drafts[k].at for k in pick]
        for i, (k, at) in enumerate(zip(pick, team.each(_continue, ats), strict=True)):
            progress("fitting the likely effects", (i + 1) / len(pick))
            drafts[k] = replace(drafts[k], at=at, before=drafts[k].excess(noise))
    found: list[CandidateEvaluation | None] = [d.at for d in drafts]
    carried = _likely(drafts, noise, enough, least)
    coarse = (
        bool(carried)
        and residual_autocovariance.root_autocovariance(drafts[carried[0]].at.residuals)
        > COARSE_ENOUGH * enough
    )
    if coarse:
        names = [drafts[k].start.effect for k in carried]
        carried = [
            k for i, k in enumerate(carried)
            if not differentiable(names[i]) or names[i] not in names[:i]
        ]  # fmt: skip
    further = [(drafts[k].at.model, coarse) for k in carried]
    for i, (k, at) in enumerate(zip(carried, team.each(_carry_on, further), strict=True)):
        progress("fitting the most likely effects", (i + 1) / len(carried))
        found[k] = at or found[k]
    if problem.shortened:
        left = [k for k in range(len(drafts)) if k not in carried]
        models = [drafts[k].at.model for k in left]
        for k, at in zip(left, team.each(_complete, models), strict=True):
            found[k] = at
    candidates = [
        candidate(d.start.effect, d.start.form, at, problem.given)
        for d, at in zip(drafts, found, strict=True) if at is not None
    ]  # fmt: skip
    pegs_found = [c for c in candidates if c.effect == Obstacle.name]
    first = drafts[carried[0]] if carried else None
    if first and first.start.effect == Obstacle.name and first.excess(noise) < LIKELY * least:
        best = min(pegs_found, key=lambda c: c.at.cost)
        # Also where it explains the data: others that do as well tell how little is known of it.
        candidates += resized(team, best, coarse=coarse)
    return candidates, min([least, *(d.excess(noise) for d in drafts)])


def resized(team: Workers, c: Candidate, *, coarse: bool) -> list[Candidate]:
    """A candidate with a peg, fitted anew from other radii; each radius is a form of its own."""
    problem, model = team.problem, c.at.model
    effect = Obstacle.name
    observed = [r.observed for r in problem.recordings]
    others = peg_places.resized(peg_of(model.settings), problem.given.rod, observed)
    bare = model.without(effect)
    models = [bare.extended(effect, o._asdict(), o._fields) for o in others]
    fits = team.each(_carry_on, [(m, coarse) for m in models])
    return [
        candidate(c.effect, f"radius {o.radius:.3g}", at, problem.given)
        for o, at in zip(others, fits, strict=True) if at is not None
    ]  # fmt: skip


def _promising(drafts: Sequence[_Draft], noise: float, enough: float, least: float) -> list[int]:
    """The drafts that are worth a longer fit, best first."""
    order = sorted(range(len(drafts)), key=lambda k: drafts[k].at.cost)
    if not order:
        return []
    best = min([least, *(d.excess(noise) for d in drafts)])
    some = (
        0
        if residual_autocovariance.root_autocovariance(drafts[order[0]].at.residuals) < enough
        else CARRIED
    )
    if best == least:
        some = 0
    return [
        k for i, k in enumerate(order)
        if drafts[k].excess(noise) < PROMISING * best
        or drafts[k].excess(noise) < FALLING * drafts[k].before
        or i < some
    ]  # fmt: skip


def _likely(drafts: Sequence[_Draft], noise: float, enough: float, least: float) -> list[int]:
    """The drafts that are worth a fit with the fine simulation, the best of each effect first."""
    order = _promising(drafts, noise, enough, least)
    if (
        not order
        or residual_autocovariance.root_autocovariance(drafts[order[0]].at.residuals) < enough
    ):
        return order
    best = min([least, *(d.excess(noise) for d in drafts)])
    near = [k for k in order if drafts[k].excess(noise) < LIKELY * best] or order[:1]
    names = [drafts[k].start.effect for k in near]
    repeated = [name in names[:i] for i, name in enumerate(names)]
    return [k for _, k in sorted(zip(repeated, near, strict=True), key=lambda p: p[0])][
        :MOST_LIKELY
    ]


def candidate(effect: str, form: str, at: CandidateEvaluation, given: Settings) -> Candidate:
    """The candidate of a fit, with its score."""
    score = residual_autocovariance.predictive_score(at, given)
    return Candidate(
        effect, form, at, score, residual_autocovariance.root_autocovariance(at.residuals)
    )
