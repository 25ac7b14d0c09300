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
leave a tenth of that residual and less; and how much what it does wrong may change over the change
of the shapes."""


def drafts(
    recordings: Sequence[Recording], at: Simulated, beside: Simulated | None = None
) -> tuple[Recording, ...]:
    """The recordings with a coarser simulation that is still reliable, long ones shortened.

    Args:
        at: the fine simulation of a model: of the plain one, or of one that comes nearer, for which
            the drafts are reliable then.
        beside: that of a model beside it, as far away as a fit may still go; None: the drafts are
            to be right. Otherwise they may do wrong what they do wrong with both.
    """
    left = whitened(at, recordings)
    both = [at] if beside is None else [at, beside]
    fine = [[e.predicted[k][..., :3] for e in both] for k in range(len(recordings))]
    models = [e.model for e in both]
    return tuple(
        shortened(_draft(r, rms([own]), shapes, models), own, len(recordings))
        for r, own, shapes in zip(recordings, left, fine, strict=True)
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
    recording: Recording, left: float, fine: Sequence[FloatArray],
    models: Sequence[ParametricModel],
) -> Recording:  # fmt: skip
    """A recording with the coarsest simulation that is reliable, or as it is.

    Args:
        left: what the model leaves of it, root mean square in units of the noise.
        fine: control points of the models' fine simulations [m], shape (F, n, 3) each.
        models: the model for which it is reliable, and one beside it, if there is one.
    """
    shown = left if len(fine) == 1 else _size(recording, fine[1] - fine[0])
    share = DRAFT_SHARE * shown
    first = DRAFT_SPANS * (recording.observed.shape[1] - DEGREE)
    finest = recording.spans or first * 2**SPACE_ROUNDS
    coarser = [first * 2**k for k in range(SPACE_ROUNDS) if first * 2**k < finest]
    smallest = min(recording.tolerance or DRAFT_TOLERANCE, DRAFT_TOLERANCE)
    tolerances = [max(DRAFT_TOLERANCE, recording.tolerance or 0.0)]
    tolerances += _tolerances(DRAFT_TOLERANCE, smallest)[1:]
    for spans, tolerance in product((*coarser, recording.spans), tolerances):
        draft = replace(recording, spans=spans, tolerance=tolerance, rapid={})
        try:
            off = _wrong(draft, fine, models)
        except SimulationError:
            continue
        if _size(draft, _unforeseen(off)) < max(IMMATERIAL, share):
            draft, off = _longer_steps(draft, off, fine, models, share)
            # Its error is nearly the same with other models.
            return draft.moved(off[0])
    return recording


def _wrong(
    draft: Recording, fine: Sequence[FloatArray], models: Sequence[ParametricModel]
) -> Sequence[FloatArray]:
    """The error of a draft with each model [m], shape (F, n, 3)."""
    return [
        simulate(model, [draft], ()).predicted[0][..., :3] - right
        for model, right in zip(models, fine, strict=True)
    ]


def _unforeseen(off: Sequence[FloatArray]) -> FloatArray:
    """The error of a draft with the last model, (F, n, 3) [m], less that with the one before."""
    return off[0] if len(off) == 1 else off[1] - off[0]


def _size(recording: Recording, off: FloatArray) -> float:
    """Root mean square of distances (F, n, 3) in units of the noise."""
    return rms([recording.coefficients(off) / recording.noise])


def _tolerances(first: float, last: float) -> list[float]:
    """Tolerances of time steps from one down to another."""
    rounds = round(np.log(first / last) / np.log(TIME_FACTOR))
    return [first / TIME_FACTOR**k for k in range(rounds + 1)]


def _longer_steps(
    draft: Recording, off: Sequence[FloatArray], fine: Sequence[FloatArray],
    models: Sequence[ParametricModel], most: float,
) -> tuple[Recording, Sequence[FloatArray]]:  # fmt: skip
    """A draft with the longest time steps where these do not matter, and what it does wrong.

    Time steps damp in all pictures alike: no noise hides what they do wrong, but a model that
    misses far more does.

    Args:
        off: what the draft does wrong with each model [m], shape (F, n, 3).
        fine, models: see `_draft`.
        most: root mean square error that is allowed, in units of the noise.
    """
    assert draft.tolerance is not None
    for tolerance in _tolerances(LONGEST, draft.tolerance)[:-1]:
        longer = replace(draft, tolerance=tolerance)
        try:
            moved = _wrong(longer, fine, models)
        except SimulationError:
            continue
        if _size(draft, _unforeseen(moved) - _unforeseen(off)) < most:
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
