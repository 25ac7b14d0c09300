# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fit to those pictures that a model can explain, where others are far off.

A DLO that hits something now and then is right before and wrong after. A fit to everything settles
between the two and is wrong throughout, so that nothing shows where it hit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, carried_on, evaluate
from dlo_ros.diagnosis.fitting.levenberg_marquardt import (
    Normal,
    bounded,
    fit,
    known,
    normal,
    renewed,
)
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Workers
from dlo_ros.errors import SimulationError
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

TYPICAL = 3.0
"""Deviation in units of the noise, from which pictures count ever less (Cauchy's law)."""
UNDISTURBED = 0.1
"""Share of the pictures that must be right, for the others to count as disturbed."""
QUIET, LOUDER = 0.3, 1.5
"""Where fewer are: share of the pictures that are taken for undisturbed, and what is typical over
what is off in these."""
ITERATIONS = 8
TRIES = 4
SHORTER = 0.3
SETTLED = 0.01
MARQUARDT_DAMPING = 1e-4
FIRST_PARTS = (1.0, 0.12, 0.25, 0.5)
"""Shares of each recording, from its beginning, that are fitted first: before anything was hit."""
LEAST_FRAMES = 5
PART_ITERATIONS = 6


def robust(
    at: CandidateEvaluation, recordings: Sequence[Recording], given: Settings,
    typical: float = TYPICAL, *, strict: bool = False,
) -> CandidateEvaluation:  # fmt: skip
    """Fit a model to recordings so that a picture that is far off counts little.

    Args:
        at: where the fit begins; with derivatives, of the same recordings.
        typical: of pictures that are right, in units of the noise.
        strict: whether those far off count for nothing (Geman and McClure's law instead of
            Cauchy's): right near a fit that is right, lost elsewhere.
    """
    for left in reversed(range(ITERATIONS)):
        before = loss(at, typical, strict=strict)
        after = _improved(at, recordings, given, typical, strict=strict)
        done = after is None or before - loss(after, typical, strict=strict) < SETTLED * before
        believed = not at.carried
        at = after or at
        if done:
            if believed or not left:
                return at
            at = renewed(at, recordings, given)
    return at


def _improved(
    at: CandidateEvaluation, recordings: Sequence[Recording], given: Settings, typical: float, *,
    strict: bool,
) -> CandidateEvaluation | None:  # fmt: skip
    """One iteration; None where no step makes it better."""
    equations = _weighted(at, given, typical, strict)
    lhs = equations.hessian + MARQUARDT_DAMPING * np.diag(np.diag(equations.hessian))
    step = bounded(at.model, lhs, equations.gradient)
    before = loss(at, typical, strict=strict)
    for _ in range(TRIES):
        model = at.model.at(at.model.theta() + step)
        try:
            after = evaluate(model, recordings, given, derivatives=not at.expensive_jacobian)
        except SimulationError:
            after = None
        if after is not None and loss(after, typical, strict=strict) < before:
            return carried_on(at, after) if at.expensive_jacobian else after
        step = SHORTER * step
    return None


def calm(team: Workers, at: CandidateEvaluation) -> tuple[CandidateEvaluation, float] | None:
    """The fit that explains most pictures, from several beginnings, and what is typical of these.

    Args:
        at: the fit to all pictures.

    Returns:
        The fit to the drafts, with `typical` as in `robust`; None where none can be simulated.
    """
    typical, best = TYPICAL, at
    for _ in range(2):
        tasks = [(at, share, typical) for share in FIRST_PARTS]
        found = [c for c in team.each(_calm_from, tasks) if c is not None]
        if not found:
            return None
        best = min(found, key=lambda c: loss(c, typical, strict=True))
        each = np.concatenate(off(best, 1.0))
        if np.mean(each < typical**2) > UNDISTURBED:
            break
        # Something else is wrong all the time.
        typical = max(TYPICAL, LOUDER * float(np.sqrt(np.quantile(each, QUIET))))
    return best, typical


def _calm_from(
    problem: Problem, task: tuple[CandidateEvaluation, float, float]
) -> CandidateEvaluation | None:
    """A robust fit that begins with the fit to the first part of each recording."""
    at, share, typical = task
    drafts, given, model = problem.drafts, problem.given, at.model
    try:
        if share < 1.0:
            part = [d.until(max(LEAST_FRAMES, int(share * len(d.times)))) for d in drafts]
            model = fit(evaluate(model, part, given), part, given, PART_ITERATIONS).model
        here = evaluate(model, drafts, given)
        if share == 1.0:
            here = robust(here, drafts, given, typical)
        return robust(here, drafts, given, typical, strict=True)
    except SimulationError:
        return None


def off(at: CandidateEvaluation, typical: float = TYPICAL) -> list[FloatArray]:
    """Mean square of each picture's residual, over what is typical, shape (F,) per recording."""
    return [np.mean(r**2, axis=1) / typical**2 for r in at.residuals]


def astray(at: CandidateEvaluation, typical: float) -> list[np.ndarray]:
    """Which pictures deviate by more than is typical, shape (F,) per recording."""
    return [o > 1.0 for o in off(at, typical)]


def loss(at: CandidateEvaluation, typical: float = TYPICAL, *, strict: bool = False) -> float:
    """What `robust` makes small; with `strict` nearly the number of pictures that are off."""
    each = np.concatenate(off(at, typical))
    return float(np.sum(each / (1.0 + each) if strict else np.log1p(each)))


def _weighted(at: CandidateEvaluation, given: Settings, typical: float, strict: bool) -> Normal:
    assert at.jacobians is not None
    result = known(at.model, given)
    for residual, jacobian, o in zip(at.residuals, at.jacobians, off(at, typical), strict=True):
        root = 1.0 / (1.0 + o) if strict else 1.0 / np.sqrt(1.0 + o)
        result = result + normal(residual * root[:, None], jacobian * root[:, None, None])
    return result
