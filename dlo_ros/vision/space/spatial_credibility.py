# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Credibility of a fit in space: whether it can be the DLO."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.parameters import RodParameters
from dlo_ros.spline import FloatArray
from dlo_ros.vision.fit.course_evidence import BEND, bending_evidence, chance_length
from dlo_ros.vision.fit.material_coordinates import length_log_likelihood
from dlo_ros.vision.fit.planar_credibility import LEAST_SEEN, SHARPEST
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.space.spatial_clamps import Clamps
from dlo_ros.vision.space.spatial_result import SpaceFit
from dlo_ros.vision.space.view import View

STEPS = 400  # equal steps of u in which it is judged what was seen
REACH = 1.5  # [blocks] around a measured point within which the DLO counts as seen
LEAST_BY_SEVERAL = 0.4  # share of the length that two cameras must see, or one with depth
LARGEST_RESIDUAL = (
    0.12  # [widths] root of the mean square of points beside the spline, outliers cut
)
BESIDE = 0.5  # [widths] a point further off lies on something else,
MOST_BESIDE = 0.08  # which may be so of this share of a view's points
LONGEST_STRETCH = 0.03  # of L: what is seen may be longer or shorter by as much
FAR_FROM_CLAMP = 4.0  # [diameters] that an end may lie from its clamp
DIFFERENT = 2.0  # [diameters] two shapes that are nowhere further apart are one
EVEN = 0.02  # [widths] points beside the spline by less are no evidence against it
JUDGED = 15  # places of which the std is looked at
UNDETERMINED = (
    "the pictures do not determine the depth: the DLO runs along the epipolar lines, or "
    "the cameras stand too close to one another"
)
LARGEST_STD = 0.02  # of L: where nothing determines the depth better, median over the DLO


def seen_by(views: Sequence[View], fit: SpaceFit, length: float) -> tuple[Mask, Mask]:
    """Masks of the `STEPS` equal steps of u that are seen at all, and by two views or one with
    depth.
    """
    at = np.asarray((np.arange(STEPS) + 0.5) * (length / STEPS), dtype=np.float64)
    count = np.zeros(STEPS, dtype=np.int64)
    for view, u, weight in zip(views, fit.u, fit.weights, strict=True):
        count += near(at, u[weight > 0.0], length)
        if view.depth is not None:
            count += near(at, u[np.isfinite(view.depth)], length)
    return count >= 1, count >= 2


def near(at: FloatArray, u: FloatArray, length: float) -> Mask:
    """Mask of material coordinates that lie beside those of measured points [m], shape
    (len(at),).
    """
    u = np.sort(u)
    if len(u) < 2:
        return np.zeros(len(at), dtype=np.bool_)
    reach = REACH * max(float(np.median(np.diff(u))), 0.5 * length / STEPS)
    k = np.searchsorted(u, at)
    left, right = u[np.maximum(k - 1, 0)], u[np.minimum(k, len(u) - 1)]
    return np.asarray(np.minimum(np.abs(at - left), np.abs(right - at)) <= reach, dtype=np.bool_)


def check(views: Sequence[View], fit: SpaceFit, clamps: Clamps, diameter: float) -> None:
    """Check that a fit in space is credible.

    Args:
        views: views that the spline was fitted to.
        fit: the fine spline.
        clamps: poses of the clamps of start and end.
        diameter: diameter of the DLO [m].

    Raises:
        VisionError: with the reason.
    """
    length = fit.basis.length
    anywhere, several = seen_by(views, fit, length)
    if np.mean(anywhere) < LEAST_SEEN:
        raise VisionError(
            f"only {100 * np.mean(anywhere):.0f} % of the DLO is visible, at least "
            f"{100 * LEAST_SEEN:.0f} % are needed"
        )
    if np.mean(several) < LEAST_BY_SEVERAL:
        raise VisionError(
            f"two views share only {100 * np.mean(several):.0f} % of the DLO, at least "
            f"{100 * LEAST_BY_SEVERAL:.0f} % are needed"
        )
    for view, residual, weight in zip(views, fit.residuals, fit.weights, strict=True):
        residual = residual[weight > 0.0]
        beside = np.abs(residual) > BESIDE * view.width
        inner = residual[~beside] / view.width
        if np.mean(beside) > MOST_BESIDE or np.sqrt(np.mean(inner**2)) > LARGEST_RESIDUAL:
            raise VisionError(
                "the views do not show one DLO: a wrong course in one of them, a wrong pose of a "
                "camera, or pictures of different instants"
            )
    if abs(fit.stretch) > LONGEST_STRETCH:
        raise VisionError(
            f"what looks like the DLO is {length * (1.0 + fit.stretch):.3g} m long, rod.length is "
            f"{length:.3g} m"
        )
    for clamp, end in zip(clamps, (fit.points[0], fit.points[-1]), strict=True):
        if clamp is not None:
            away = float(np.linalg.norm(clamp.position - end))
            if away > FAR_FROM_CLAMP * diameter:
                raise VisionError(
                    f"what looks like the DLO ends {1000 * away:.0f} mm from its clamp"
                )
    tangent = fit.tangents_of(fit.basis.grid(max(8, round(length / diameter)), 1))
    turn = np.arccos(np.clip(np.sum(tangent[1:] * tangent[:-1], axis=1), -1.0, 1.0))
    if float(turn.max()) > SHARPEST:
        raise VisionError("what looks like the DLO bends more sharply than one can")
    covariance = fit.covariance_of(fit.basis.grid(JUDGED))
    std = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0)
    if float(np.median(std)) > LARGEST_STD * length:
        raise VisionError(UNDETERMINED)


def evidence(views: Sequence[View], fit: SpaceFit, rod: RodParameters) -> float:
    """Log likelihood of a shape, up to a constant: by its bends, length and distance to the views.

    As the bends (see `bending_evidence`), the distances have a variance that is not known.

    Args:
        views: views that the spline was fitted to.
        fit: the fine spline.
        rod: parameters of the DLO.
    """
    curve = fit.basis.evaluate(fit.points, np.linspace(0.0, rod.length, STEPS))
    seen = rod.length * (1.0 + fit.stretch)
    likely = bending_evidence(curve, rod.diameter)
    likely += float(length_log_likelihood(seen, rod.length, rod.length_std))
    count = rod.length / (BEND * rod.diameter)
    for view, residual, weight in zip(views, fit.residuals, fit.weights, strict=True):
        away = np.abs(residual[weight > 0.0]) / view.width
        square = float(np.mean(np.minimum(away, BESIDE) ** 2))
        likely -= 0.5 * count * math.log(square + EVEN**2)
    return likely


def by_chance(fit: SpaceFit, rod: RodParameters) -> bool:
    """Whether a shape that is not the DLO is likelier to have the shape's length than the DLO."""
    seen, limits = rod.length * (1.0 + fit.stretch), (LONGEST_STRETCH, LONGEST_STRETCH)
    return chance_length(seen, limits, rod.length, rod.length_std)


def alike(one: SpaceFit, other: SpaceFit, diameter: float) -> bool:
    """Whether two shapes are nowhere apart.

    Args:
        one, other: fits with one basis.
        diameter: diameter of the DLO [m].
    """
    at = np.linspace(0.0, one.basis.length, STEPS)
    away = one.basis.evaluate(one.points - other.points, at)
    return float(np.linalg.norm(away, axis=1).max()) < DIFFERENT * diameter
