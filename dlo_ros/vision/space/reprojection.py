# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One spline in space through the centrelines of all views, by reprojection across them.

A measured point says where the DLO is across its centreline in that view, and nothing along it: no
pixel of one view is matched with one of another. Each point's material coordinate is that where
the projected spline passes it, sought anew after each step (Gauss and Newton's, with Student's
weights); the derivatives of the distance contain that it follows.
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
from scipy.linalg.lapack import dpotri

from dlo_ros.errors import VisionError
from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.spline_table import BasisTable
from dlo_ros.vision.segmentation.edge_profile import SAMPLING_STD
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.space.normal_equations import SplineNormalEquations, leverage, mirrored
from dlo_ros.vision.space.spatial_result import SpaceFit
from dlo_ros.vision.space.view import View
from dlo_ros.vision.space.view_projection import DRIFTS, GRAZING, Projection, project

FREEDOM = 4.0  # degrees of freedom of Student's distribution
STEPS = 10  # of Gauss and Newton at most
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
ODD_WIDTH = 4.0  # standard deviations (robust) of the distance of edges that are not one DLO's,
LEAST_ODD_WIDTH = 0.05  # and the same as a share of it, which noise and tones fake
FURTHEST_SLIDE = 0.02  # of L that a point's material coordinate moves in a step
LEAST_FREEDOM = 0.3  # share of the scatter at the least that no curve follows

Weighted = tuple[FloatArray, FloatArray, FloatArray]
"""Basis functions and directions of observations, and weights, shapes (m, k), (m, 3) and (m,)."""


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
    drift = np.zeros((DRIFTS if moving else 0, 3))
    coordinates = [np.clip(view.u, 0.0, length) for view in views]
    table = BasisTable.of(basis)
    for step in range(STEPS):
        equations = SplineNormalEquations(k, 1 + drift.size)
        residuals, stds, weights = [], [], []
        pictures: list[Weighted] = []
        depths: list[Weighted] = []
        for view, u in zip(views, coordinates, strict=True):
            seen = _project(view, u, table, points, velocity, drift)
            on = seen.on(u, length)
            std = np.hypot(_scatter(seen.across, freedom, SAMPLING_STD, view.width), view.shared)
            if view.apart is not None:
                on &= ~_odd_width(view.apart, seen.depth)
            weight = np.where(on, _student(seen.across / std), 0.0)
            others = None
            if moving:
                by_drift = view.dt * seen.drift_basis[:, :, None] * seen.across_rows[:, None, :]
                others = np.hstack([np.zeros((len(u), 1)), by_drift.reshape(len(u), -1)])
            fisher = weight / std**2
            equations.add(seen.basis, seen.across_rows, seen.across, fisher, others)
            pictures.append((seen.basis, seen.across_rows, fisher))
            residuals.append(seen.across)
            stds.append(std)
            weights.append(weight)
            if view.depth is not None:
                behind = 0.5 * prior.diameter * seen.behind
                depths.extend(_add_depth(equations, view, seen, on, behind, depth_freedom))
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
        data: observations of the curve.
        covariance: covariance of the control points, shape (3 k, 3 k) [m^2].
    """
    count = sum(len(weight) for _, _, weight in data)
    followed = sum(float(leverage(*one, covariance)) for one in data)
    return max(LEAST_FREEDOM, 1.0 - followed / max(count, 1))


def _inverse(factor: tuple[FloatArray, bool], size: int) -> FloatArray:
    """The first unknowns' covariance, the others marginalised."""
    # LAPACK fills one triangle only.
    half = np.asarray(dpotri(factor[0], lower=factor[1])[0])[:size, :size]
    return np.asarray(mirrored(half if factor[1] else half.T))


def _project(
    view: View,
    u: FloatArray,
    table: BasisTable,
    points: FloatArray,
    velocity: FloatArray,
    drift: FloatArray,
) -> Projection:
    """The curve at a view's time, at its points' material coordinates [m]."""
    by_drift = view.dt * drift if len(drift) else np.zeros((DRIFTS, 3))
    return project(view, u, table, points + view.dt * velocity, by_drift)


def _student(scaled: FloatArray) -> FloatArray:
    """Weights of residuals in units of their std."""
    return np.asarray((FREEDOM + 1.0) / (FREEDOM + scaled**2))


@njit()
def _scatter(residual: FloatArray, freedom: float, floor: float, width: float) -> FloatArray:
    """Standard deviation of each point, from the scatter of all and of those around it.

    Args:
        residual: distances of the points from the curve, shape (m,).
        freedom: share of the scatter that the curve has not followed.
        floor: added in squares.
        width: width of the DLO [px]; scatter beyond a quarter of it does not count as noise.
    """
    count = len(residual)
    result = np.empty(count)
    if count == 0:
        return result
    size = np.minimum(np.abs(residual), 0.25 * width)
    usual = 1.4826 * np.median(size)
    window = min(WINDOW, count)
    for i in range(count):
        first = i - window // 2
        total = 0.0
        for j in range(max(first, 0), min(first + window, count)):
            total += min(size[j], 6.0 * usual) ** 2
        variance = max(usual**2, 0.7**2 * total / window)
        result[i] = np.sqrt(variance / freedom + floor**2)
    return result


