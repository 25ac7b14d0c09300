# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From views of a pattern to the camera: the views that fit, the lens model, the uncertainty.

No picture is processed here: `pattern_search` finds the corners, this module optimises.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.errors import InputError, VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.camera_fit import (
    FULL,
    SIMPLE,
    CameraFit,
    Intrinsics,
    Lens,
    PatternPose,
    fit_camera,
    fit_lenses,
    locate,
    without_outliers,
)
from dlo_ros.vision.calibration.lens_selection import (
    LensScore,
    choose_lens,
    compare_lenses,
    prediction_errors,
)
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Pattern
from dlo_ros.vision.calibration.view_coverage import LEAST_VIEWS, Coverage

SUBSET = 5  # views from which a first camera is guessed
TRIALS = 15
ROUNDS = 6
OUTLIER_RATIO = 3.0  # times the median error: such a view is no worse picture but another thing
FAR_PX = 0.15  # and at least so much above it
BLURRED, BLURRED_PX = 2.5, 4.0  # edge width: times the median, and at least [px]
WEAK = 0.003  # standard deviation of the focal length over itself above which there is a hint
POOR = 0.7  # [px] of reprojection error above which there is a hint
UNKNOWN = 0.05  # and above which there is no result

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class ViewResult:
    """The use of a view in a calibration.

    Args:
        view: corners that were taken out as outliers are not in it.
        used: whether the camera was fitted to it.
        reason: the reason why the view was not used; empty where it was.
        pose: pose of the pattern under the result, None where there is none.
        dropped: number of corners taken out.
    """

    view: PatternView
    used: bool
    reason: str
    pose: PatternPose | None
    dropped: int = 0

    @property
    def rms(self) -> float:
        """Reprojection error [px], NaN where there is no pose."""
        return float("nan") if self.pose is None else self.pose.rms


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated camera.

    Args:
        intrinsics: the camera.
        std: standard deviations of fx, fy, cx, cy [px]; None where the camera was given.
        views: the views in the order given.
        lenses: the models that were compared; empty where the camera was given.
        lens: the chosen one, None where the camera was given.
        hints: advice: which further views would help, and what to be careful about.
    """

    intrinsics: Intrinsics
    std: FloatArray | None
    views: tuple[ViewResult, ...]
    lenses: tuple[LensScore, ...]
    lens: Lens | None
    hints: tuple[str, ...]

    @property
    def used(self) -> tuple[ViewResult, ...]:
        """The views that the camera rests on."""
        return tuple(v for v in self.views if v.used)

    @property
    def rms(self) -> float:
        """Reprojection error over the used views [px]."""
        residuals = [v.pose.residuals for v in self.used if v.pose is not None]
        if not residuals:
            return float("nan")
        return float(np.sqrt(np.mean(np.sum(np.concatenate(residuals) ** 2, axis=1))))


def calibrate(
    views: Sequence[PatternView],
    pattern: Pattern,
    seed: int = 0,
    progress: Progress = lambda text, share: None,
) -> Calibration:
    """Calibrate a camera.

    Views that disagree with the majority are left out, and the lens model is the one with fewest
    coefficients whose prediction of held-out views is not worse than the best model's by more
    than the standard error of the difference.

    Args:
        views: pictures of one size in which the pattern was found.
        pattern: the calibration pattern in the views.
        seed: seed of the random subsets and folds.
        progress: function that is called with the name of the present step and its fraction of the
            whole.

    Raises:
        InputError: sizes differ, too few views, or they leave the focal length open.
    """
    _check(views)
    rng = np.random.default_rng(seed)
    reasons = _blurred(views)
    scores: tuple[LensScore, ...]
    before: list[int] | None
    sharp = [k for k in range(len(views)) if k not in reasons]
    _enough(len(sharp), "sharp views")
    kept = list(views)
    progress("finding the views that agree", 0.0)
    start = _consensus([views[k] for k in sharp], pattern, rng)
    lens, scores, before = FULL, (), None
    chosen = _agreeing(kept, sharp, pattern, start)
    fit = _fitted(kept, chosen, pattern, lens, start)
    for turn in range(ROUNDS):
        progress("finding the views that agree", (1.0 + turn) / (2.0 + ROUNDS))
        kept = _trimmed(views, pattern, fit.intrinsics)
        chosen = _agreeing(kept, sharp, pattern, fit.intrinsics)
        _enough(len(chosen), "views that agree with each other")
        if chosen == before:
            if scores:
                break
            progress("choosing the lens model", (1.0 + turn) / (2.0 + ROUNDS))
            scores = compare_lenses([kept[k] for k in chosen], pattern, fit.intrinsics, rng)
            lens = choose_lens(scores)
        before = chosen
        fit = _fitted(kept, chosen, pattern, lens, fit.intrinsics)
    focal = fit.intrinsics.matrix[[0, 1], [0, 1]]
    weakness = float(np.max(fit.std[:2] / focal))
    if not weakness < UNKNOWN:
        raise InputError(
            "the views leave the focal length open; take some with the pattern tilted by 30 to "
            "45 degrees, about the vertical and about the horizontal"
        )
    results = _results(views, kept, chosen, reasons, pattern, fit.intrinsics)
    coverage = Coverage(pattern)
    for result in results:
        if result.used and result.pose is not None:
            coverage.add(result.view, result.pose)
    hints = coverage.hints()
    if weakness > WEAK:
        hints.append(
            f"the focal length is known to {100.0 * weakness:.1f} % only; more views, tilted by 30 "
            "to 45 degrees and near enough to fill the image, determine it better"
        )
    found = Calibration(fit.intrinsics, fit.std, results, scores, lens, tuple(hints))
    if found.rms > POOR:
        remark = (
            f"a reprojection error of {found.rms:.1f} px is large: the pattern is not flat, zoom "
            "or focus changed, or the lens distorts more than these models can describe"
        )
        return replace(found, hints=(*hints, remark))
    return found


def check_camera(
    views: Sequence[PatternView], pattern: Pattern, intrinsics: Intrinsics
) -> Calibration:
    """Agreement of views with a camera that was calibrated before.

    Raises:
        InputError: a view is of another size.
    """
    for view in views:
        if (view.width, view.height) != (intrinsics.width, intrinsics.height):
            raise InputError(
                f"{view.name}: is {view.width} x {view.height} px; the camera was calibrated for "
                f"{intrinsics.width} x {intrinsics.height}"
            )
    results = _results(views, views, range(len(views)), {}, pattern, intrinsics)
    found = Calibration(intrinsics, None, results, (), None, ())
    if found.rms > POOR:
        remark = (
            f"the given camera does not fit these views: they are off by {found.rms:.1f} px; "
            "zoom or focus changed since, or the pattern is not flat: calibrate anew"
        )
        return replace(found, hints=(remark,))
    return found


def _check(views: Sequence[PatternView]) -> None:
    _enough(len(views), "usable views")
    first = views[0]
    for view in views[1:]:
        if (view.width, view.height) != (first.width, first.height):
            raise InputError(
                f"{view.name}: is {view.width} x {view.height} px, {first.name} {first.width} x "
                f"{first.height}; all images must be of one size"
            )


def _enough(count: int, what: str) -> None:
    if count < LEAST_VIEWS:
        raise InputError(
            f"{count} {what}; at least {LEAST_VIEWS} are needed: take {LEAST_VIEWS - count} more, "
            "each from another direction"
        )


def _blurred(views: Sequence[PatternView]) -> dict[int, str]:
    """Views that are much less sharp than the others, with the reason."""
    widths = np.array([v.edge_width for v in views])
    limit = max(BLURRED * float(np.median(widths)), BLURRED_PX)
    return {
        k: f"blurred: edges are {w:.0f} px wide, {np.median(widths):.1f} px in most views"
        for k, w in enumerate(widths)
        if w > limit
    }


def _consensus(
    views: Sequence[PatternView], pattern: Pattern, rng: np.random.Generator
) -> Intrinsics:
    """The camera of a few views with which most views agree (least median of squares)."""
    best, camera = np.inf, None
    for _ in range(TRIALS):
        chosen = rng.choice(len(views), min(SUBSET, len(views)), replace=False)
        try:
            candidate = fit_camera([views[k] for k in chosen], pattern, SIMPLE).intrinsics
        except VisionError:
            continue
        error = float(np.median(prediction_errors(views, pattern, candidate)))
        if error < best:
            best, camera = error, candidate
    if camera is None:
        raise InputError("the views determine no camera; take them from more directions")
    return camera


def _limit(errors: FloatArray) -> float:
    middle = float(np.median(errors))
    return max(OUTLIER_RATIO * middle, middle + FAR_PX)


def _agreeing(
    views: Sequence[PatternView], among: Sequence[int], pattern: Pattern, camera: Intrinsics
) -> list[int]:
    errors = prediction_errors([views[k] for k in among], pattern, camera)
    whole = np.array([len(views[k].corners) for k in among])
    limit = _limit(errors)
    return [k for k, e, n in zip(among, errors, whole, strict=True) if e <= limit and n]


def _fitted(
    views: Sequence[PatternView],
    chosen: Sequence[int],
    pattern: Pattern,
    lens: Lens,
    guess: Intrinsics,
) -> CameraFit:
    _enough(len(chosen), "views that agree with each other")
    fit = fit_lenses([views[k] for k in chosen], pattern, guess, lens)[-1]
    if fit is None:
        raise InputError("the views determine no camera; take them from more directions")
    return fit


def _trimmed(
    views: Sequence[PatternView], pattern: Pattern, camera: Intrinsics
) -> list[PatternView]:
    """The views without corners that are outliers."""
    poses: list[PatternPose | None] = []
    for view in views:
        try:
            poses.append(locate(view, pattern, camera))
        except VisionError:
            poses.append(None)
    typical = float(np.median([p.rms for p in poses if p is not None] or [np.inf]))
    return [
        view if pose is None else without_outliers(view, pose, typical)
        for view, pose in zip(views, poses, strict=True)
    ]


def _results(
    views: Sequence[PatternView],
    kept: Sequence[PatternView],
    chosen: Sequence[int],
    reasons: dict[int, str],
    pattern: Pattern,
    camera: Intrinsics,
) -> tuple[ViewResult, ...]:
    used = set(chosen)
    errors = prediction_errors([kept[k] for k in chosen], pattern, camera)
    results = []
    for k, (view, part) in enumerate(zip(views, kept, strict=True)):
        try:
            pose = locate(part, pattern, camera)
        except VisionError as err:
            results.append(ViewResult(part, False, str(err), None))
            continue
        reason = reasons.get(k, "")
        if k not in used and not reason:
            reason = (
                f"does not fit the others: {pose.rms:.2f} px, they have {np.median(errors):.2f} px"
            )
        dropped = len(view.corners) - len(part.corners)
        results.append(ViewResult(part, k in used, reason, pose, dropped))
    return tuple(results)
