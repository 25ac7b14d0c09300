# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Drafts: recordings with a coarser simulation, with which causes are looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.identification.residual_noise import rms, whitened
from dlo_ros.inference.joint import Simulated, simulate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import IMMATERIAL
from dlo_ros.spline import DEGREE, FloatArray

LONGEST, TIME_ROUNDS, TIME_FACTOR = 1e-2, 9, 10.0**0.5
"""Tolerances of time steps that are tried: the largest, by which one step may add 0.3 mm per metre
of DLO, their number, and the factor between two of them."""
SPACE_ROUNDS, SPACE_FACTOR = 5, 4.0
"""Numbers of knot spans that are tried, each twice the one before, and the factor by which the
error falls at least: cubic splines converge faster."""
DRAFT_SPANS = 2
"""Knot spans of a draft's simulation over those of the observed spline."""
DRAFT_TOLERANCE = 1e-3
DRAFT_FRAMES = 800
LEAST_FRAMES = 100
"""Frames that a draft goes through: most of all recordings together, least of one."""
SHOWN = 0.25
"""Share of the squared residuals that a draft must go through."""
DRAFT_SHARE = 0.01
"""Error of a draft over the plain model's residual, up to which it does not matter: good models
leave a tenth of that residual and less."""


def drafts(recordings: Sequence[Recording], at: Simulated) -> tuple[Recording, ...]:
    """The recordings with a coarser simulation that is still reliable, long ones shortened.

    Args:
        at: the fine simulation of a model: of the plain one, or of one that comes nearer, for which
            the drafts are reliable then.
    """
    return tuple(
        shortened(_draft(recording, left, fine[..., :3], at.model), left, len(recordings))
        for recording, left, fine in zip(
            recordings, whitened(at, recordings), at.predicted, strict=True
        )
    )


def drafts_error(
    at: Simulated, rough: Sequence[Recording], near: Simulated, fine: Sequence[Recording]
) -> float:
    """The error of drafts, root mean square in units of the noise.

    Args:
        at: a model's simulation of the drafts.
        rough: the drafts.
        near: the same model's fine simulation.
        fine: the recordings of which they are drafts.
    """
    pairs = zip(whitened(at, rough), whitened(near, fine), strict=True)
    return rms([draft - exact[: len(draft)] for draft, exact in pairs])


def _draft(
    recording: Recording, left: FloatArray, fine: FloatArray, model: ParametricModel
) -> Recording:
    """A recording with the coarsest simulation that is reliable, or as it is.

    Args:
        left: what the model leaves of it in units of the noise, shape (F, K).
        fine: control points of its fine simulation [m], shape (F, n, 3).
        model: the model for which it is reliable.
    """
    share = DRAFT_SHARE * rms([left])
    first = DRAFT_SPANS * (recording.observed.shape[1] - DEGREE)
    finest = recording.spans or first * 2**SPACE_ROUNDS
    coarser = [first * 2**k for k in range(SPACE_ROUNDS) if first * 2**k < finest]
    smallest = min(recording.tolerance or DRAFT_TOLERANCE, DRAFT_TOLERANCE)
    tolerances = [max(DRAFT_TOLERANCE, recording.tolerance or 0.0)]
    tolerances += _tolerances(DRAFT_TOLERANCE, smallest)[1:]
    for spans, tolerance in product((*coarser, recording.spans), tolerances):
        draft = replace(recording, spans=spans, tolerance=tolerance, rapid={})
        try:
            off = simulate(model, [draft], ()).predicted[0][..., :3] - fine
        except SimulationError:
            continue
        if rms([recording.coefficients(off) / recording.noise]) < max(IMMATERIAL, share):
            draft, off = _longer_steps(draft, off, model, fine, share)
            # Its error is nearly the same with other models.
            return draft.moved(off)
    return recording


def _tolerances(first: float, last: float) -> list[float]:
    """Tolerances of time steps from one down to another."""
    rounds = round(np.log(first / last) / np.log(TIME_FACTOR))
    return [first / TIME_FACTOR**k for k in range(rounds + 1)]


def _longer_steps(
    draft: Recording, off: FloatArray, model: ParametricModel, fine: FloatArray, most: float
) -> tuple[Recording, FloatArray]:
    """A draft with the longest time steps where these do not matter, and what it does wrong.

    Time steps damp in all pictures alike: no noise hides what they do wrong, but a model that
    misses far more does.

    Args:
        off: what the draft does wrong [m], shape (F, n, 3).
        fine: the control points of the fine simulation [m], shape (F, n, 3).
        most: root mean square error that is allowed, in units of the noise.
    """
    assert draft.tolerance is not None
    for tolerance in _tolerances(LONGEST, draft.tolerance)[:-1]:
        longer = replace(draft, tolerance=tolerance)
        try:
            moved = simulate(model, [longer], ()).predicted[0][..., :3] - fine
        except SimulationError:
            continue
        if rms([draft.coefficients(moved - off) / draft.noise]) < most:
            return longer, moved
    return draft, off


def shortened(recording: Recording, left: FloatArray, recordings: int) -> Recording:
    """A recording until most of the model's error has shown itself.

    Args:
        left: what the model leaves of its last F frames, shape (F, K).
        recordings: number of recordings.
    """
    shown = np.cumsum(np.sum(left**2, axis=1))
    enough = int(np.searchsorted(shown, SHOWN * shown[-1])) + 1
    frames = max(LEAST_FRAMES, DRAFT_FRAMES // recordings, enough)
    return recording.until(frames + len(recording.times) - len(left))
