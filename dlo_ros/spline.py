# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The clamped uniform cubic B-spline that describes a DLO's shape (paper, eqs. (1) and (2)).

n control points and the length L fix the basis, so a shape travels as its control points alone.
Control points of several coordinates are stored as arrays of shape (n, d), one row a control point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from dlo_ros.errors import InputError

FloatArray = NDArray[np.float64]

DEGREE = 3
ORDER = DEGREE + 1


@lru_cache(maxsize=8)
def _gauss(points: int) -> tuple[FloatArray, FloatArray]:
    """Abscissae and weights of the Gauss-Legendre rule on [-1, 1]."""
    return np.polynomial.legendre.leggauss(points)


@dataclass(frozen=True)
class SplineBasis:
    """Clamped uniform cubic B-spline basis over the material coordinate u in [0, L].

    Args:
        control_points: number n of control points, at least 4.
        length: L [m], positive and finite.
        halvings: how often the knot span at either end is halved, each time the part at the end.

    Raises:
        InputError: fewer than four control points or a length that is not positive.
    """

    control_points: int
    length: float
    halvings: int = 0

    def __post_init__(self) -> None:
        if self.control_points < ORDER:
            raise InputError(
                f"control_points is {self.control_points}; a cubic spline needs at least {ORDER}"
            )
        if not (np.isfinite(self.length) and self.length > 0.0):
            raise InputError(f"length is {self.length} m; it must be positive and finite")

    @property
    def spans(self) -> int:
        """Number of knot spans, n - 3."""
        return self.control_points - DEGREE

    @property
    def even_spans(self) -> int:
        """Number of knot spans before those at the ends are halved."""
        return self.spans - 2 * self.halvings

    @property
    def span_length(self) -> float:
        """Length of one knot span that is not halved [m]."""
        return self.length / self.even_spans

    @cached_property
    def breaks(self) -> FloatArray:
        """Ends of the knot spans, shape (spans + 1,) [m]."""
        even = np.linspace(0.0, self.length, self.even_spans + 1)
        parts = even[1] * 0.5 ** np.arange(self.halvings, 0, -1)
        return np.concatenate([even[:1], parts, even[1:-1], self.length - parts[::-1], even[-1:]])

    @cached_property
    def knots(self) -> FloatArray:
        """Knot vector, shape (n + 4,) [m]."""
        return np.concatenate([np.zeros(DEGREE), self.breaks, np.full(DEGREE, self.length)])

    def span_of(self, u: ArrayLike) -> NDArray[np.int64]:
        """Number of the knot span in which each u [m] lies."""
        return np.clip(np.searchsorted(self.breaks, u, side="right") - 1, 0, self.spans - 1)

    @cached_property
    def greville(self) -> FloatArray:
        """Greville abscissae of the control points, shape (n,) [m]."""
        k = self.knots
        result: FloatArray = (k[1:-3] + k[2:-2] + k[3:-1]) / 3.0
        return result

    def matrix(self, u: ArrayLike, derivative: int = 0) -> FloatArray:
        """Basis functions or their derivatives at u.

        Args:
            u: material coordinates [m], shape (m,); values outside [0, L] are clipped to it.
            derivative: 0 to 3.

        Returns:
            Matrix of shape (m, n): `matrix(u) @ control_points` evaluates the spline.
        """
        u = np.clip(np.atleast_1d(np.asarray(u, dtype=np.float64)), 0.0, self.length)
        if u.size == 0:
            return np.zeros((0, self.control_points))
        if derivative == 0:
            return np.asarray(BSpline.design_matrix(u, self.knots, DEGREE).toarray())
        spline = BSpline(self.knots, np.eye(self.control_points), DEGREE)
        return np.asarray(spline.derivative(derivative)(u))

    @lru_cache(maxsize=64)  # noqa: B019 - a basis is two numbers, and equal ones share the entry
    def grid(self, count: int, derivative: int = 0) -> FloatArray:
        """Basis functions or their derivatives at equal steps of u from 0 to L, kept.

        Args:
            count: number of places m, both ends counted.
            derivative: 0 to 3.

        Returns:
            Matrix of shape (m, n), read-only.
        """
        result = self.matrix(np.linspace(0.0, self.length, count), derivative)
        result.flags.writeable = False
        return result

    @lru_cache(maxsize=256)  # noqa: B019 - see `grid`
    def row(self, u: float) -> FloatArray:
        """Basis functions at u [m], kept, shape (n,), read-only."""
        result: FloatArray = self.matrix(u)[0]
        result.flags.writeable = False
        return result

    def evaluate(self, control_points: FloatArray, u: ArrayLike, derivative: int = 0) -> FloatArray:
        """Value (or derivative) of the spline at u, shape (m, d)."""
        return self.matrix(u, derivative) @ control_points

    @lru_cache(maxsize=64)  # noqa: B019 - see `grid`
    def quadrature(self, points: int = ORDER) -> tuple[FloatArray, FloatArray]:
        """Gauss-Legendre rule on every knot span, kept.

        Args:
            points: points per span; the default integrates products of two basis functions exactly.

        Returns:
            Abscissae u [m] and weights [m], each of shape (spans * points,), read-only.
        """
        x, w = _gauss(points)
        # Differences of equal steps would differ by rounding.
        widths = np.diff(self.breaks) if self.halvings else np.full(self.spans, self.span_length)
        left, h = self.breaks[:-1, None], widths[:, None]
        u, weight = (left + 0.5 * h * (x + 1.0)).ravel(), (0.5 * h * w).ravel()
        u.flags.writeable = weight.flags.writeable = False
        return u, weight

    @cached_property
    def gram(self) -> FloatArray:
        """Integral of b_i b_j over [0, L], shape (n, n) [m] (eq. (5) without J)."""
        u, w = self.quadrature()
        b = self.matrix(u)
        return b.T @ (w[:, None] * b)

    @cached_property
    def shares(self) -> FloatArray:
        """Integrals of the basis functions over [0, L], shape (n,) [m]."""
        result: FloatArray = self.gram.sum(axis=1)
        return result

    @lru_cache(maxsize=64)  # noqa: B019 - a basis is two numbers, and equal ones share the entry
    def projection(self, source: SplineBasis) -> FloatArray:
        """Least-squares projection of splines in another basis onto this one, both ends kept.

        Args:
            source: basis of the same length.

        Returns:
            Matrix of shape (n, source.control_points).
        """
        halvings = max(self.halvings, source.halvings)
        spans = 2 * max(self.even_spans, source.even_spans) + 2 * halvings
        u, w = SplineBasis(spans + DEGREE, self.length, halvings).quadrature()
        b, s = self.matrix(u), source.matrix(u)
        n = self.control_points
        result = np.zeros((n, source.control_points))
        result[0, 0] = 1.0
        result[-1, -1] = 1.0
        inner = b[:, 1:-1]
        rest = s - b[:, [0]] * result[0] - b[:, [-1]] * result[-1]
        normal = cho_factor(inner.T @ (w[:, None] * inner))
        result[1:-1] = cho_solve(normal, inner.T @ (w[:, None] * rest))
        result.flags.writeable = False
        return result

    def fit(self, u: ArrayLike, points: FloatArray, weights: ArrayLike | None = None) -> FloatArray:
        """Least-squares spline through points at known u (a trace of smoothing bridges gaps).

        Args:
            u: material coordinates [m], shape (m,).
            points: shape (m, d).
            weights: weight of each point, shape (m,); default 1.

        Returns:
            Control points, shape (n, d).
        """
        b = self.matrix(u)
        w = np.ones(b.shape[0]) if weights is None else np.asarray(weights, dtype=np.float64)
        return self.least_squares(b, points, w)

    def fit_grid(self, points: FloatArray, weights: FloatArray) -> FloatArray:
        """Least-squares spline through points at equal steps of u from 0 to L; see `fit`."""
        return self.least_squares(self.grid(len(points)), points, weights)

    @cached_property
    def _bending(self) -> FloatArray:
        """Integral of the products of second derivatives times L^3, shape (n, n)."""
        u, w = self.quadrature(2)
        curvature = self.matrix(u, 2)
        return curvature.T @ (w[:, None] * curvature) * self.length**3

    def least_squares(self, b: FloatArray, points: FloatArray, weights: FloatArray) -> FloatArray:
        """Least-squares spline through points where the basis functions are known; see `fit`.

        Args:
            b: basis functions at the points, from `matrix`, shape (m, n).
            points: shape (m, d).
            weights: weight of each point, shape (m,).

        Returns:
            Control points, shape (n, d).
        """
        smooth = self._bending
        normal = b.T @ (weights[:, None] * b)
        normal += 1e-9 * np.trace(normal) / np.trace(smooth) * smooth
        return np.asarray(np.linalg.solve(normal, b.T @ (weights[:, None] * points)))
