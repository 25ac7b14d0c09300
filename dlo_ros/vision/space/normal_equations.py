# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Normal equations of a spline in space: weighted rows are summed as they come."""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray


class SplineNormalEquations:
    """Sums of weighted rows; the unknowns are x y z of each control point, and others after them.

    Args:
        control_points: k.
        others: numbers besides.
    """

    def __init__(self, control_points: int, others: int) -> None:
        size = 3 * control_points + others
        self.matrix = np.zeros((size, size))
        self.right = np.zeros(size)

    def add(self, rows: FloatArray, residual: FloatArray, weight: FloatArray) -> None:
        """Add observations.

        Args:
            rows: derivatives of the residuals by the first unknowns, shape (m, at most all)
            residual: shape (m,).
            weight: weight of each observation, one over its variance, shape (m,).
        """
        size = rows.shape[1]
        weighted = rows * weight[:, None]
        self.matrix[:size, :size] += weighted.T @ rows
        self.right[:size] -= weighted.T @ residual

    def add_prior(self, first: int, values: FloatArray, std: float) -> None:
        """Add that unknowns are 0 to within a std.

        Args:
            first: index of the first one.
            values: present values of the unknowns, shape (m,).
            std: standard deviation of each unknown.
        """
        own = np.arange(first, first + len(values))
        self.matrix[own, own] += std**-2
        self.right[own] -= values * std**-2

    def add_roughness(
        self, derivative: FloatArray, points: FloatArray, weight: float, stretch: int
    ) -> None:
        """Add that a derivative vanishes in all three coordinates, per stretched length.

        Without the latter a rough curve would be held for shorter than it is: all its derivatives
        shrink with it.

        Args:
            derivative: matrix that gives the spline's derivative from its control points, shape (m,
                k).
            points: control points [m], shape (k, 3).
            weight: weight of each row, one over the variance.
            stretch: index of the unknown stretch.
        """
        square = weight * (derivative.T @ derivative)
        rough = derivative @ points
        for axis in range(3):
            own = slice(axis, 3 * len(points), 3)
            pull = square @ points[:, axis]
            size = weight * float(rough[:, axis] @ rough[:, axis])
            self.matrix[own, own] += square
            self.matrix[own, stretch] -= pull
            self.matrix[stretch, own] -= pull
            self.matrix[stretch, stretch] += size
            self.right[own] -= pull
            self.right[stretch] += size


def rows_of(b: FloatArray, direction: FloatArray) -> FloatArray:
    """Derivative of direction . (b @ points) by the points.

    Args:
        b: values of the basis, shape (m, k).
        direction: shape (m, 3).

    Returns:
        Shape (m, 3 k).
    """
    return np.asarray((b[:, :, None] * direction[:, None, :]).reshape(len(b), -1))
