# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A curve of known length through scattered points, which of them lie beside it, and how well it
is known.

Each point pulls its foot point on the curve at right angles (tangent distance minimisation; Wang,
Pottmann and Liu, Fitting B-spline curves to point clouds, ACM Transactions on Graphics 25, 2006),
with weights that vanish for points far away (Geman and McClure). Along itself the curve is held by
what is known of the DLO: it does not stretch, and u = 0 lies in the grip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.space.spatial_clamps import Clamps

LENGTH_STD = 0.005  # of L: error of the length and of the tracker's scale
STRETCH_STD = 0.01  # scatter of the stretch from knot span to knot span
GRIP_STD = 0.005  # [L] of a grip along the DLO, the usual tolerance of clamp_offset
GRIP_STD_ACROSS = 0.01  # [L] wider across it, where the points are more accurate than the grip
DIRECTION_STD = 0.1  # [rad] of a grip, twice the usual tolerance of clamp_angle
SHARPEST = 40.0  # [1/L] usual curvature of what is bent sharply
USUAL_CURVATURE = 6.0  # [1/L] of a DLO, by which courses that fit alike are distinguished,
USUAL_BEND = 0.1  # [L] over so much of it
ALONG_WEIGHT = 1e-4  # of deviations along the curve, which mean nothing where u is not given
TIP_POINTS = 2.0  # mean distances of neighbours: so far a free end may lie beyond the last point
GROSS = 3.5  # [std] beyond which a point lies beside the DLO
LEAST_STD = 1e-5  # [L] standard deviation of points, below which rounding would count as noise
STEPS = 40
SETTLED = 0.02  # [std] a step that changes less ends the search
FOOT_POINTS = 12  # places per knot span between which foot points are looked for
MEDIAN = {1: 0.6745, 2: 1.1774, 3: 1.5382}
"""Median length of a standard normal vector of so many components."""


@dataclass(frozen=True, eq=False)
class PointCurve:
    """A fitted curve.

    Args:
        basis: spline basis of the curve.
        control_points: [m], shape (k, 3).
        u: material coordinate of each point [m], shape (m,).
        across: distance of each point from the curve [m], shape (m,).
        std: standard deviation of each point's coordinates [m], shape (m,).
        std_along: standard deviation of each point's u [m], shape (m,).
        inside: whether a point belongs to the DLO, shape (m,).
        stretch: length of the curve over L.
        likelihood: logarithm of that of the points, with a prior that prefers smooth curves.
        correlation: correlation of neighbouring points' offsets from the curve; 0 where they only
            scatter.
    """

    basis: SplineBasis
    control_points: FloatArray
    u: FloatArray
    across: FloatArray
    std: FloatArray
    std_along: FloatArray
    inside: NDArray[np.bool_]
    stretch: float
    likelihood: float
    correlation: float


def fit_curve(
    points: FloatArray,
    basis: SplineBasis,
    first: FloatArray,
    grips: Clamps,
    *,
    std: FloatArray | None = None,
    known: FloatArray | None = None,
    reach: float,
) -> PointCurve:
    """Fit the curve.

    Args:
        points: [m], shape (m, 3); in the plane y = 0 where all have y = 0.
        basis: spline basis of the curve.
        first: control points to begin with [m], shape (k, 3).
        grips: poses of the grips at u = 0 and u = L; None: that end is free.
        std: standard deviation of each coordinate of the points [m], shape (m,); None: estimated
            from what is left over, alike for all. It is scaled up where what is left over is more.
        known: material coordinates of the points [m], shape (m,); None: found.
        reach: distance from the curve at the beginning up to which points pull [m].

    Raises:
        VisionError: the points determine no curve.
    """
    fit = _Fit(points, basis, grips, std, known)
    q, spread = first, reach
    for _ in range(STEPS):
        u, away, tangent = fit.foot_points(q)
        found = fit.spread(away, spread)
        spread = max(found, 0.6 * spread)
        weight = 1.0 / (1.0 + (away / (2.0 * spread * fit.relative)) ** 2) ** 2
        fit.find_tips(q, u, weight, spread)
        normal, right = fit.equations(q, u, tangent, weight / (spread * fit.relative) ** 2)
        new = _solved(normal, right).reshape(-1, fit.dimensions)
        new = new if fit.dimensions == 3 else np.insert(new, 1, 0.0, axis=1)
        moved = float(np.abs(new - q).max())
        q = new
        if moved < SETTLED * spread and spread <= 1.05 * found:
            break
    return fit.result(q, spread)


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(cho_solve(cho_factor(normal), right))
    except (np.linalg.LinAlgError, ValueError) as err:
        raise VisionError("the points determine no curve") from err


