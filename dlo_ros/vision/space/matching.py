# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A first shape in space from centrelines whose material coordinates are unknown.

Two centrelines are matched as a whole by dynamic programming: both run along the same DLO, and a
point of one lies on the epipolar line of its partner. Where the DLO runs along epipolar lines, the
match follows from an even advance on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.space.view import focal_length

SAMPLES = 160  # points of a centreline that are matched
FARTHEST = 12.0  # [px] a larger distance from the epipolar line costs no more
MATCHED = 4.0  # [px] root mean square distance from the epipolar lines, beyond which none match
MATCHED_LENGTHS = (-0.35, 0.2)
"""Shares of L by which a match may be too short or too long: where nothing determines the depth, as
along the epipolar lines or towards a camera, the smoothest curve is the shortest."""
LENGTH_STD = 0.05  # of L: the same of a match that is right
WAITING = 0.4  # [px^2] cost of a step along one centreline alone
ROUGH_SPANS = 9  # of the spline through the matched points
ROUGH_SMOOTHING = 1e-7  # of the third derivative's square, against that of the points' distance


@dataclass(frozen=True, eq=False)
class Course:
    """An ordered centreline in a picture: undistorted, normalised points, shape (m, 2)."""

    camera: Camera
    rays: FloatArray

    def sampled(self, count: int) -> FloatArray:
        """Equally spaced points, shape (count, 2)."""
        steps = np.hypot(*np.diff(self.rays, axis=0).T)
        s = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.linspace(0.0, s[-1], count)
        return np.column_stack([np.interp(at, s, column) for column in self.rays.T])

    def backwards(self) -> Course:
        """The centreline from its end."""
        return Course(self.camera, self.rays[::-1])


@dataclass(frozen=True, eq=False)
class Match:
    """Two or more centrelines matched.

    Args:
        points: points of the DLO in space, equally spaced over the matched part [m], shape (m, 3).
        distance: root mean square distance from the epipolar lines [px], far ones cut.
    """

    points: FloatArray
    distance: float

    @property
    def length(self) -> float:
        """Length of the polyline [m]."""
        return float(np.sum(np.linalg.norm(np.diff(self.points, axis=0), axis=1)))

    @property
    def near(self) -> bool:
        """Whether the centrelines may show one strand, of whatever length."""
        return self.distance <= MATCHED

    def compared(self, length: float) -> tuple[float, str]:
        """Misfit to the views and to a DLO's length, and why it is none, empty where it may be.

        Args:
            length: length of the DLO, L [m].
        """
        share = self.length / length - 1.0
        fault = ""
        if not self.near:
            fault = f"{self.distance:.0f} px beside the epipolar lines"
        elif not MATCHED_LENGTHS[0] < share < MATCHED_LENGTHS[1]:
            fault = f"the DLO would be {self.length:.3g} m long"
        return self.distance**2 + (share / LENGTH_STD) ** 2, fault


def align(cost: FloatArray, waiting: float) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """The cheapest monotone way from the first to the last cell of a table.

    Args:
        cost: cost of each pair, shape (n, m).
        waiting: cost of a step along one side alone.

    Returns:
        Indices of the pairs on both sides, and the mean cost of a pair.
    """
    n, m = cost.shape
    total = np.empty((n, m))
    total[0] = np.cumsum(cost[0] + waiting) - waiting
    for i in range(1, n):
        down = total[i - 1] + waiting
        down[1:] = np.minimum(down[1:], total[i - 1, :-1])
        # Steps along the row: total_j = min over k <= j of down_k + sum of costs k..j.
        run = np.cumsum(cost[i] + waiting)
        before = run - cost[i] - waiting
        total[i] = np.minimum.accumulate(down - before) + run - waiting
    i, j = n - 1, m - 1
    first, second = [i], [j]
    while i or j:
        if i == 0:
            j -= 1
        elif j == 0:
            i -= 1
        else:
            steps = (total[i - 1, j - 1], total[i - 1, j] + waiting, total[i, j - 1] + waiting)
            k = int(np.argmin(steps))
            i, j = i - (k != 2), j - (k != 1)
        first.append(i)
        second.append(j)
    a, b = np.array(first[::-1]), np.array(second[::-1])
    return a, b, float(np.mean(cost[a, b]))


