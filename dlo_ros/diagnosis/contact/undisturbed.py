# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The joint model fitted to those pictures in which the DLO has not hit anything yet.

Beside a set-up that is off, the plain model is wrong in every picture: the effect of a contact
shows only in the residual of the set-up's fit, and a fit of the set-up to all pictures explains
part of the contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.fitting import robust_fit
from dlo_ros.diagnosis.fitting.plain_evaluation import PlainEvaluation, evaluate
from dlo_ros.effects import Scene
from dlo_ros.errors import SimulationError
from dlo_ros.inference import joint, joint_fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import joint_model
from dlo_ros.parameters import Settings

LEADS = (0.0, 0.25)
"""Shares of each recording, from its beginning, that count as undisturbed at first: a DLO that is
wrong from the first picture on may lie on a peg, or be gripped as in no other recording."""
FEWEST = 8
"""Smallest number of pictures of a beginning that is fitted."""
RIGHT = 0.9
"""Share of the fitted pictures that are certainly undisturbed."""
STANDS_OUT = 3.0
"""Smallest ratio of the worst picture's deviation to the undisturbed ones' that means a contact."""


@dataclass(frozen=True)
class Undisturbed:
    """A fit to undisturbed pictures.

    Args:
        model: the fitted joint model.
        at: evaluation of its values on all drafts, without derivatives.
        scale: deviation that separates undisturbed from disturbed pictures, in units of the noise.
    """

    model: ParametricModel
    at: PlainEvaluation
    scale: float


def undisturbed(
    drafts: Sequence[Recording], given: Settings, at: PlainEvaluation, scene: Scene
) -> Undisturbed | None:
    """Fit the joint model to the beginnings of recordings, before the first outlier frame.

    Args:
        drafts: the recordings with a coarse simulation.
        given: the parameter file.
        at: the plain model, fitted to all pictures.
        scene: size, clamps and reach of the motion in the recordings.

    Returns:
        None where no frame is an outlier, or every one is.
    """
    found = robust_fit.consensus_fit(drafts, given, at)
    if found is None:
        return None
    consensus, scale = found
    model = joint_model(consensus.model.settings, given, scene)
    wrong = robust_fit.outlier_frames(consensus, scale)
    fits = [_fitted(drafts, given, at, model, wrong, lead) for lead in LEADS]
    begun = [f for f in fits if f is not None]
    if not begun:
        return None
    best = min(begun, key=lambda f: robust_fit.loss(f.at))
    return _fitted(
        drafts, given, at, best.model, robust_fit.outlier_frames(best.at, best.scale), 0.0
    )


def _fitted(
    drafts: Sequence[Recording],
    given: Settings,
    at: PlainEvaluation,
    model: ParametricModel,
    wrong: Sequence[np.ndarray],
    lead: float,
) -> Undisturbed | None:
    """The joint model fitted to the beginnings of recordings.

    Args:
        at: evaluation of the plain model.
        model: joint model with which the fit begins.
        wrong: outlier frames, shape (F,) for each recording.
        lead: see `LEADS`.

    Returns:
        None where no picture deviates clearly more than those that are fitted.
    """
    parts = _beginnings(drafts, wrong, lead)
    if not parts:
        return None
    try:
        model = joint_fit.settled(joint.evaluate(model, parts), parts).model
        plain = replace(at.model, settings=model.settings)
        right = evaluate(plain, parts, given, derivatives=False)
        consensus = evaluate(plain, drafts, given, derivatives=False)
    except SimulationError:
        return None
    most = float(np.quantile(np.concatenate(robust_fit.squared_misfits(right, 1.0)), RIGHT))
    worst = float(np.concatenate(robust_fit.squared_misfits(consensus, 1.0)).max())
    if worst < STANDS_OUT**2 * most:
        return None
    return Undisturbed(model, consensus, float((most * worst) ** 0.25))


def _beginnings(
    drafts: Sequence[Recording], wrong: Sequence[np.ndarray], lead: float
) -> list[Recording]:
    """The recordings up to their first outlier frame, but at least a share of each."""
    result = []
    for draft, w in zip(drafts, wrong, strict=True):
        first = int(np.argmax(w)) if w.any() else len(w)
        stop = len(draft.times) - len(w) + max(first, round(lead * len(w)))
        if stop >= FEWEST:
            result.append(draft.until(stop))
    return result
