# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One spline in space through the centrelines of all views, by reprojection across them.

A measured point says where the DLO is across its centreline in that view, and nothing along it: no
pixel of one view is matched with one of another. Each point's material coordinate is that where
the projected spline passes it, sought anew after each step (Gauss and Newton's, with Student's
weights).
Where the DLO runs along the epipolar line, or one view alone sees it, the depth follows from the
length, which is known everywhere, and by smoothness: the third derivative is taken as white noise
of a density that is itself estimated (expectation maximisation), so that the covariance says how
little is known there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.spline_table import BasisTable
from dlo_ros.vision.segmentation.edge_profile import SAMPLING_STD
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.space.normal_equations import SplineNormalEquations, rows_of
from dlo_ros.vision.space.spatial_result import SpaceFit
from dlo_ros.vision.space.view import View

FREEDOM = 4.0  # degrees of freedom of Student's distribution
STEPS = 5  # of Gauss and Newton at most
SETTLED = 0.1  # [px] the last step moved the curve by less
DEPTH_STD_FLOOR = 2e-4  # [m] the same of depth
SHARED_STD = 0.01  # relative error of the whole length by cameras, poses and L
STRAIN_STD = 0.003  # relative error of the length of half a knot span
CLAMP_STD = 0.25  # [diameters] how well a clamp's position across the DLO is trusted
CLAMP_ALONG_STD = 0.01  # [diameters] the same along it: u is counted from the clamp
CLAMP_DIRECTION_STD = 0.05  # [rad]
TIP_STD = 0.5  # [widths] of a free end in one view
ROUGHNESS = 400.0
"""Density of the third derivative to begin with [1/L^3]: curvature changes by 10/L over L/4."""
ROUGHNESS_RANGE = (0.02, 8.0)  # of that, within which it is estimated
WINDOW = 7  # blocks over which the scatter is judged
SPEEDS = SplineBasis(4, 1.0)
"""Over the share of u, in which what is not known of the velocity may vary."""
FURTHEST_SLIDE = 0.02  # of L that a point's material coordinate moves in a step
BEYOND = 2.0  # [px] past the DLO's end a point is none of it
NEAREST = 0.05  # [m] before a camera, where no DLO is
LEAST_FREEDOM = 0.3  # share of the scatter at the least that no curve follows

Weighted = tuple[FloatArray, FloatArray]
"""Rows of the equations and the weights of their residuals, shapes (m, 3 k) and (m,)."""


