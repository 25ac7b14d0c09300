# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The published result of the fit in space: control points, and points with their std."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.fit.material_coordinates import std_along
from dlo_ros.vision.fit.spline_fit import FEWEST_POINTS, UNSEEN_WEIGHT
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.space.reprojection import CLAMP_ALONG_STD, SHARED_STD, TIP_STD
from dlo_ros.vision.space.spatial_clamps import Clamps
from dlo_ros.vision.space.spatial_credibility import UNDETERMINED
from dlo_ros.vision.space.spatial_result import SpaceFit
from dlo_ros.vision.space.view import View

DENSE = 401  # points by which the published spline is fitted
LARGEST_POINT_STD = (0.5, 0.005)
"""Shares of the diameter and of L, of which the larger is the largest std of a published point: one
known less well across may lie beside the DLO, and says nothing of its shape."""
PER_SPAN = 1.0  # published points in a knot span of the fine spline: more would not be independent


def publish(
    stamp: int,
    fit: SpaceFit,
    basis: SplineBasis,
    seen: Mask,
    end_stds: tuple[float, float],
    diameter: float,
) -> Observation:
    """The published spline and the points behind it.

    The std of a point is the root mean square of those in the two directions across the DLO; that
    along it is the std of u. Places whose depth nothing determines well, as along the epipolar
    lines, have no point: the spline continues there.

    Args:
        stamp: stamp of the pictures [ns].
        fit: the fine spline.
        basis: basis of the published spline.
        seen: whether anything was seen at each of equal steps of u.
        end_stds: standard deviations of start and end along the DLO [m]; infinite where they are
            not known.
        diameter: diameter of the DLO [m].

    Raises:
        VisionError: hardly anything was seen, or nothing determines the depth.
    """
    length = basis.length
    u = np.linspace(0.0, length, DENSE)
    weights = np.where(_at(seen, u, length), 1.0, UNSEEN_WEIGHT)
    weights[[0, -1]] = 0.05 * DENSE
    control_points = np.zeros((basis.control_points, 4))
    control_points[:, :3] = basis.fit_grid(fit.basis.grid(DENSE) @ fit.points, weights)
    count = max(FEWEST_POINTS + 1, round(PER_SPAN * fit.basis.spans)) + 1
    at = np.linspace(0.0, length, count)
    shown = _at(seen, at, length)
    if np.count_nonzero(shown) < FEWEST_POINTS:
        raise VisionError("hardly anything of the DLO is visible")
    values, slopes = (fit.basis.grid(count, order) for order in (0, 1))
    covariance, tangent = fit.covariance_of(values), fit.tangents_of(slopes)
    along = np.einsum("ma,mab,mb->m", tangent, covariance, tangent)
    across = np.maximum(np.trace(covariance, axis1=1, axis2=2) - along, 0.0) / 2.0
    limit = max(LARGEST_POINT_STD[0] * diameter, LARGEST_POINT_STD[1] * length)
    shown &= across < limit**2
    if np.count_nonzero(shown) < FEWEST_POINTS:
        raise VisionError(UNDETERMINED)
    at, across, values = at[shown], across[shown], values[shown]
    shift = np.zeros((2, 2))
    shift[[0, 1], [0, 1]] = [1.0 / max(std, 1e-9) ** 2 for std in end_stds]
    shift += np.array([[1.0, -1.0], [-1.0, 1.0]]) / (SHARED_STD * length) ** 2
    # Where neither end is known nothing is; a DLO's length bounds it.
    shift += np.eye(2) / length**2
    ends = std_along(at, length, np.asarray(np.linalg.inv(shift)), 0.0)
    points = CentrelinePoints(
        values @ fit.points, at, np.sqrt(across), np.hypot(ends, np.sqrt(across))
    )
    return Observation(stamp, control_points, points)


def end_stds(views: Sequence[View], clamps: Clamps, diameter: float) -> tuple[float, float]:
    """Standard deviations of start and end along the DLO [m], by clamps or by the views' tips."""
    result = []
    for k, clamp in enumerate(clamps):
        shown = sum(view.tips[k] is not None for view in views)
        weight = shown / (TIP_STD * diameter) ** 2
        weight += 0.0 if clamp is None else 1.0 / (CLAMP_ALONG_STD * diameter) ** 2
        result.append(1.0 / np.sqrt(weight) if weight > 0.0 else np.inf)
    return float(result[0]), float(result[1])


def _at(seen: Mask, u: FloatArray, length: float) -> Mask:
    """Whether the DLO was seen at material coordinates [m]."""
    step = np.clip((u / length * len(seen)).astype(np.int64), 0, len(seen) - 1)
    return np.asarray(seen[step], dtype=np.bool_)
