# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The number of control points that a DLO's shape needs, by cross-validation.

Too few cannot follow the shape, too many follow the noise: in between, the spline through a part of
the measured points predicts the others with the least error.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.observation import CentrelinePoints
from dlo_ros.spline import ORDER, FloatArray, SplineBasis

FOLDS = 5
BLOCK = 2  # neighbouring points left out together: their errors are a little alike
MOST_CONTROL_POINTS = 100
GROWTH = 1.12  # of one number that is tried to the next
FOLLOWED = 2.5e-4  # of L: half of what counts as material, see diagnosis.material_err
BEYOND_NOISE = 1.5  # times the stated std of the points, which no spline gets below
MEDIAN_SQUARE = {False: 0.455, True: 1.386}
"""Median of a squared distance across the DLO over its variance in one direction, chi squared with
one degree of freedom in the board's plane and with two in space."""
RIDGE = 1e-9  # keeps a gap without points from making the fit singular


def choose_control_points(points: CentrelinePoints, length: float) -> int:
    """The least number whose error at points left out is within the scatter of the smallest error.

    Breiman et al., Classification and Regression Trees, 1984, section 3.4.3 (one-standard-error
    rule).

    Args:
        points: measured on the DLO.
        length: L [m].

    Raises:
        VisionError: too few points to decide.
    """
    count = len(points.u)
    if count < 4 * FOLDS:
        raise VisionError(f"{count} measured points are too few to choose control points by")
    positions = points.positions
    weights = _weights(points)
    folds = np.arange(count) // BLOCK % FOLDS
    tried, errors = [], []
    n, best, worse = ORDER, np.inf, 0
    while n <= min(MOST_CONTROL_POINTS, count // 2) and worse < 6:
        basis = SplineBasis(n, length)
        b = basis.matrix(points.u)
        squares = np.zeros(count)
        for fold in range(FOLDS):
            kept = folds != fold
            fitted = _solve(b[kept], positions[kept], weights[kept])
            slopes = basis.matrix(points.u[~kept], 1) @ fitted
            squares[~kept] = _squares_across(positions[~kept] - b[~kept] @ fitted, slopes)
        squares *= weights
        # A few wrong points must not choose.
        limit = 9.0 * float(np.median(squares)) / MEDIAN_SQUARE[bool(positions[:, 1].any())]
        squares = np.minimum(squares, max(limit, 1e-30))
        tried.append(n)
        errors.append(squares)
        worse = 0 if squares.mean() < best else worse + 1
        best = min(best, float(squares.mean()))
        n = max(n + 1, round(GROWTH * n))
    means = np.array([e.mean() for e in errors])
    at = int(np.argmin(means))
    scatter = float(errors[at].std() / np.sqrt(count))
    return tried[int(np.argmax(means <= means[at] + scatter))]


def misfit(points: CentrelinePoints, control_points: FloatArray, length: float) -> float:
    """Root mean square distance of measured points across a spline [m].

    Args:
        points: measured on the DLO.
        control_points: x, y, z (and theta) [m], shape (n, 3 or 4).
        length: L [m].
    """
    basis = SplineBasis(len(control_points), length)
    off = points.positions - basis.matrix(points.u) @ control_points[:, :3]
    slopes = basis.matrix(points.u, 1) @ control_points[:, :3]
    return float(np.sqrt(np.mean(_squares_across(off, slopes))))


def follows(points: CentrelinePoints, control_points: FloatArray, length: float) -> bool:
    """Whether a spline follows the DLO as well as it was measured, or so well that no more matters.

    Args:
        points: measured on the DLO.
        control_points: x, y, z (and theta) [m], shape (n, 3 or 4).
        length: L [m].
    """
    noise = float(np.sqrt(np.mean(points.std**2)))
    allowed = max(FOLLOWED * length, BEYOND_NOISE * noise)
    return misfit(points, control_points, length) <= allowed


def enough_control_points(points: CentrelinePoints, length: float) -> int:
    """The least number of control points of a spline that follows the DLO.

    Args:
        points: measured on the DLO.
        length: L [m].

    Raises:
        VisionError: too few points to decide, or MOST_CONTROL_POINTS would not do.
    """
    n = ORDER
    while n <= min(MOST_CONTROL_POINTS, len(points.u) // 2):
        spline = SplineBasis(n, length).fit(points.u, points.positions, _weights(points))
        if follows(points, spline, length):
            return n
        n = max(n + 1, round(GROWTH * n))
    raise VisionError(
        f"no spline of up to {MOST_CONTROL_POINTS} control points follows the measured points"
    )


def _squares_across(off: FloatArray, slopes: FloatArray) -> FloatArray:
    """Squared lengths across a curve, where alone a DLO is measured [m^2], shape (m,).

    Args:
        off: vectors from the curve's points [m], shape (m, 3).
        slopes: derivatives of the curve there, shape (m, 3).
    """
    tangent = slopes / np.maximum(np.linalg.norm(slopes, axis=1), 1e-12)[:, None]
    across = off - np.sum(off * tangent, axis=1)[:, None] * tangent
    return np.asarray(np.sum(across**2, axis=1))


def _weights(points: CentrelinePoints) -> FloatArray:
    weights = 1.0 / np.maximum(points.std, 1e-9) ** 2
    return np.asarray(weights / np.median(weights))


def _solve(b: FloatArray, positions: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted least-squares control points, shape (n, 3)."""
    weighted = b * weights[:, None]
    normal = weighted.T @ b
    # Second differences of the control points decide where no points were seen.
    n = b.shape[1]
    difference = np.diff(np.eye(n), 2, axis=0)
    normal += RIDGE * float(np.trace(normal)) / n * (difference.T @ difference)
    return np.asarray(np.linalg.solve(normal, weighted.T @ positions))