@dataclass(frozen=True, eq=False)
class ClampPose:
    """A clamp: position [m] and unit direction of growing u or None, shapes (3,)."""

    position: FloatArray
    direction: FloatArray | None


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior knowledge besides the pictures.

    Args:
        diameter: diameter of the DLO [m].
        clamps: poses of the clamps of start and end; None where the end is free.
        velocity: velocity of the fine spline's control points [m/s], shape (k, 3); None: unknown.
        speed_std: standard deviation of the velocity [m/s].
        roughness: see `SpaceFit`; None: `ROUGHNESS`.
    """

    diameter: float
    clamps: tuple[ClampPose | None, ClampPose | None] = (None, None)
    velocity: FloatArray | None = None
    speed_std: float = 0.0
    roughness: float | None = None


class _Seen:
    """A view's points beside the projected curve.

    Args:
        view: the view that was measured.
        curve: points of the curve in the board frame [m], shape (m, 3).
        u: material coordinates of both [m], shape (m,).
        length: L [m].

    Raises:
        VisionError: the curve lies behind the camera.
    """

    def __init__(self, view: View, curve: FloatArray, u: FloatArray, length: float) -> None:
        camera, focal = view.camera, view.focal_length
        seen = curve @ camera.rotation.T + camera.translation
        z = seen[:, 2]
        if not np.all(z > NEAREST):
            raise VisionError("what the cameras see does not meet in front of them")
        t, q = view.tangents, seen[:, :2] / z[:, None]
        difference = q - view.rays
        self.depth = z
        self.across: FloatArray = focal * (difference[:, 1] * t[:, 0] - difference[:, 0] * t[:, 1])
        self.along: FloatArray = -focal * np.sum(difference * t, axis=1)
        self.across_rows = self._derivative(camera.rotation, q, z, focal, -t[:, 1], t[:, 0])
        self.along_rows = self._derivative(camera.rotation, q, z, focal, t[:, 0], t[:, 1])
        before = (u <= 0.0) & (self.along < -BEYOND)
        behind = (u >= length) & (self.along > BEYOND)
        self.on: Mask = ~(before | behind)

    @staticmethod
    def _derivative(
        rotation: FloatArray,
        q: FloatArray,
        z: FloatArray,
        focal: float,
        x: FloatArray,
        y: FloatArray,
    ) -> FloatArray:
        """Derivative of focal (x, y) . q by the point in the board frame [px/m], shape (m, 3)."""
        optical = np.column_stack([x, y, -x * q[:, 0] - y * q[:, 1]])
        return np.asarray((focal / z)[:, None] * (optical @ rotation))


def fit_views(
    views: Sequence[View], basis: SplineBasis, start: FloatArray, prior: Prior
) -> SpaceFit:
    """Fit the fine spline.

    Args:
        views: views of one instant, up to their `dt`.
        basis: basis of the fine spline; its length is L.
        start: control points to begin with [m], shape (k, 3).
        prior: prior knowledge besides the pictures.

    Raises:
        VisionError: too little was seen, or the equations have no solution.
    """
    count = sum(len(view.u) for view in views)
    if count < 2 * WINDOW:
        raise VisionError("hardly anything of the DLO is visible")
    k, length = basis.control_points, basis.length
    usual = ROUGHNESS / length**3
    roughness = usual if prior.roughness is None else prior.roughness
    freedom = depth_freedom = max(LEAST_FREEDOM, 1.0 - 2.0 * k / count)
    points, stretch = start.copy(), 0.0
    velocity = np.zeros_like(points) if prior.velocity is None else prior.velocity
    # What is not known of the velocity is an error that a whole view has in common.
    moving = prior.speed_std > 0.0 and any(view.dt != 0.0 for view in views)
    drift = np.zeros((SPEEDS.control_points if moving else 0, 3))
    coordinates = [np.clip(view.u, 0.0, length) for view in views]
    table = BasisTable.of(basis)
    for step in range(STEPS):
        equations = SplineNormalEquations(k, 1 + drift.size)
        residuals, stds, weights = [], [], []
        pictures: list[Weighted] = []
        depths: list[Weighted] = []
        for view, u in zip(views, coordinates, strict=True):
            b = table.matrix(u)
            seen = _Seen(view, _curve(b, u / length, view, points, velocity, drift), u, length)
            std = np.hypot(_scatter(seen.across, freedom, SAMPLING_STD, view.width), view.shared)
            weight = np.where(seen.on, _student(seen.across / std), 0.0)
            rows = rows_of(b, seen.across_rows)
            if moving:
                by_drift = view.dt * rows_of(SPEEDS.matrix(u / length), seen.across_rows)
                rows = np.hstack([rows, np.zeros((len(u), 1)), by_drift])
            equations.add(rows, seen.across, weight / std**2)
            pictures.append((rows[:, : 3 * k], weight / std**2))
            residuals.append(seen.across)
            stds.append(std)
            weights.append(weight)
            if view.depth is not None:
                depths.extend(_add_depth(equations, view, b, seen, depth_freedom))
            _add_tips(equations, view, table, points + view.dt * velocity)
        _add_length(equations, table.halves, points, stretch)
        equations.add_prior(3 * k, np.array([stretch]), SHARED_STD)
        if moving:
            equations.add_prior(3 * k + 1, drift.ravel(), prior.speed_std)
        equations.add_roughness(table.third, points, basis.span_length / roughness, 3 * k)
        _add_clamps(equations, table, points, prior)
        try:
            factor = cho_factor(equations.matrix, check_finite=False)
            change = cho_solve(factor, equations.right)
        except (np.linalg.LinAlgError, ValueError) as err:
            raise VisionError("the pictures do not determine the shape in space") from err
        moved = change[: 3 * k].reshape(k, 3)
        points, stretch = points + moved, stretch + float(change[3 * k])
        drift = drift + change[3 * k + 1 :].reshape(-1, 3)
        coordinates = [
            _slide(view, u, table, points, velocity, drift)
            for view, u in zip(views, coordinates, strict=True)
        ]
        if step == 0:
            inverse = _inverse(factor, 3 * k)
            freedom, depth_freedom = _freedom(pictures, inverse), _freedom(depths, inverse)
            spread = np.einsum("iaja->ij", inverse.reshape(k, 3, k, 3))
            third = table.third
            square = np.sum((third @ points) ** 2, axis=1) + np.sum(
                (third @ spread) * third, axis=1
            )
            found = basis.span_length * float(np.mean(square)) / 3.0
            low, high = ROUGHNESS_RANGE
            roughness = float(np.clip(found, low * usual, high * usual))
        elif _pixels(views, moved) < SETTLED:
            break
    covariance = _inverse(factor, 3 * k)
    return SpaceFit(
        basis, points, covariance, stretch, tuple(residuals), tuple(coordinates), tuple(stds),
        tuple(weights), roughness,
    )  # fmt: skip


def _freedom(data: Sequence[Weighted], covariance: FloatArray) -> float:
    """Share of the scatter of some data that the curve does not follow.

    It is one minus the mean leverage: smoothness and length leave the curve far fewer degrees of
    freedom than it has control points.

    Args:
        data: rows of the equations and their weights.
        covariance: covariance of the control points, shape (3 k, 3 k) [m^2].
    """
    count = sum(len(weight) for _, weight in data)
    followed = sum(float(weight @ np.sum((rows @ covariance) * rows, 1)) for rows, weight in data)
    return max(LEAST_FREEDOM, 1.0 - followed / max(count, 1))


def _inverse(factor: tuple[FloatArray, bool], size: int) -> FloatArray:
    """The first unknowns' covariance, the others marginalised."""
    identity = np.eye(len(factor[0]), size)
    return np.asarray(cho_solve(factor, identity, check_finite=False)[:size])


