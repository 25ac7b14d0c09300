# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Selection of the lens model that the views justify: cross-validation over views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.errors import InputError, VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.camera_fit import LENSES, Intrinsics, Lens, fit_lenses, locate
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Pattern

FOLDS = 6


@dataclass(frozen=True)
class LensScore:
    """Error of a lens model in views that it was not fitted to.

    Args:
        lens: the model.
        rms: reprojection error of the held-out views, only their poses fitted [px].
        worse: mean squared error above the best model's, in standard errors of that difference.
    """

    lens: Lens
    rms: float
    worse: float


def compare_lenses(
    views: Sequence[PatternView], pattern: Pattern, guess: Intrinsics, rng: np.random.Generator
) -> tuple[LensScore, ...]:
    """Cross-validation over views: each is predicted by a camera fitted without it.

    A model that fails, or that distorts the image's border beyond recovery, scores infinity.
    """
    folds = min(FOLDS, len(views))
    part = rng.permutation(len(views)) % folds
    errors = np.full((len(LENSES), len(views)), np.inf)
    for fold in range(folds):
        train = [v for v, p in zip(views, part, strict=True) if p != fold]
        aside = np.nonzero(part == fold)[0]
        for row, fit in enumerate(fit_lenses(train, pattern, guess)):
            if fit is None or not fit.intrinsics.invertible:
                continue
            errors[row, aside] = (
                prediction_errors([views[int(k)] for k in aside], pattern, fit.intrinsics) ** 2
            )
    if not np.isfinite(errors.mean(axis=1)).any():
        raise InputError("the views determine no camera; take them from more directions")
    best = errors[np.argmin(errors.mean(axis=1))]
    scores = []
    for lens, row_errors in zip(LENSES, errors, strict=True):
        if not np.all(np.isfinite(row_errors)):
            scores.append(LensScore(lens, np.inf, np.inf))
            continue
        difference = row_errors - best
        spread = difference.std(ddof=1) / np.sqrt(len(views))
        worse = difference.mean() / spread if spread > 0.0 else 0.0
        scores.append(LensScore(lens, float(np.sqrt(row_errors.mean())), float(worse)))
    return tuple(scores)


def choose_lens(scores: Sequence[LensScore]) -> Lens:
    """The first that is within one standard error of the best (Breiman et al. 1984, 3.4.3)."""
    return next(s.lens for s in scores if s.worse <= 1.0)


def prediction_errors(
    views: Sequence[PatternView], pattern: Pattern, camera: Intrinsics
) -> FloatArray:
    """Reprojection error of each view, only its pose fitted [px], infinite where it fits none."""
    errors = np.full(len(views), np.inf)
    for k, view in enumerate(views):
        try:
            errors[k] = locate(view, pattern, camera).rms
        except VisionError:
            continue
    return errors
