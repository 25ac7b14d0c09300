# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The joint model fitted to those pictures in which the DLO has not hit anything yet.

Beside a set-up that is off, the plain model is wrong in every picture: the effect of a contact
shows only in the residual of the set-up's fit, and a fit of the set-up to all pictures explains
part of the contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.diagnosis.contact import robust_fit
from dlo_ros.effects import Scene
from dlo_ros.errors import SimulationError
from dlo_ros.inference import joint, joint_fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import joint_model
from dlo_ros.inference.thresholds import CERTAIN, FEWEST
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LEADS = (0.0, 0.25)
"""Shares of each recording, from its beginning, that count as undisturbed at first: a DLO that is
wrong from the first picture on may lie on a peg, or be gripped as in no other recording."""
RIGHT = 0.9
"""Share of the fitted pictures that are certainly undisturbed."""


@dataclass(frozen=True)
class Undisturbed:
    """A fit to undisturbed pictures.

    Args:
        model: the fitted joint model.
        at: simulation of its values in all drafts, without derivatives.
        scale: deviation from which a picture is disturbed, in units of the noise: `CERTAIN` times
            that of nine in ten of those that were fitted. What a tip does that slides on a table
            grows from there little by little.
    """

    model: ParametricModel
    at: joint.Simulated
    scale: float


def undisturbed(
    drafts: Sequence[Recording], given: Settings, at: joint.Evaluation, scene: Scene
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
    found = robust_fit.consensus_fit(drafts, at)
    if found is None:
        return None
    consensus, scale = found
    model = joint_model(consensus.model.settings, given, scene)
    wrong = robust_fit.outlier_frames(consensus, drafts, scale)
    fits = [_fitted(drafts, model, wrong, lead) for lead in LEADS]
    begun = [f for f in fits if f is not None]
    if not begun:
        return None
    loss = robust_fit.robust_loss(drafts)
    best = min(begun, key=lambda f: loss.of_pictures(f.at))
    wrong = robust_fit.outlier_frames(best.at, drafts, best.scale)
    return _fitted(drafts, best.model, wrong, 0.0)


def _fitted(
    drafts: Sequence[Recording],
    model: ParametricModel,
    wrong: Sequence[np.ndarray],
    lead: float,
) -> Undisturbed | None:
    """The joint model fitted to the beginnings of recordings.

    Args:
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
        right = joint.simulate(model, parts, ())
        consensus = joint.simulate(model, drafts, ())
    except SimulationError:
        return None
    most = float(np.quantile(_squares(right, parts), RIGHT))
    scale = CERTAIN * float(np.sqrt(most))
    if _squares(consensus, drafts).max() < scale**2:
        return None
    return Undisturbed(model, consensus, scale)


def _squares(at: joint.Simulated, recordings: Sequence[Recording]) -> FloatArray:
    """Mean square of the residual of each picture in units of the noise."""
    return np.concatenate(robust_fit.robust_loss(recordings, 1.0).squares(at))


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