def _curve(
    b: FloatArray,
    share: FloatArray,
    view: View,
    points: FloatArray,
    velocity: FloatArray,
    drift: FloatArray,
) -> FloatArray:
    """The curve at a view's time [m], shape (m, 3)."""
    curve = b @ (points + view.dt * velocity)
    return curve + view.dt * (SPEEDS.matrix(share) @ drift) if len(drift) else curve


def _student(scaled: FloatArray) -> FloatArray:
    """Weights of residuals in units of their std."""
    return np.asarray((FREEDOM + 1.0) / (FREEDOM + scaled**2))


def _scatter(residual: FloatArray, freedom: float, floor: float, width: float) -> FloatArray:
    """Standard deviation of each point, from the scatter of all and of those around it.

    Args:
        residual: distances of the points from the curve, shape (m,).
        freedom: share of the scatter that the curve has not followed.
        floor: added in squares.
        width: width of the DLO [px]; scatter beyond a quarter of it does not count as noise.
    """
    size = np.minimum(np.abs(residual), 0.25 * width)
    usual = 1.4826 * float(np.median(size)) if len(size) else 0.0
    window = np.ones(min(WINDOW, max(len(size), 1)))
    local = np.sqrt(np.convolve(np.minimum(size, 6.0 * usual) ** 2, window, "same") / len(window))
    return np.asarray(np.sqrt(np.maximum(usual, 0.7 * local) ** 2 / freedom + floor**2))


def _pixels(views: Sequence[View], moved: FloatArray) -> float:
    """About how far a change of the control points [m] moves the curve in a picture [px]."""
    nearest = max(view.focal_length / abs(view.camera.translation[2]) for view in views)
    return float(np.abs(moved).max() * nearest)


