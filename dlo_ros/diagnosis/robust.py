# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fit to those pictures that a model can explain, where others are far off.

A DLO that hits something now and then is right before and wrong after. A fit to everything settles
between the two and is wrong throughout, so that nothing shows where it hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.candidates import Start, scene, starts
from dlo_ros.diagnosis.fitting import ROUGH, Evaluation, Normal, bounded, evaluate, known, normal
from dlo_ros.diagnosis.measured import Recording
from dlo_ros.diagnosis.workers import Problem
from dlo_ros.errors import SimulationError
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

TYPICAL = 3.0
"""Of the noise: pictures that are further off count ever less (Cauchy's law)."""
ITERATIONS = 8
TRIES = 4
SHORTER = 0.3
SETTLED = 0.01
DAMPING = 1e-4
MOVED = 0.01
"""Of a parameter, as the fit sees it, from which that fit tells something new."""


def robust(at: Evaluation, recordings: Sequence[Recording], given: Settings) -> Evaluation:
    """Fit a model to recordings so that a picture that is far off counts little.

    Args:
        at: where the fit begins; with derivatives, of the same recordings.
    """
    for _ in range(ITERATIONS):
        equations = _weighted(at, given)
        lhs = equations.hessian + DAMPING * np.diag(np.diag(equations.hessian))
        step = bounded(at.model, lhs, equations.gradient)
        before = _loss(at)
        for _ in range(TRIES):
            try:
                after = evaluate(at.model.at(at.model.theta() + step), recordings, given)
            except SimulationError:
                after = None
            if after is not None and _loss(after) < before:
                break
            step = SHORTER * step
        else:
            return at
        at = after
        if before - _loss(at) < SETTLED * before:
            break
    return at


def hits(
    problem: Problem, at: Evaluation, names: Sequence[str], present: Sequence[str]
) -> list[Start]:
    """Where a DLO may have hit something, as the pictures tell that are explained without it.

    Args:
        at: the fit to all pictures.
        names: everything that any command imposes.
        present: effects of the model.
    """
    drafts, given = problem.drafts, problem.given
    try:
        calm = robust(evaluate(at.model, drafts, given), drafts, given)
    except SimulationError:
        return []
    own = calm.model.theta() - at.model.theta()
    if np.abs(own).max() < MOVED:
        return []
    here = scene(calm.model.settings, names, [d.observed for d in drafts], calm.predicted)
    found = [s for s in starts(here, present) if s.effect in ROUGH]
    return [replace(s, own=tuple(own.tolist())) for s in found]


def _off(at: Evaluation) -> list[FloatArray]:
    """Mean square of each picture, over what is typical, shape (F,)."""
    return [np.mean(r**2, axis=1) / TYPICAL**2 for r in at.residuals]


def _loss(at: Evaluation) -> float:
    return float(sum(np.sum(np.log1p(o)) for o in _off(at)))


def _weighted(at: Evaluation, given: Settings) -> Normal:
    assert at.jacobians is not None
    result = known(at.model, given)
    for residual, jacobian, off in zip(at.residuals, at.jacobians, _off(at), strict=True):
        root = 1.0 / np.sqrt(1.0 + off)
        result = result + normal(residual * root[:, None], jacobian * root[:, None, None])
    return result
