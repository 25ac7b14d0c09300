# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Selection between the damping that the parameter file only guesses and a fitted one.

The damping is fitted together with everything else, so that a wrong guess hides no cause and feigns
none. It is named as `air_drag` or `internal_damping` where nothing else was missing, or where
everything is much worse with the guess.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.findings.fitted_numbers import covariance
from dlo_ros.diagnosis.findings.joint_numbers import damping_as_effects
from dlo_ros.diagnosis.fitting.candidate_model import Model
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation
from dlo_ros.diagnosis.fitting.levenberg_marquardt import attempt, fit, renewed, solve, total
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Workers
from dlo_ros.diagnosis.selection import verdict as verdicts
from dlo_ros.diagnosis.selection.effect_search import Candidate, candidate
from dlo_ros.effects import added_to_damping, damping_effect
from dlo_ros.parameters import Settings

ITERATIONS = 10
ENOUGH = 1.1
"""Largest root autocovariance of one damping's residuals over that of both, with which it is
named alone where neither explains the data."""


@dataclass(frozen=True)
class Guess:
    """A guessed damping that the data contradict.

    Args:
        effect: name of the effect that would correct it.
        given, fitted: value in the file and in the fit, in the file's unit.
        std: standard deviation of the guess's logarithm.
    """

    effect: str
    given: float
    fitted: float
    std: float


def guessed(model: Model, given: Settings) -> tuple[str, ...]:
    """Names of the effects that stand for the fitted damping."""
    return tuple(
        effect for effect, (name, _) in added_to_damping().items()
        if name in model.free and effect not in model.effects
        and getattr(given.damping, f"{name}_std") == 0.0
    )  # fmt: skip


def wrong_guesses(at: CandidateEvaluation, given: Settings) -> tuple[Guess, ...]:
    """Fitted dampings that clearly differ from the file's guess."""
    spread = np.sqrt(np.maximum(np.diag(covariance(at, given)), 0.0))
    found = []
    for effect, (name, _) in added_to_damping().items():
        if effect not in guessed(at.model, given):
            continue
        value, fitted = (getattr(s.damping, name) for s in (given, at.model.settings))
        std = float(spread[at.model.free.index(name)])
        if abs(np.log(fitted / value)) > verdicts.SIGNIFICANT_STDS * std:
            found.append(Guess(effect, value, fitted, std))
    return tuple(found)


def with_guess(
    at: CandidateEvaluation, given: Settings, effects: Sequence[str] = ()
) -> list[Model]:
    """Starts of a fit: the model with the file's damping, and effects that correct it.

    In one of them the other parameters have followed: only ratios of weight, stiffness and damping
    may count.
    """
    model = at.model
    names = [added_to_damping()[e][0] for e in guessed(model, given)]
    back = {n: getattr(given.damping, n) for n in names if damping_effect(n) not in effects}
    move = [model.free.index(n) for n in back]
    follow = [k for k in range(len(model.free)) if k not in move]
    theta = model.theta()
    change = np.log([back[n] for n in back]) - theta[move]
    equations = total(at, given)
    inner, cross = equations.hessian[np.ix_(follow, follow)], equations.hessian[follow][:, move]
    followed = theta.copy()
    followed[follow] -= solve(inner, cross @ change)
    return [_with_guess(model.at(t), given, names, effects) for t in (theta, followed)]


def _with_guess(
    model: Model, given: Settings, names: Sequence[str], effects: Sequence[str]
) -> Model:
    """The model with the file's damping, and what was fitted beyond it as effects."""
    told = damping_as_effects(model.settings, given, effects)
    kept = {n: getattr(given.damping, n) for n in names}
    settings = replace(model.settings, damping=replace(told.damping, **kept))
    result = replace(model, settings=settings, free=tuple(n for n in model.free if n not in names))
    for effect in effects:
        block = told.effects[effect]
        result = result.extended(effect, block, tuple(block))
    return result


def _fitted(problem: Problem, beginnings: Sequence[Model]) -> CandidateEvaluation | None:
    """The fit from the best of some beginnings."""
    begun = [attempt(m, problem.recordings, problem.given, 0) for m in beginnings]
    best = min((at for at in begun if at is not None), key=lambda at: at.cost, default=None)
    if best is None:
        return None
    at = fit(best, problem.recordings, problem.given, ITERATIONS)
    return renewed(at, problem.recordings, problem.given)


