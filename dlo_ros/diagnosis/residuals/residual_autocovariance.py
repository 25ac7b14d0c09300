# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Autocovariance of residuals from frame to frame, and the predictive likelihood of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation
from dlo_ros.diagnosis.fitting.levenberg_marquardt import Normal, known, normal
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

SPANS = 3
"""Number of spans into which a single recording is cut to hold one out."""
GAP = 0.1
"""Share of a span that is left out at either side, so that spans do not know of one another."""
DRAWS = 400
FEW = 60
"""Pictures below which neighbouring ones may resemble each other by chance."""
BLOCKS = 6
"""Blocks of a recording over which the spread of a comparison is taken."""


def root_autocovariance(residuals: Sequence[FloatArray]) -> float:
    """Square root of the autocovariance at a lag of one frame, in units of the noise, signed.

    Noise that is new in every frame does not contribute to the product of neighbouring frames. A
    recording of one frame has none; there the variance beyond the noise takes its place.

    Args:
        residuals: residuals of each recording, shape (F, K).
    """
    products, count = 0.0, 0
    for r in residuals:
        if len(r) > 1:
            products += float(np.sum(r[1:] * r[:-1]))
            count += r[1:].size
        else:
            products += float(np.sum(r**2 - 1.0))
            count += r.size
    return float(np.sign(products) * np.sqrt(abs(products) / max(count, 1)))


def chance(residuals: Sequence[FloatArray], seed: int = 0) -> float:
    """The root autocovariance that residuals of the same size exceed by chance in 1 of 100 cases.

    The frames are given random signs: what repeats along the DLO within a frame stays. A recording
    of one frame has no neighbours; for it noise is drawn.
    """
    rng = np.random.default_rng(seed)

    def drawn(r: FloatArray) -> FloatArray:
        if len(r) == 1:
            return rng.normal(size=r.shape)
        return np.asarray(r * rng.choice([-1.0, 1.0], (len(r), 1)))

    found = [root_autocovariance([drawn(r) for r in residuals]) for _ in range(DRAWS)]
    return float(np.percentile(found, 99.0))


def parts(at: CandidateEvaluation) -> list[tuple[int, slice]]:
    """The parts that are held out in turn: whole recordings, or spans of time of the only one."""
    if len(at.residuals) > 1:
        return [(k, slice(None)) for k in range(len(at.residuals))]
    frames = len(at.residuals[0])
    size = frames / SPANS
    return [
        (0, slice(round((k + GAP) * size if k else 0), round((k + 1 - GAP) * size)))
        for k in range(SPANS)
    ]


def predictive_score(at: CandidateEvaluation, given: Settings) -> float:
    """Minus twice the log likelihood of each part as predicted from the others, summed.

    By the linearised model at a fit to all: leaving a part out moves the parameters by one step of
    Newton's method, and widens the prediction by what the others do not determine.
    """
    assert at.jacobians is not None
    pieces = []
    for k, frames in parts(at):
        pieces.append(normal(at.residuals[k][frames], at.jacobians[k][frames]))
    everything: Normal = known(at.model, given)
    for piece in pieces:
        everything = everything + piece
    _, lowest = everything.minimum()
    volume = _log_determinant(everything.hessian)
    score = 0.0
    for piece in pieces:
        others = Normal(
            everything.hessian - piece.hessian,
            everything.gradient - piece.gradient,
            everything.sum_of_squares - piece.sum_of_squares,
        )
        _, left = others.minimum()
        score += lowest - left + volume - _log_determinant(others.hessian)
    return float(score)


def _log_determinant(matrix: FloatArray) -> float:
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
    return float(np.sum(np.log(np.maximum(values, 1e-14))) + 2.0 * np.sum(np.log(scale)))


@dataclass(frozen=True)
class Comparison:
    """Two models on the same measurements.

    Args:
        difference: difference of the sums of squared residuals, the other's minus the first's.
        std: standard error of the difference, from blocks of time.
    """

    difference: float
    std: float


def compare(a: Sequence[FloatArray], b: Sequence[FloatArray]) -> Comparison:
    """Squared residuals of model b minus those of a, with the spread over blocks of time."""
    gains = []
    for r, s in zip(a, b, strict=True):
        for mine, other in zip(np.array_split(r, BLOCKS), np.array_split(s, BLOCKS), strict=True):
            gains.append(float(np.sum(other**2) - np.sum(mine**2)))
    return Comparison(float(np.sum(gains)), float(np.std(gains) * np.sqrt(len(gains))))


def description(at: CandidateEvaluation) -> str:
    """Where and when the residual is largest, in a sentence."""
    variances = [np.mean(r**2, axis=1) for r in at.residuals]
    k = int(np.argmax([float(np.mean(v)) for v in variances]))
    half = at.residuals[k].shape[1] // 2
    along = np.mean(at.residuals[k][:, :half] ** 2, axis=0)
    place = ("near the start", "in the middle", "near the end")[
        int(np.argmax([float(np.mean(part)) for part in np.array_split(along, 3)]))
    ]
    time = ("at the beginning", "in the middle", "towards the end")[
        int(np.argmax([float(np.sum(part)) for part in np.array_split(variances[k], 3)]))
    ]
    return (
        f"The residual is largest in recording {k + 1}, {place} of the DLO, {time} of the motion."
    )
