"""Fits effects: every effect a little, the promising ones to the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dlo_ros.diagnosis import judging
from dlo_ros.diagnosis.candidates import Start
from dlo_ros.diagnosis.fitting import ROUGH, Evaluation, evaluate, fit
from dlo_ros.diagnosis.model import Model
from dlo_ros.diagnosis.screening import Prospect, chosen, tried
from dlo_ros.diagnosis.workers import Problem, Progress, Workers
from dlo_ros.errors import SimulationError
from dlo_ros.parameters import Settings

FIRST_ITERATIONS = 2
MORE_ITERATIONS = 8
PROMISING = 4.0
"""Excess over the noise, against the best candidate's, up to which a fit is carried on."""
CARRIED = 3
"""Fits that are carried on in any case."""
PLACES = 3
"""Among the effects, by what they promise, that make every form of a jumping one worth a fit."""
AS_PROMISING = 3.0
"""Squared residuals over the best trial's, up to which further forms of an effect are fitted."""


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


def _fit_draft(problem: Problem, task: tuple[Model, Prospect]) -> Evaluation | None:
    model, prospect = task
    try:
        at = evaluate(prospect.beginning(model), problem.drafts, problem.given)
    except SimulationError:
        return None
    return fit(at, problem.drafts, problem.given, FIRST_ITERATIONS)


def _carry_on(problem: Problem, model: Model) -> Evaluation | None:
    try:
        at = evaluate(model, problem.recordings, problem.given)
    except SimulationError:
        return None
    return fit(at, problem.recordings, problem.given, MORE_ITERATIONS)


def _worth(prospects: Sequence[Prospect]) -> tuple[list[Prospect], list[Prospect]]:
    """The best of every effect and whatever comes near the best of all; the rest.

    Of an effect that answers in jumps every form is worth a fit, where the effect is.
    """
    first: list[Prospect] = []
    rest: list[Prospect] = []
    known: dict[str, int] = {}
    forms: set[tuple[str, str]] = set()
    for p in prospects:
        effect, form = p.start.effect, (p.start.effect, p.start.form)
        known.setdefault(effect, len(known))
        worth = p.power < AS_PROMISING * prospects[0].power
        worth |= effect in ROUGH and known[effect] < PLACES and form not in forms
        if worth or not any(q.start.effect == effect for q in first):
            first.append(p)
            forms.add(form)
        else:
            rest.append(p)
    return first, rest


def search(
    team: Workers,
    before: Evaluation,
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
        progress: called with what is being done and the share of it that is done.
        enough: structure with which an effect explains the data.
        thorough: whether, where none does, less promising beginnings are fitted, too.
    """
    first, rest = _worth(tried(team, before, chosen(prospects, before.power), progress))
    found: dict[tuple[str, str], Candidate] = {}
    for some in (first, rest) if thorough else (first,):
        for c in _fitted(team, before, some, progress):
            key = (c.effect, c.form)
            if key not in found or c.at.cost < found[key].at.cost:
                found[key] = c
        if any(c.structure < enough for c in found.values()):
            break
    return sorted(found.values(), key=lambda c: c.score)


def _fitted(
    team: Workers, before: Evaluation, prospects: Sequence[Prospect], progress: Progress
) -> list[Candidate]:
    """Fit prospects a little, and the promising ones to the end with the fine simulation."""
    problem = team.problem
    tasks = [(before.model, p) for p in prospects]
    found: list[tuple[Start, Evaluation]] = []
    for k, (p, at) in enumerate(zip(prospects, team.each(_fit_draft, tasks), strict=True)):
        progress("fitting effects", (k + 1) / len(tasks))
        if at is not None:
            found.append((p.start, at))
    if not found:
        return []
    found.sort(key=lambda pair: pair[1].cost)
    noise = problem.count
    limit = noise + PROMISING * max(found[0][1].power - noise, 0.1 * noise)
    carried = [k for k, (_, at) in enumerate(found) if at.power < limit or k < CARRIED]
    models = [found[k][1].model for k in carried]
    for i, (k, at) in enumerate(zip(carried, team.each(_carry_on, models), strict=True)):
        progress("fitting the most likely effects", (i + 1) / len(carried))
        if at is not None:
            found[k] = (found[k][0], at)
    return [candidate(start.effect, start.form, at, problem.given) for start, at in found]


def candidate(effect: str, form: str, at: Evaluation, given: Settings) -> Candidate:
    """Judge a fit."""
    score = judging.predictive_score(at, given)
    return Candidate(effect, form, at, score, judging.structure(at.residuals))