def _candidates(team: Workers, models: Sequence[Sequence[Model]]) -> list[Candidate]:
    given = team.problem.given
    return [
        candidate(at.model.effects[-1] if at.model.effects else "", "", at, given)
        for at in team.each(_fitted, models) if at is not None
    ]  # fmt: skip


@dataclass(frozen=True)
class Damping:
    """The decision on a wrong guess of the damping.

    Args:
        plain: the plain model with the file's damping.
        decision: decision on the named effects, damping included.
        candidates: all that were fitted.
    """

    plain: Candidate
    decision: verdicts.Decision
    candidates: tuple[Candidate, ...]


def named(
    team: Workers, plain: Candidate, best: Candidate, decision: verdicts.Decision,
    holdout_err: Callable[[Candidate], float | None],
) -> Damping | None:  # fmt: skip
    """Name the damping where nothing else was missing, or where it is certain.

    Args:
        plain: the fitted model without effects.
        best: the fitted model that comes nearest to the data.
        decision: decision on the other effects; the damping does not belong to an explanation by
            other causes.
        holdout_err: ERR of a candidate there [m].
    """
    given = team.problem.given
    if decision.verdict == "explained" or not wrong_guesses(best.at, given):
        return None
    guess = _candidates(team, [with_guess(best.at, given)])
    if not guess or not _matters(guess[0], best, decision.verdict, holdout_err):
        return None
    chosen = decision.chosen.candidate if decision.chosen else plain
    names = guessed(plain.at.model, given)
    sets = [names] if len(names) == 1 else [*((n,) for n in names), names]
    models = [with_guess(chosen.at, given, s) for s in sets]
    first, *found = _candidates(team, [with_guess(plain.at, given), *models])
    if first.at.model.effects != plain.at.model.effects or not found:
        return None
    told = decided(found, chosen, decision)
    if decision.verdict == "unexplained" and not _holds(told, first, holdout_err):
        return None
    return Damping(first, told, tuple(found))


def _holds(
    told: verdicts.Decision, plain: Candidate, holdout_err: Callable[[Candidate], float | None]
) -> bool:
    """Whether a damping, named alone beside other model errors, improves the prediction."""
    assert told.chosen is not None
    err, before = holdout_err(told.chosen.candidate), holdout_err(plain)
    return err is not None and (before is None or err < before)


def _matters(
    guess: Candidate, best: Candidate, verdict: verdicts.Verdict,
    holdout_err: Callable[[Candidate], float | None],
) -> bool:  # fmt: skip
    """Whether the guess leaves correlated residuals, or, beside other model errors, far more."""
    if verdict == "adequate":
        if verdicts.adequate(guess.at.residuals):
            return False
        return best.root_autocovariance <= verdicts.limit(guess.root_autocovariance)
    if best.root_autocovariance > verdicts.SURE_SHARE * guess.root_autocovariance:
        return False
    err, other = holdout_err(best), holdout_err(guess)
    return err is not None and other is not None and err < verdicts.SURE_SHARE * other


def decided(
    found: Sequence[Candidate], chosen: Candidate, before: verdicts.Decision
) -> verdicts.Decision:
    """One of two decisions, with the other as its rival where both name a cause."""
    known = chosen.at.model.effects
    # The noise alone understates the uncertainty of a difference beside an unexplained residual.
    unsure = before.verdict == "unexplained"

    def near(c: Candidate, other: Candidate, ratio: float) -> bool:
        return verdicts.as_good(other, c) or (
            unsure and c.root_autocovariance < ratio * other.root_autocovariance
        )

    found = sorted(found, key=lambda c: c.root_autocovariance if unsure else c.score)
    least = min(len(c.at.model.effects) for c in found)
    both = [c for c in found if len(c.at.model.effects) > least]
    alone = [c for c in found if c not in both]
    enough = [c for c in alone if not both or near(c, both[0], ENOUGH)]
    best = (enough or both)[0]
    rivals = [
        n for c in (alone if enough else ()) if near(c, best, verdicts.ALIKE)
        for n in c.at.model.effects if n not in best.at.model.effects
    ]  # fmt: skip
    earlier = dict(zip(before.chosen.effects, before.rivals, strict=True)) if before.chosen else {}
    # What was fitted beside something certain, without being so itself, is not named.
    names = tuple(n for n in best.at.model.effects if n in earlier or n not in known)
    return verdicts.Decision(
        "explained" if before.verdict == "adequate" else before.verdict,
        verdicts.SufficientEffects(names, best),
        tuple(earlier.get(n, tuple(rivals)) for n in names),
    )