class _Fit:
    """The points, and what is known besides, as equations for the control points."""

    def __init__(
        self,
        points: FloatArray,
        basis: SplineBasis,
        grips: Clamps,
        std: FloatArray | None,
        known: FloatArray | None,
    ) -> None:
        self.points, self.basis, self.grips, self.known = points, basis, grips, known
        self.axes = [0, 1, 2] if np.any(points[:, 1]) else [0, 2]
        self.dimensions = len(self.axes)
        self.stated = None if std is None else np.maximum(std, LEAST_STD * basis.length)
        usual = 1.0 if self.stated is None else float(np.median(self.stated))
        self.relative = (
            np.ones(len(points)) if self.stated is None else np.asarray(self.stated / usual)
        )
        self.least = LEAST_STD * basis.length if self.stated is None else usual
        # Components in which a point lies off the curve.
        self.free = self.dimensions - (known is None)
        self._dense = np.linspace(0.0, basis.length, FOOT_POINTS * basis.spans + 1)
        self._values = basis.matrix(self._dense)
        self._quadrature, self._weights = basis.quadrature(2)
        self._slopes = basis.matrix(self._quadrature, 1)
        self._bending = basis.matrix(self._quadrature, 2)
        self._tips: list[FloatArray] = []
        self._tip_std = 0.0
        self._at_points = None if known is None else basis.matrix(known)

    def foot_points(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Material coordinates, distances and tangents of the foot points.

        Beyond a free end the distance is that from the end itself; the tangent is then zero.
        """
        if self.known is not None and self._at_points is not None:
            u = self.known
            gap = self.points - self._at_points @ q
            return u, np.linalg.norm(gap, axis=1), np.zeros_like(gap)
        curve = self._values @ q
        nearest = cKDTree(curve).query(self.points)[1]
        low = np.clip(nearest - 1, 0, len(curve) - 2)
        u, best = np.zeros(len(nearest)), np.full(len(nearest), np.inf)
        for segment in (low, np.minimum(low + 1, len(curve) - 2)):
            a, along = curve[segment], curve[segment + 1] - curve[segment]
            size = np.maximum(np.sum(along**2, axis=1), 1e-30)
            share = np.clip(np.sum((self.points - a) * along, axis=1) / size, 0.0, 1.0)
            away = np.linalg.norm(self.points - a - share[:, None] * along, axis=1)
            at = self._dense[segment] + share * (self._dense[1] - self._dense[0])
            u = np.where(away < best, at, u)
            best = np.minimum(away, best)
        tangent = self.basis.evaluate(q, u, 1)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        gap = self.points - self.basis.evaluate(q, u)
        along = np.sum(gap * tangent, axis=1)
        beyond = ((u <= 0.0) & (along < 0.0)) | ((u >= self.basis.length) & (along > 0.0))
        tangent = np.where(beyond[:, None], 0.0, tangent)
        away = np.where(beyond, np.linalg.norm(gap, axis=1), best)
        return u, away, tangent

    def spread(self, away: FloatArray, before: float) -> float:
        """Standard deviation of the points' coordinates [m], for a point of usual std."""
        share = away / self.relative
        near = share[share < 3.0 * GROSS * before]
        if len(near) < 4:
            return before
        return max(float(np.median(near)) / MEDIAN[self.free], self.least)

    def find_tips(self, q: FloatArray, u: FloatArray, weight: FloatArray, spread: float) -> None:
        """Where both ends are free, place them at the outermost points."""
        if any(self.grips) or self.known is not None:
            return
        near = np.flatnonzero(weight > 0.25)
        if len(near) < 4:
            return
        length = self.basis.length
        order = near[np.argsort(u[near])]
        hidden = max(length - float(u[order[-1]] - u[order[0]]), 0.0)
        self._tip_std = float(np.hypot(max(TIP_POINTS * length / len(near), 0.5 * hidden), spread))
        self._tips = [self.points[order[0]][self.axes], self.points[order[-1]][self.axes]]

    def equations(
        self, q: FloatArray, u: FloatArray, tangent: FloatArray, precision: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Normal matrix and right-hand side for the control points, flat."""
        axes, d = self.axes, self.dimensions
        b = self.basis.matrix(u) if self._at_points is None else self._at_points
        t = tangent[:, axes]
        project = np.eye(d) - (1.0 - ALONG_WEIGHT) * t[:, :, None] * t[:, None, :]
        project *= precision[:, None, None]
        k = b.shape[1]
        normal = np.einsum("mi,mj,mab->iajb", b, b, project, optimize=True)
        right = np.einsum("mi,mab,mb->ia", b, project, self.points[:, axes], optimize=True)
        slope = self._slopes @ q[:, axes]
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        rows = np.einsum("qi,qa->qia", self._slopes, slope / np.maximum(size, 1e-12))
        length, weight = self.basis.length, self._weights
        local = weight / self.basis.span_length / STRETCH_STD**2
        normal += np.einsum("q,qia,qjb->iajb", local, rows, rows, optimize=True)
        right += np.einsum("q,qia->ia", local, rows)
        whole = np.einsum("q,qia->ia", weight / length, rows)
        normal += np.einsum("ia,jb->iajb", whole, whole) / LENGTH_STD**2
        right += whole / LENGTH_STD**2
        bent = self._bending.T @ (weight[:, None] * self._bending)
        bent *= (length / SHARPEST) ** 2 / self.basis.span_length
        for a in range(d):
            normal[:, a, :, a] += bent
        self._add_grips(q, normal, right)
        return normal.reshape(k * d, k * d), right.ravel()

    def _add_grips(self, q: FloatArray, normal: FloatArray, right: FloatArray) -> None:
        length = self.basis.length
        for tip, at in zip(self._tips, (0.0, length), strict=False):
            value, slope = self.basis.matrix([at])[0], self.basis.matrix([at], 1)[0]
            t = (slope @ q)[self.axes]
            tie = np.outer(t, t) / max(float(t @ t), 1e-12) / self._tip_std**2
            normal += np.einsum("i,j,ab->iajb", value, value, tie)
            right += np.outer(value, tie @ tip)
        for grip, at in zip(self.grips, (0.0, length), strict=True):
            if grip is None:
                continue
            value, slope = self.basis.matrix([at])[0], self.basis.matrix([at], 1)[0]
            t = (slope @ q)[self.axes]
            t /= max(float(np.linalg.norm(t)), 1e-12)
            across = np.eye(len(t)) - np.outer(t, t)
            tie = np.outer(t, t) / (GRIP_STD * length) ** 2
            tie += across / (GRIP_STD_ACROSS * length) ** 2
            normal += np.einsum("i,j,ab->iajb", value, value, tie)
            right += np.outer(value, tie @ grip.position[self.axes])
            if grip.direction is not None:
                turn = np.eye(len(t)) / DIRECTION_STD**2
                normal += np.einsum("i,j,ab->iajb", slope, slope, turn)
                right += np.outer(slope, turn @ grip.direction[self.axes])

    def result(self, q: FloatArray, spread: float) -> PointCurve:
        """The curve with standard deviations, from what the points inside leave over."""
        u, away, tangent = self.foot_points(q)
        inside = away < GROSS * spread * self.relative
        for _ in range(3):
            precision = inside / (spread * self.relative) ** 2
            normal, _ = self.equations(q, u, tangent, precision)
            data, _ = self.equations(q, u, tangent, np.zeros(len(u)))
            covariance = _solved(normal, np.eye(len(normal)))
            taken = float(np.trace(covariance @ (normal - data)))
            count = float(np.count_nonzero(inside))
            left = float(np.sum((away / self.relative)[inside] ** 2))
            freedom = max(self.free * count - taken, 0.25 * self.free * count, 1.0)
            spread = max(np.sqrt(left / freedom), self.least)
            inside = away < GROSS * spread * self.relative
        std = spread * self.relative
        along = self._along(q, u, std, covariance)
        return PointCurve(
            self.basis, q, u, away, std, along, inside, self._length(q),
            self._likelihood(q, std, inside), self._correlation(q, u, inside),
        )  # fmt: skip

    def _likelihood(self, q: FloatArray, std: FloatArray, inside: NDArray[np.bool_]) -> float:
        """See `PointCurve`: points beside the DLO lie anywhere within half its length."""
        length = self.basis.length
        density = float(np.sum(np.log(0.5 * length / std[inside]) - 0.5))
        speed = np.linalg.norm(self._slopes @ q, axis=1)
        bent = np.cross(self._slopes @ q, self._bending @ q)
        curvature = np.linalg.norm(bent, axis=1) / np.maximum(speed, 1e-6) ** 3
        usual = USUAL_CURVATURE / length
        energy = self._weights @ (curvature / usual) ** 2 / (USUAL_BEND * length)
        return self.free * density - 0.5 * float(energy)

    def _correlation(self, q: FloatArray, u: FloatArray, inside: NDArray[np.bool_]) -> float:
        order = np.flatnonzero(inside)[np.argsort(u[inside])]
        offset = self.points[order] - self.basis.evaluate(q, u[order])
        power = float(np.sum(offset**2))
        return float(np.sum(offset[1:] * offset[:-1])) / power if power > 0.0 else 0.0

    def _along(
        self, q: FloatArray, u: FloatArray, std: FloatArray, covariance: FloatArray
    ) -> FloatArray:
        if self.known is not None:
            return std  # a position that is off along the DLO is as good as a wrong u
        b, d = self.basis.matrix(u), self.dimensions
        t = self.basis.evaluate(q, u, 1)[:, self.axes]
        t /= np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-12)
        rows = np.einsum("mi,ma->mia", b, t).reshape(len(u), -1)
        variance = np.einsum("mk,kl,ml->m", rows, covariance, rows, optimize=True)
        assert covariance.shape[0] == b.shape[1] * d
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _length(self, q: FloatArray) -> float:
        speed = np.linalg.norm(self._slopes @ q, axis=1)
        return float(self._weights @ speed / self.basis.length)
