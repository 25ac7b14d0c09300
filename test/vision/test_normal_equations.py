# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sums of sparse rows equal those of whole ones; a projected spline has the derivatives told."""

import numpy as np
import pytest

from dlo_ros.parameters import CameraPose
from dlo_ros.spline import SplineBasis
from dlo_ros.spline_table import BasisTable, basis_functions
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.space.normal_equations import SplineNormalEquations, leverage, mirrored
from dlo_ros.vision.space.view import View
from dlo_ros.vision.space.view_projection import DRIFTS, project

LENGTH = 0.4
BASIS = SplineBasis(9, LENGTH)


def observations(count=20, others=3):
    rng = np.random.default_rng(5)
    basis = BASIS.matrix(np.sort(rng.uniform(0.0, LENGTH, count)))
    direction, residual = rng.normal(size=(count, 3)), rng.normal(size=count)
    rows = (basis[:, :, None] * direction[:, None, :]).reshape(count, -1)
    return (
        rows,
        basis,
        direction,
        residual,
        rng.uniform(1, 9, count),
        rng.normal(size=(count, others)),
    )


def test_rows_are_summed_as_whole_ones_would_be():
    rows, basis, direction, residual, weight, others = observations()
    equations = SplineNormalEquations(BASIS.control_points, 5)
    equations.add(basis, direction, residual, weight, others)
    equations.add(basis, direction, residual, weight)
    whole = np.hstack([rows, others, np.zeros((len(rows), 2))])
    without = np.hstack([rows, np.zeros((len(rows), 5))])
    matrix = sum(r.T @ (weight[:, None] * r) for r in (whole, without))
    right = -sum(r.T @ (weight * residual) for r in (whole, without))
    assert equations.matrix == pytest.approx(matrix, rel=1e-12, abs=1e-12)
    assert equations.right == pytest.approx(right, rel=1e-12, abs=1e-12)


def test_compiled_basis_functions_are_those_of_scipy():
    u = np.concatenate([np.linspace(-0.01, 0.41, 300), [0.0, LENGTH], BASIS.knots])
    assert np.array_equal(basis_functions(BASIS, u), BASIS.matrix(u))


def test_leverage_is_the_trace_of_the_weighted_covariance_of_what_is_observed():
    rows, basis, direction, _, weight, _ = observations()
    root = np.random.default_rng(6).normal(size=(rows.shape[1], 40))
    covariance = root @ root.T
    expected = np.trace(np.diag(weight) @ rows @ covariance @ rows.T)
    assert leverage(basis, direction, weight, covariance) == pytest.approx(expected)
    assert mirrored(np.tril(covariance)) == pytest.approx(covariance)


CAMERA = Camera(
    np.array([[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]]), (0.0,) * 5, 640, 480,
    CameraPose((0.0, 0.0, 1.0), (2**-0.5, 0.0, 0.0, 2**-0.5)),
)  # fmt: skip


def test_a_projection_has_the_position_and_the_derivatives_of_the_spline():
    rng, camera = np.random.default_rng(7), CAMERA
    points = np.column_stack([BASIS.greville - 0.2, *(0.01 * rng.normal(size=(2, 9)))])
    drift, u = 1e-3 * rng.normal(size=(DRIFTS, 3)), np.linspace(0.0, LENGTH, 13)
    angle = rng.uniform(0.0, np.pi, len(u))
    tangents = np.column_stack([np.cos(angle), np.sin(angle)])
    curve = BASIS.matrix(u) @ points + SplineBasis(DRIFTS, LENGTH).matrix(u) @ drift
    rays = camera.rays(camera.project(curve)) + 1e-3 * rng.normal(size=(len(u), 2))
    view = View(camera, rays, rays, tangents, u, 5.0)
    table = BasisTable.of(BASIS)
    seen = project(view, u, table, points, drift, sliding=False)
    apart = 900.0 * (camera.rays(camera.project(curve)) - rays)
    normals = np.column_stack([-tangents[:, 1], tangents[:, 0]])
    assert seen.across == pytest.approx(np.sum(apart * normals, axis=1), abs=1e-3)
    assert seen.along == pytest.approx(-np.sum(apart * tangents, axis=1), abs=1e-3)
    step = 1e-6
    for axis in range(3):
        moved = project(view, u, table, points + step * np.eye(3)[axis], drift, sliding=False)
        by_hand = (moved.across - seen.across) / step
        assert seen.across_rows[:, axis] == pytest.approx(by_hand, rel=1e-3, abs=1e-2)
        climb = (moved.depth - seen.depth) / step
        assert seen.depth_rows[:, axis] == pytest.approx(climb, abs=1e-6)
    inner = u[1:-1]
    short = View(camera, rays[1:-1], rays[1:-1], tangents[1:-1], inner, 5.0)
    at, still = 1e-4, np.zeros((DRIFTS, 3))
    before, behind = (project(short, inner + d, table, points, still) for d in (-at, at))
    speed = project(short, inner, table, points, still).speed
    assert speed == pytest.approx((before.along - behind.along) / (2.0 * at), rel=0.02, abs=2.0)


def test_the_derivatives_of_a_projection_follow_the_spline_as_it_slides_along_a_centreline():
    rng = np.random.default_rng(8)
    points = np.column_stack([BASIS.greville - 0.2, *(0.02 * rng.normal(size=(2, 9)))])
    u, table, still = np.linspace(0.02, 0.38, 10), BasisTable.of(BASIS), np.zeros((DRIFTS, 3))

    def pixels(at):
        return CAMERA.rays(CAMERA.project(BASIS.evaluate(points, at)))

    tangents = pixels(u + 1e-5) - pixels(u - 1e-5)
    angle = np.arctan2(*tangents.T[::-1]) + rng.uniform(-0.3, 0.3, len(u))  # as if measured badly
    tangents = np.column_stack([np.cos(angle), np.sin(angle)])
    view = View(CAMERA, pixels(u), pixels(u), tangents, u, 5.0)
    seen = project(view, u, table, points, still)
    change = 1e-4 * rng.normal(size=points.shape)
    moved, at = project(view, u, table, points + change, still), u
    for _ in range(5):
        at = at + moved.along / moved.speed
        moved = project(view, at, table, points + change, still)
    assert moved.along == pytest.approx(np.zeros(len(u)), abs=1e-6)
    shift = seen.basis @ change
    for before, now, rows in (
        (seen.across, moved.across, seen.across_rows),
        (seen.depth, moved.depth, seen.depth_rows),
    ):
        told = np.sum(rows * shift, axis=1)
        assert np.abs(now - before - told).max() < 0.03 * np.abs(told).max()
