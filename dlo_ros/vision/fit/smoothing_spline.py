# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Smoothing spline through measured points of a curve, with gaps bridged at minimum bending.

A P-spline (Eilers and Marx, Statist. Sci. 11, 1996): uniform cubic B-splines whose second
differences are penalised, solved in the band. The penalty is so small that it acts in gaps only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import DEGREE, FloatArray
from dlo_ros.vision.segmentation.medians import median

PENALTY = 1e-6
HUBER = 1.5
ROUNDS = 4


@dataclass(frozen=True, eq=False)
class SmoothCurve:
    """A fitted curve over a parameter p, shape of values (m, d)."""

    knots: FloatArray
    coefficients: FloatArray

    def __call__(self, p: FloatArray, derivative: int = 0) -> FloatArray:
        """Values (or first derivatives) at p; beyond the knots its last pieces go on."""
        first, basis = _basis(np.asarray(p, dtype=np.float64), self.knots, derivative)
        return np.asarray(_combined(first, basis, self.coefficients))


@dataclass(frozen=True, eq=False)
class Support:
    """Knowledge of an end besides the points: a value and a derivative, with weights."""

    p: float
    value: FloatArray
    value_weight: float
    slope: FloatArray | None = None
    slope_weight: float = 0.0


def smooth(
    p: FloatArray,
    points: FloatArray,
    span: float,
    domain: tuple[float, float],
    supports: tuple[Support, ...] = (),
    trust: FloatArray | None = None,
) -> tuple[SmoothCurve, FloatArray]:
    """Robust spline through points (Huber weights).

    Args:
        p: parameters of the points, within the domain, shape (m,).
        points: shape (m, d).
        span: distance of the knots, in p.
        domain: interval on which the curve is wanted.
        supports: known ends. Their weights count in points of unit weight.
        trust: weight of each point before outliers are weighed down, shape (m,); default 1. The
            scatter is judged by the points of weight 1.

    Returns:
        The curve and the weights of the points, at most 1, shape (m,).
    """
    low, high = domain
    spans = max(1, round((high - low) / span))
    step = (high - low) / spans
    knots: FloatArray = low + step * np.arange(-DEGREE, spans + DEGREE + 1.0)
    count = spans + DEGREE
    first, basis = _basis(p, knots, 0)
    points = np.ascontiguousarray(points, dtype=np.float64)
    base = np.ones(len(p)) if trust is None else trust
    judged = base >= 1.0
    weights = np.ones(len(p))
    curve = SmoothCurve(knots, np.zeros((count, points.shape[1])))
    for _ in range(ROUNDS):
        bands = np.zeros((DEGREE + 1, count))
        right = np.zeros((count, points.shape[1]))
        _add(bands, right, first, basis, base * weights, points)
        scale = max(float(np.max(bands[0])), 1e-12)
        for support in supports:
            at = np.array([support.p])
            f, b = _basis(at, knots, 0)
            _add(
                bands,
                right,
                f,
                b,
                np.array([support.value_weight]),
                np.ascontiguousarray(support.value[None], dtype=np.float64),
            )
            if support.slope is not None:
                _, d = _basis(at, knots, 1)
                _add(
                    bands,
                    right,
                    f,
                    d,
                    np.array([support.slope_weight]),
                    np.ascontiguousarray(support.slope[None], dtype=np.float64),
                )
        _penalise(bands, PENALTY * scale)
        curve = SmoothCurve(knots, np.ascontiguousarray(solveh_banded(bands, right, lower=True)))
        distance = _distances(first, basis, curve.coefficients, points)
        spread = 1.4826 * median(distance[judged]) / 0.9  # of one component, roughly
        limit = HUBER * max(spread, 1e-12)
        new = np.where(distance > limit, limit / np.maximum(distance, 1e-300), 1.0)
        if np.max(np.abs(new - weights), initial=0.0) < 0.05:
            break
        weights = new
    return curve, weights


@njit()
def _basis(
    p: FloatArray, knots: FloatArray, derivative: int
) -> tuple[NDArray[np.int64], FloatArray]:
    """First non-zero B-spline and the four values (or first derivatives) for each p.

    The knots are uniform.
    """
    step = knots[1] - knots[0]
    last = len(knots) - 2 * DEGREE - 2
    cell = np.empty(len(p), dtype=np.int64)
    values = np.empty((len(p), DEGREE + 1))
    for i in range(len(p)):
        x = (p[i] - knots[DEGREE]) / step
        cell[i] = min(max(int(math.floor(x)), 0), last)  # noqa: RUF046 (numba: a float)
        t = x - cell[i]
        if derivative == 0:
            values[i, 0] = (1 - t) ** 3 / 6
            values[i, 1] = (3 * t**3 - 6 * t**2 + 4) / 6
            values[i, 2] = (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6
            values[i, 3] = t**3 / 6
        else:
            values[i, 0] = -((1 - t) ** 2) / (2 * step)
            values[i, 1] = (3 * t**2 - 4 * t) / (2 * step)
            values[i, 2] = (-3 * t**2 + 2 * t + 1) / (2 * step)
            values[i, 3] = t**2 / (2 * step)
    return cell, values


@njit()
def _combined(cell: NDArray[np.int64], basis: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Sums of the B-splines of `_basis` with coefficients, shape (m, d)."""
    result = np.zeros((len(cell), coefficients.shape[1]))
    for i in range(len(cell)):
        for a in range(DEGREE + 1):
            for d in range(coefficients.shape[1]):
                result[i, d] += basis[i, a] * coefficients[cell[i] + a, d]
    return result


@njit()
def _add(
    bands: FloatArray,
    right: FloatArray,
    cell: NDArray[np.int64],
    basis: FloatArray,
    weights: FloatArray,
    values: FloatArray,
) -> None:
    """Add weighted observation equations to the lower bands of the normal matrix."""
    for i in range(len(cell)):
        for a in range(DEGREE + 1):
            k = cell[i] + a
            weighted = weights[i] * basis[i, a]
            for b in range(a, DEGREE + 1):
                bands[b - a, k] += weighted * basis[i, b]
            for d in range(right.shape[1]):
                right[k, d] += weighted * values[i, d]


@njit()
def _distances(
    cell: NDArray[np.int64], basis: FloatArray, coefficients: FloatArray, points: FloatArray
) -> FloatArray:
    """Distances of points from the curve at their parameters, shape (m,)."""
    result = np.empty(len(cell))
    for i in range(len(cell)):
        square = 0.0
        for d in range(points.shape[1]):
            value = -points[i, d]
            for a in range(DEGREE + 1):
                value += basis[i, a] * coefficients[cell[i] + a, d]
            square += value * value
        result[i] = math.sqrt(square)
    return result


def _penalise(bands: FloatArray, amount: float) -> None:
    """Add the squared second differences of the coefficients."""
    count = bands.shape[1]
    rows = max(count - 2, 0)
    difference = (1.0, -2.0, 1.0)
    for a in range(3):
        for b in range(a, 3):
            bands[b - a, a : a + rows] += amount * difference[a] * difference[b]
