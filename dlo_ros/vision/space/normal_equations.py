# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Normal equations of a spline in space: weighted rows are summed as they come.

A row is the derivative of an observation by the unknowns. That by the control points is given as
its factors, the basis functions, of which four differ from zero, and a direction in space.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
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

    def add(
        self,
        basis: FloatArray,
        direction: FloatArray,
        residual: FloatArray,
        weight: FloatArray,
        others: FloatArray | None = None,
    ) -> None:
        """Add observations of `direction . (basis @ points)`, and of other unknowns.

        Args:
            basis: values of the basis functions, shape (m, k).
            direction: shape (m, 3).
            residual: shape (m,).
            weight: weight of each observation, one over its variance, shape (m,).
            others: derivatives of the residuals by the first of the other unknowns, shape (m, at
                most all); None: they do not matter.
        """
        if others is None:
            others = np.empty((len(basis), 0))
        _add_rows(self.matrix, self.right, basis, direction, others, residual, weight)

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


@njit()
def _add_rows(
    matrix: FloatArray,
    right: FloatArray,
    basis: FloatArray,
    direction: FloatArray,
    others: FloatArray,
    residual: FloatArray,
    weight: FloatArray,
) -> None:
    """Add weighted rows to a normal matrix and its right side, where they differ from zero."""
    count, k = basis.shape
    row = np.empty(3 * k + others.shape[1])
    index = np.empty(len(row), dtype=np.int64)
    for i in range(count):
        size = 0
        for j in range(k):
            if basis[i, j] != 0.0:
                for c in range(3):
                    row[size] = basis[i, j] * direction[i, c]
                    index[size] = 3 * j + c
                    size += 1
        for j in range(others.shape[1]):
            row[size] = others[i, j]
            index[size] = 3 * k + j
            size += 1
        for a in range(size):
            weighted = weight[i] * row[a]
            right[index[a]] -= weighted * residual[i]
            for b in range(size):
                matrix[index[a], index[b]] += weighted * row[b]


@njit()
def leverage(
    basis: FloatArray, direction: FloatArray, weight: FloatArray, covariance: FloatArray
) -> float:
    """Sum over rows of their weight times the variance of what they observe.

    Args:
        basis: values of the basis functions, shape (m, k).
        direction: shape (m, 3).
        weight: shape (m,).
        covariance: covariance of the control points [m^2], shape (3 k, 3 k).
    """
    total = 0.0
    k = basis.shape[1]
    for i in range(len(basis)):
        variance = 0.0
        for a in range(k):
            if basis[i, a] == 0.0:
                continue
            for b in range(k):
                if basis[i, b] == 0.0:
                    continue
                between = 0.0
                for c in range(3):
                    for d in range(3):
                        between += (
                            direction[i, c] * covariance[3 * a + c, 3 * b + d] * direction[i, d]
                        )
                variance += basis[i, a] * basis[i, b] * between
        total += weight[i] * variance
    return total


@njit()
def mirrored(lower: FloatArray) -> FloatArray:
    """The symmetric matrix of which the lower triangle is given."""
    size = len(lower)
    result = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            result[i, j] = result[j, i] = lower[i, j]
    return result