def match(courses: Sequence[Course]) -> Match:
    """Match the first centreline with each other one, and triangulate all together.

    Args:
        courses: courses of one instant, all from the same end, two or more.
    """
    reference = courses[0]
    rays = [course.sampled(SAMPLES) for course in courses]
    shares = [np.linspace(0.0, 1.0, SAMPLES)]
    worst = 0.0
    for course, other in zip(courses[1:], rays[1:], strict=True):
        distance = _epipolar(reference.camera, rays[0], course.camera, other)
        cost = np.minimum(distance, FARTHEST) ** 2
        i, j, mean = align(cost, WAITING)
        worst = max(worst, mean)
        # Both sides advance: the parameter is the mean of both shares.
        along = 0.5 * (i + j) / (SAMPLES - 1.0)
        shares[0] = (
            _increasing(np.interp(np.arange(SAMPLES), i, along)) if len(shares) == 1 else shares[0]
        )
        inner = np.interp(np.arange(SAMPLES), j, i.astype(float))
        shares.append(np.interp(inner, np.arange(SAMPLES), shares[0]))
    basis, points = triangulated(courses, rays, shares)
    at = np.linspace(0.0, 1.0, 2 * SAMPLES)
    return Match(basis.evaluate(points, at), float(np.sqrt(worst)))


def triangulated(
    courses: Sequence[Course], rays: Sequence[FloatArray], shares: Sequence[FloatArray]
) -> tuple[SplineBasis, FloatArray]:
    """The smooth curve in space nearest to the rays of matched centrelines.

    Args:
        courses: centrelines of one instant, with their cameras.
        rays: rays through the samples of each centreline, each of shape (SAMPLES, 2).
        shares: parameter of each sample along the curve, 0 to 1, each of shape (SAMPLES,).

    Returns:
        The basis of a spline over 0 to 1, and its control points [m], shape (k, 3).
    """
    basis = SplineBasis(ROUGH_SPANS + 3, 1.0)
    k = basis.control_points
    third = basis.matrix((np.arange(basis.spans) + 0.5) / basis.spans, 3)
    smooth = ROUGH_SMOOTHING * np.kron(third.T @ third, np.eye(3))
    scale = np.ones(len(courses) * SAMPLES)
    for _ in range(2):  # the second time distances count in the picture, not in space
        matrix, right = smooth.copy(), np.zeros(3 * k)
        depths = []
        for number, (course, q, share) in enumerate(zip(courses, rays, shares, strict=True)):
            b = basis.matrix(share)
            own = slice(number * SAMPLES, (number + 1) * SAMPLES)
            rotation, translation = course.camera.rotation, course.camera.translation
            for axis in (0, 1):
                # x - q_x z = 0 of the point in the camera's frame
                direction = rotation[axis] - q[:, [axis]] * rotation[2]
                rows = (b[:, :, None] * direction[:, None, :]).reshape(SAMPLES, -1)
                offset = translation[axis] - q[:, axis] * translation[2]
                matrix += (rows * scale[own, None]).T @ rows
                right -= (rows * scale[own, None]).T @ offset
            depths.append((b, rotation, translation))
        points = np.linalg.solve(matrix, right).reshape(k, 3)
        z = np.concatenate([b @ points @ r[2] + t[2] for b, r, t in depths])
        scale = 1.0 / np.maximum(np.abs(z), 1e-2) ** 2
    return basis, points


def _increasing(values: FloatArray) -> FloatArray:
    """Values that grow a little at least, from 0 to 1."""
    steps = np.maximum(np.diff(values), 1e-6)
    total = np.concatenate([[0.0], np.cumsum(steps)])
    return np.asarray(total / total[-1])


def _epipolar(one: Camera, rays: FloatArray, other: Camera, others: FloatArray) -> FloatArray:
    """Distance of each of the other camera's points from the epipolar line of each of the first's.

    Returns:
        [px] of the other camera, shape (n, m).
    """
    rotation = other.rotation @ one.rotation.T
    base = other.translation - rotation @ one.translation
    lines = np.cross(base, np.column_stack([rays, np.ones(len(rays))]) @ rotation.T)
    lines /= np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None]
    seen = np.column_stack([others, np.ones(len(others))])
    return np.asarray(focal_length(other) * np.abs(lines @ seen.T))


def coordinates(points: FloatArray, length: float) -> FloatArray:
    """Material coordinates of a polyline's points, by their share of its length [m], shape (m,)."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.asarray(s * (length / max(float(s[-1]), 1e-12)))


def scaled_in_depth(points: FloatArray, axis: FloatArray, scale: float) -> FloatArray:
    """Control points whose depth from the line through both ends is scaled [m], shape (k, 3).

    Args:
        points: control points [m], shape (k, 3).
        axis: unit vector along which the depth counts, shape (3,).
        scale: factor; below 0 the shape is mirrored.
    """
    share = np.linspace(0.0, 1.0, len(points))[:, None]
    away = points - points[0] - share * (points[-1] - points[0])
    return np.asarray(points + (scale - 1.0) * (away @ axis)[:, None] * axis)