@njit()
def _odd_width(apart: FloatArray, depth: FloatArray) -> Mask:
    """Mask of the points whose edges are not those of one DLO.

    Where two strands of one look lie on one another, an edge of each is seen: the middle is shifted
    by half of what the edges lie further apart than those of the DLO alone, which the scatter along
    it does not show.

    Args:
        apart: distance of the edges [px], NaN where it is unknown, shape (m,).
        depth: depth of the DLO there [m], shape (m,).
    """
    result = np.zeros(len(apart), dtype=np.bool_)
    size = apart * depth
    known = np.isfinite(size)
    if np.sum(known) < WINDOW:
        return result
    change = np.abs(size / np.median(size[known]) - 1.0)
    limit = max(ODD_WIDTH * 1.4826 * np.median(change[known]), LEAST_ODD_WIDTH)
    for i in range(len(apart)):
        result[i] = known[i] and change[i] > limit
    return result


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
    seen = _project(view, u, table, points, velocity, drift)
    speed = seen.speed
    # Where the DLO runs towards the camera a pixel is a long way.
    least = GRAZING * view.focal_length / seen.depth
    most = FURTHEST_SLIDE * length
    change = np.clip(seen.along / np.maximum(np.abs(speed), least) * np.sign(speed), -most, most)
    return np.asarray(np.clip(u + change, 0.0, length))


def _add_depth(
    equations: SplineNormalEquations, view: View, seen: Projection, on: Mask, behind: FloatArray,
    freedom: float,
) -> list[Weighted]:  # fmt: skip
    """Depths along the centreline, robust: holes are left out, mixed pixels count little.

    Args:
        equations: the equations to which they are added.
        view: a view with depth.
        seen: the curve beside its points.
        on: mask of the points that count, shape (m,).
        behind: depth of the axis behind the surface [m], shape (m,).
        freedom: share of the scatter that the curve has not followed.

    Returns:
        The observations that were added; empty without a depth.
    """
    assert view.depth is not None
    known = np.isfinite(view.depth) & on
    if np.count_nonzero(known) < WINDOW:
        return []
    residual = (seen.depth - behind - view.depth)[known]
    std = _scatter(residual, freedom, DEPTH_STD_FLOOR, np.inf)
    basis, direction = seen.basis[known], seen.depth_rows[known]
    weight = _student(residual / std) / std**2
    equations.add(basis, direction, residual, weight)
    return [(basis, direction, weight)]


def _add_tips(
    equations: SplineNormalEquations, view: View, table: BasisTable, points: FloatArray
) -> None:
    """Free ends, as each view shows them."""
    length = table.basis.length
    for tip, u in zip(view.tips, (0.0, length), strict=True):
        ray = None if tip is None else view.camera.rays(tip[None])
        if ray is None or not np.all(np.isfinite(ray)):
            continue
        for tangent in np.eye(2):
            one = View(view.camera, ray, ray, tangent[None], np.array([u]), view.width)
            seen = project(one, one.u, table, points, np.zeros((DRIFTS, 3)), sliding=False)
            std = TIP_STD * view.width
            weight = _student(seen.across / std) / std**2
            equations.add(seen.basis, seen.across_rows, seen.across, weight)


def _add_length(
    equations: SplineNormalEquations, slope: FloatArray, points: FloatArray, stretch: float
) -> None:
    """|r'| = 1 + stretch everywhere."""
    d = slope @ points
    size = np.maximum(np.linalg.norm(d, axis=1), 1e-9)
    weight = np.full(len(d), STRAIN_STD**-2)
    stretched = np.full((len(d), 1), -1.0)
    equations.add(slope, d / size[:, None], size - 1.0 - stretch, weight, stretched)


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
        # The position in all directions as well as across, and along it once more.
        axes = np.vstack([np.eye(3), tangent])
        across, along = (prior.diameter * np.array([CLAMP_STD, CLAMP_ALONG_STD])) ** -2.0
        weight = np.array([across, across, across, along - across])
        away = axes @ (value[k] @ points - clamp.position)
        equations.add(np.repeat(value[k : k + 1], 4, axis=0), axes, away, weight)
        if clamp.direction is None:
            continue
        beside = np.eye(3) - np.outer(clamp.direction, clamp.direction)
        weight = np.full(3, CLAMP_DIRECTION_STD**-2)
        turned = beside @ (slope[k] @ points)
        equations.add(np.repeat(slope[k : k + 1], 3, axis=0), beside, turned, weight)