def _slide(
    view: View,
    u: FloatArray,
    table: BasisTable,
    points: FloatArray,
    velocity: FloatArray,
    drift: FloatArray,
) -> FloatArray:
    """Material coordinates [m] at which the projected curve passes a view's points."""
    length = table.basis.length
    curve = _curve(table.matrix(u), u / length, view, points, velocity, drift)
    seen = _Seen(view, curve, u, length)
    speed = np.sum(seen.along_rows * (table.slopes(u) @ points), axis=1)  # [px/m]
    # Where the DLO runs towards the camera a pixel is a long way.
    least = 0.05 * view.focal_length / seen.depth
    most = FURTHEST_SLIDE * length
    change = np.clip(seen.along / np.maximum(np.abs(speed), least) * np.sign(speed), -most, most)
    return np.asarray(np.clip(u + change, 0.0, length))


def _add_depth(
    equations: SplineNormalEquations, view: View, b: FloatArray, seen: _Seen, freedom: float
) -> list[Weighted]:
    """Depths along the centreline, robust: holes are left out, mixed pixels count little.

    Returns:
        The rows and weights that were added; empty without a depth.
    """
    assert view.depth is not None
    known = np.isfinite(view.depth) & seen.on
    if np.count_nonzero(known) < WINDOW:
        return []
    residual = seen.depth[known] - view.depth[known]
    std = _scatter(residual, freedom, DEPTH_STD_FLOOR, np.inf)
    rows = rows_of(b[known], np.tile(view.camera.rotation[2], (len(residual), 1)))
    weight = _student(residual / std) / std**2
    equations.add(rows, residual, weight)
    return [(rows, weight)]


def _add_tips(
    equations: SplineNormalEquations, view: View, table: BasisTable, points: FloatArray
) -> None:
    """Free ends, as each view shows them."""
    length = table.basis.length
    for k, (tip, u) in enumerate(zip(view.tips, (0.0, length), strict=True)):
        ray = None if tip is None else view.camera.rays(tip[None])
        if ray is None or not np.all(np.isfinite(ray)):
            continue
        b = table.ends[k : k + 1]
        for tangent in np.eye(2):
            one = View(view.camera, ray, ray, tangent[None], np.array([u]), view.width)
            seen = _Seen(one, b @ points, one.u, length)
            std = TIP_STD * view.width
            weight = _student(seen.across / std) / std**2
            equations.add(rows_of(b, seen.across_rows), seen.across, weight)


def _add_length(
    equations: SplineNormalEquations, slope: FloatArray, points: FloatArray, stretch: float
) -> None:
    """|r'| = 1 + stretch everywhere."""
    d = slope @ points
    size = np.maximum(np.linalg.norm(d, axis=1), 1e-9)
    rows = np.hstack([rows_of(slope, d / size[:, None]), np.full((len(d), 1), -1.0)])
    equations.add(rows, size - 1.0 - stretch, np.full(len(d), STRAIN_STD**-2))


def _add_clamps(
    equations: SplineNormalEquations, table: BasisTable, points: FloatArray, prior: Prior
) -> None:
    """Clamps: across the DLO weak observations, since where it is seen the pictures prevail.

    Along it no picture shows where u begins: that is where the clamp is, by definition. Were it
    open, the spline would slide along itself to where it bends least, away from the clamp at which
    a DLO bends most.
    """
    value, slope = table.ends, table.end_slopes
    for k, clamp in enumerate(prior.clamps):
        if clamp is None:
            continue
        tangent = slope[k] @ points
        tangent = tangent / max(float(np.linalg.norm(tangent)), 1e-9)
        # Unit vectors: along the DLO first, then two across it.
        axes = np.linalg.qr(np.column_stack([tangent, np.eye(3)]))[0].T
        std = prior.diameter * np.array([CLAMP_ALONG_STD, CLAMP_STD, CLAMP_STD])
        rows = rows_of(np.repeat(value[k : k + 1], 3, axis=0), axes)
        equations.add(rows, axes @ (value[k] @ points - clamp.position), std**-2)
        if clamp.direction is None:
            continue
        across = np.eye(3) - np.outer(clamp.direction, clamp.direction)
        rows = rows_of(np.repeat(slope[k : k + 1], 3, axis=0), across)
        weight = np.full(3, CLAMP_DIRECTION_STD**-2)
        equations.add(rows, across @ (slope[k] @ points), weight)
