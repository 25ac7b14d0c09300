# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Lens distortion and its inverse, compiled: the observer undoes it for every measured point."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray

NEWTON_STEPS = 8
CONVERGED = 1e-12  # of normalised image coordinates
SINGULAR = 1e-9  # determinant of the Jacobian below which the distortion cannot be undone


@njit()
def distort(points: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Distorted normalised image points (OpenCV's rational model with thin prism).

    Args:
        points: ideal normalised image points, shape (m, 2).
        coefficients: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4.

    Returns:
        Shape (m, 2).
    """
    result = np.empty_like(points)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        value = _evaluate(x, y, coefficients)
        result[i, 0], result[i, 1] = value[0], value[1]
    return result


@njit()
def undistort(points: FloatArray, coefficients: FloatArray, tolerance: float) -> FloatArray:
    """Inverse of `distort` by Newton's method.

    Args:
        points: distorted normalised image points, shape (m, 2).
        coefficients: distortion coefficients as in `distort`.
        tolerance: largest error after distorting again; a point that misses it is NaN.

    Returns:
        Shape (m, 2).
    """
    result = np.empty_like(points)
    for i in range(len(points)):
        u, v = points[i, 0], points[i, 1]
        x, y = u, v
        for _ in range(NEWTON_STEPS):
            dx, dy, a, b, c, d = _evaluate(x, y, coefficients)
            dx -= u
            dy -= v
            if abs(dx) <= CONVERGED and abs(dy) <= CONVERGED:
                break
            determinant = a * d - b * c
            if abs(determinant) < SINGULAR:
                x = np.nan
                break
            x -= (d * dx - b * dy) / determinant
            y -= (a * dy - c * dx) / determinant
        value = _evaluate(x, y, coefficients)
        if abs(value[0] - u) < tolerance and abs(value[1] - v) < tolerance:
            result[i, 0], result[i, 1] = x, y
        else:
            result[i, 0] = result[i, 1] = np.nan
    return result


@njit(from_python=False, error_model="numpy")
def _evaluate(
    x: float, y: float, coefficients: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Distorted point and the Jacobian, row by row."""
    k1, k2, p1, p2 = coefficients[0], coefficients[1], coefficients[2], coefficients[3]
    k3, k4, k5, k6 = coefficients[4], coefficients[5], coefficients[6], coefficients[7]
    s1, s2, s3, s4 = coefficients[8], coefficients[9], coefficients[10], coefficients[11]
    r2 = x * x + y * y
    upper = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    lower = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = upper / lower
    # Derivative of the radial factor by r^2.
    slope = (
        (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)) - radial * (k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6))
    ) / lower
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4)
    prism_u, prism_v = s1 + 2.0 * r2 * s2, s3 + 2.0 * r2 * s4
    ux = radial + 2.0 * x * (x * slope + prism_u) + 2.0 * p1 * y + 6.0 * p2 * x
    uy = 2.0 * y * (x * slope + prism_u) + 2.0 * p1 * x + 2.0 * p2 * y
    vx = 2.0 * x * (y * slope + prism_v) + 2.0 * p1 * x + 2.0 * p2 * y
    vy = radial + 2.0 * y * (y * slope + prism_v) + 6.0 * p1 * y + 2.0 * p2 * x
    return u, v, ux, uy, vx, vy
