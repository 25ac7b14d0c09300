# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The joint model as those pictures tell of it in which the DLO has not hit anything yet.

Beside a set-up that is off, the plain model is wrong in every picture: what a hit does shows only
in what the set-up leaves, and a fit of the set-up to all pictures takes some of the hit for its
own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.fitting import robust_fit
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, evaluate
from dlo_ros.diagnosis.fitting.worker_processes import Workers
from dlo_ros.effects import Scene
from dlo_ros.errors import SimulationError
from dlo_ros.inference import joint
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import joint_model

LEADS = (0.0, 0.25)
"""Shares of each recording, from its beginning, that count as right at first: a DLO that is wrong
from the first picture on may lie on a peg, or be gripped as in no other recording."""
FEWEST = 8
"""Pictures of a recording, from which its beginning counts."""
RIGHT = 0.9
"""Share of the fitted pictures that are right for certain."""
STANDS_OUT = 3.0
"""Deviation of the worst picture over that of the right ones, from which something was hit."""


@dataclass(frozen=True)
class Undisturbed:
    """A fit to undisturbed pictures.

    Args:
        model: the fitted joint model.
        at: its values, held against all drafts, without derivatives.
        typical: deviation that tells right from disturbed pictures, in units of the noise.
    """

    model: ParametricModel
    at: CandidateEvaluation
    typical: float


def undisturbed(team: Workers, at: CandidateEvaluation, scene: Scene) -> Undisturbed | None:
    """Fit the joint model to the beginnings of recordings, up to where they go astray.

    Args:
        at: the plain model, fitted to all pictures.
        scene: what the recordings look like.

    Returns:
        None where nothing goes astray, or all does.
    """
    found = robust_fit.calm(team, at)
    if found is None:
        return None
    calm, typical = found
    model = joint_model(calm.model.settings, team.problem.given, scene)
    wrong = robust_fit.astray(calm, typical)
    fits = [_fitted(team, at, model, wrong, lead) for lead in LEADS]
    begun = [f for f in fits if f is not None]
    if not begun:
        return None
    best = min(begun, key=lambda f: robust_fit.loss(f.at))
    return _fitted(team, at, best.model, robust_fit.astray(best.at, best.typical), 0.0)


def _fitted(
    team: Workers,
    at: CandidateEvaluation,
    model: ParametricModel,
    wrong: Sequence[np.ndarray],
    lead: float,
) -> Undisturbed | None:
    """The joint model fitted to the beginnings of recordings.

    Args:
        at: the plain model.
        model: where the fit begins.
        wrong: pictures that are off, shape (F,) for each recording.
        lead: see `LEADS`.

    Returns:
        None where no picture stands out of what is fitted.
    """
    drafts, given = team.problem.drafts, team.problem.given
    parts = _beginnings(drafts, wrong, lead)
    if not parts:
        return None
    try:
        model = joint.settled(joint.evaluate(model, parts), parts).model
        plain = replace(at.model, settings=model.settings)
        right = evaluate(plain, parts, given, derivatives=False)
        calm = evaluate(plain, drafts, given, derivatives=False)
    except SimulationError:
        return None
    most = float(np.quantile(np.concatenate(robust_fit.off(right, 1.0)), RIGHT))
    worst = float(np.concatenate(robust_fit.off(calm, 1.0)).max())
    if worst < STANDS_OUT**2 * most:
        return None
    return Undisturbed(model, calm, float((most * worst) ** 0.25))


def _beginnings(
    drafts: Sequence[Recording], wrong: Sequence[np.ndarray], lead: float
) -> list[Recording]:
    """The recordings up to the first picture that is off, and at least a share of each."""
    result = []
    for draft, w in zip(drafts, wrong, strict=True):
        first = int(np.argmax(w)) if w.any() else len(w)
        stop = len(draft.times) - len(w) + max(first, round(lead * len(w)))
        if stop >= FEWEST:
            result.append(draft.until(stop))
    return result
