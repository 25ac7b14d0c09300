# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How well recordings tell two models apart of which neither is quite true."""

from __future__ import annotations

import numpy as np

from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.thresholds import CERTAIN, NAMED, WORTH
from dlo_ros.spline import FloatArray


def log_bayes_factor(one: Evaluation, other: Evaluation) -> float:
    """Log evidence of one model over that of another one for the same recordings."""
    return one.posterior.evidence - other.posterior.evidence


def certain_gain(tried: int) -> float:
    """Gain in log evidence from which one of several models that were tried is certain."""
    return NAMED + float(np.log(tried))


def tells_apart(better: Evaluation, other: Evaluation) -> bool:
    """Whether the same recordings show for certain that one model is better than another one.

    Its log evidence must be higher by what strong evidence asks, and by more than chance: where
    neither law is the true one, each is nearer in some recordings, frequencies and modes and
    farther in others, and the sum is a sum of random numbers, which are independent from bin to bin
    of the spectrum (Vuong, Likelihood ratio tests for model selection and non-nested hypotheses,
    1989).
    """
    gain = log_bayes_factor(better, other)
    return gain > max(WORTH, CERTAIN * evidence_std(better, other))


def evidence_std(one: Evaluation, other: Evaluation) -> float:
    """Standard deviation of the difference of two models' log evidence, see `tells_apart`."""
    differences = _log_likelihoods(one) - _log_likelihoods(other)
    return float(np.sqrt(len(differences)) * np.std(differences))


def _log_likelihoods(at: Evaluation) -> FloatArray:
    """Log likelihood of the residuals of all recordings, bin by bin, shape (B,)."""
    rows = []
    for bins, variances in zip(at.spectra, at.variances, strict=True):
        v = variances.of(bins)
        rows.append(-0.5 * (bins.count * np.log(v) + bins.sum_of_squares / v))
    return np.concatenate(rows)
