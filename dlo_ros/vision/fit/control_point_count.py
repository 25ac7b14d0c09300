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
    xz = points.positions[:, [0, 2]]
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
            fitted = _solve(b[kept], xz[kept], weights[kept])
            predicted = b[~kept] @ fitted
            # Only what lies across the DLO was measured.
            tangent = basis.matrix(points.u[~kept], 1) @ fitted
            tangent /= np.maximum(np.hypot(*tangent.T), 1e-12)[:, None]
            off = xz[~kept] - predicted
            squares[~kept] = (tangent[:, 0] * off[:, 1] - tangent[:, 1] * off[:, 0]) ** 2
        squares *= weights
        # A few wrong points must not choose.
        limit = 9.0 * float(np.median(squares)) / 0.455
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
    tangent = basis.matrix(points.u, 1) @ control_points[:, :3]
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    off -= np.sum(off * tangent, axis=1)[:, None] * tangent
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


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


def _weights(points: CentrelinePoints) -> FloatArray:
    weights = 1.0 / np.maximum(points.std, 1e-9) ** 2
    return np.asarray(weights / np.median(weights))


def _solve(b: FloatArray, xz: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted least-squares control points, shape (n, 2)."""
    weighted = b * weights[:, None]
    normal = weighted.T @ b
    # Second differences of the control points decide where no points were seen.
    n = b.shape[1]
    difference = np.diff(np.eye(n), 2, axis=0)
    normal += RIDGE * float(np.trace(normal)) / n * (difference.T @ difference)
    return np.asarray(np.linalg.solve(normal, weighted.T @ xz))
