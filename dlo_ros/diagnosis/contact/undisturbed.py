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

from dlo_ros.errors import SimulationError
from dlo_ros.inference import joint, joint_fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import CERTAIN, FEWEST
from dlo_ros.spline import FloatArray

LEADS = (0.12, 0.25, 0.5)
"""Shares of each recording, from its beginning, that count as undisturbed at first."""
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


def undisturbed(drafts: Sequence[Recording], model: ParametricModel) -> Undisturbed | None:
    """Fit a joint model to the beginnings of recordings, before the first outlier frame.

    Args:
        drafts: the recordings with a coarse simulation.
        model: the joint model with which the fits begin.

    Returns:
        None where no picture deviates clearly more than those that are fitted.
    """
    fits = [
        _fitted(drafts, model, [max(FEWEST, round(lead * len(d.times))) for d in drafts])
        for lead in LEADS
    ]
    begun = [f for f in fits if f is not None]
    # One that has been fitted to a contact, too, may come nearest on the whole, and find none.
    for best in sorted(begun, key=lambda f: robust_loss(f.at, drafts, CERTAIN)):
        wrong = outlier_frames(best.at, drafts, best.scale)
        before = [int(np.argmax(w)) if w.any() else len(w) for w in wrong]
        # With `start: moving` the first picture is not compared.
        skipped = [len(d.times) - len(w) for d, w in zip(drafts, wrong, strict=True)]
        counts = [a + b for a, b in zip(skipped, before, strict=True)]
        found = _fitted(drafts, best.model, counts)
        if found is not None:
            return found
    return None


def robust_loss(at: joint.Simulated, recordings: Sequence[Recording], scale: float) -> float:
    """Robust loss of what a model leaves, in units of that of a picture which is right.

    Pictures beyond a scale count ever less, as of a Cauchy distribution.

    Args:
        scale: deviation of pictures that are right, in units of the noise.
    """
    return float(np.sum(np.log1p(np.concatenate(_squares(at, recordings)) / scale**2)))


def outlier_frames(
    at: joint.Simulated, recordings: Sequence[Recording], scale: float
) -> list[np.ndarray]:
    """Pictures whose deviation exceeds a scale, in units of the noise, shape (F,) per recording."""
    return [squares > scale**2 for squares in _squares(at, recordings)]


def _squares(at: joint.Simulated, recordings: Sequence[Recording]) -> list[FloatArray]:
    """Mean square of each picture's residual in units of the noise, shape (F,) per recording."""
    pairs = zip(at.fields, recordings, strict=True)
    return [np.mean((r / recording.noise) ** 2, axis=1) for (r, _), recording in pairs]


def _fitted(
    drafts: Sequence[Recording],
    model: ParametricModel,
    right: Sequence[int],
) -> Undisturbed | None:
    """The joint model fitted to the beginnings of recordings.

    Args:
        model: joint model with which the fit begins.
        right: number of pictures of each recording, from the first, that count as undisturbed.

    Returns:
        None where no picture deviates clearly more than those that are fitted.
    """
    pairs = zip(drafts, right, strict=True)
    parts = [draft.until(count) for draft, count in pairs if count >= FEWEST]
    if not parts:
        return None
    try:
        model = joint_fit.settled(joint.evaluate(model, parts), parts).model
        begun = joint.simulate(model, parts, ())
        consensus = joint.simulate(model, drafts, ())
    except SimulationError:
        return None
    most = float(np.quantile(np.concatenate(_squares(begun, parts)), RIGHT))
    scale = CERTAIN * float(np.sqrt(most))
    if not any(w.any() for w in outlier_frames(consensus, drafts, scale)):
        return None
    return Undisturbed(model, consensus, scale)
