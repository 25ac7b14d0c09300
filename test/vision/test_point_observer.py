# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Another tracker's points become observed splines with honest standard deviations, or nothing."""

from dataclasses import replace

import numpy as np
import pytest
from point_lists import LENGTH, SETTINGS, N, bent, tracked

from dlo_ros.errors import VisionError
from dlo_ros.observation import PointList
from dlo_ros.spline import SplineBasis
from dlo_ros.vision.points.point_observer import PointObserver

BASIS = SplineBasis(N, LENGTH)
U = np.linspace(0.0, LENGTH, 201)
NOISE = 0.003
UP = np.array([0.0, 0.0, 0.2])


def away(result, curve):
    """Distance of the observed spline from the curve at the same u [m], shape (m,)."""
    shape = BASIS.evaluate(result.observation.control_points[:, :3], U)
    return np.linalg.norm(shape - curve.at(U), axis=1)


def covered(result, curve):
    """Shares of points within 1.96 std across in the plane, and of u within 1.96 std along."""
    points = result.observation.points
    gap = points.positions[:, None] - curve.points[None]
    nearest = np.argmin(np.linalg.norm(gap, axis=2), axis=1)
    t = curve.tangents[nearest]
    across = np.column_stack([-t[:, 2], np.zeros(len(t)), t[:, 0]])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    offset = np.abs(np.sum((points.positions - curve.points[nearest]) * across, axis=1))
    along = np.abs(points.u - curve.s[nearest])
    return np.mean(offset < 1.96 * points.std), np.mean(along < 1.96 * points.std_along)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("space", [False, True])
@pytest.mark.parametrize("given", [False, True])
def test_points_in_any_order_become_the_curve(space, given):
    curve = bent(1, space)
    result = PointObserver(SETTINGS, curve.motion()).observe(tracked(curve, 1, given=given))
    assert rms(away(result, curve)) < NOISE
    assert result.std == pytest.approx(NOISE, rel=0.15)
    assert 0.0 < result.outliers < 0.15
    assert 0.9 < covered(result, curve)[0] < 0.99
    assert np.all(np.diff(result.observation.points.u) >= 0.0)


def test_grips_at_both_ends_and_none():
    curve = bent(1)
    both = PointObserver(SETTINGS, curve.motion(end=True)).observe(tracked(curve, 1))
    assert rms(away(both, curve)) < NOISE
    free = PointObserver(SETTINGS).observe(tracked(curve, 1))
    first, last = (away(free, c)[::200] for c in (curve, replace(curve, points=curve.points[::-1])))
    assert min(first.max(), last.max()) < 0.02
    shape = free.observation.control_points
    assert shape[0, 0] < shape[-1, 0], "without a command the start lies further left"


def test_the_end_may_be_the_held_one():
    curve = bent(1)
    result = PointObserver(SETTINGS, curve.motion(start=False, end=True)).observe(tracked(curve, 1))
    assert rms(away(result, curve)) < NOISE


def test_a_stated_std_is_kept_and_one_that_is_too_small_grows():
    curve = bent(2)
    points = tracked(curve, 2, outliers=0.0)
    observer = PointObserver(SETTINGS, curve.motion())
    for stated, told in ((NOISE, NOISE), (2.0 * NOISE, 2.0 * NOISE), (0.3 * NOISE, NOISE)):
        std = np.full(len(points.positions), stated)
        assert observer.observe(replace(points, std=std)).std == pytest.approx(told, rel=0.15)


def test_the_next_list_is_tracked_and_reset_forgets():
    curve = bent(1)
    observer = PointObserver(SETTINGS, curve.motion())
    assert not observer.observe(tracked(curve, 1)).tracked
    second = observer.observe(tracked(curve, 2, stamp=33_000_000))
    assert second.tracked and rms(away(second, curve)) < NOISE
    observer.reset()
    assert not observer.observe(tracked(curve, 3, stamp=66_000_000)).tracked


def test_many_points_are_averaged_and_say_how_well_they_are_known():
    curve = bent(1)
    result = PointObserver(SETTINGS, curve.motion()).observe(tracked(curve, 1, count=2000))
    points = result.observation.points
    assert len(points.u) <= 250
    assert np.median(points.std) == pytest.approx(NOISE / np.sqrt(8.0), rel=0.2)
    assert 0.85 < covered(result, curve)[0] <= 1.0


def cloud(points):
    return PointList(10, np.asarray(points, dtype=np.float64))


def straight(count=150, length=LENGTH):
    points = np.zeros((count, 3))
    points[:, 0] = np.linspace(0.0, length, count)
    return points


@pytest.mark.parametrize(
    ("seen", "word"),
    [
        (cloud(np.zeros((5, 3))), "5 points; 12 are needed"),
        (cloud(np.zeros((50, 3))), "lie|scatter|points"),
        (cloud(1000.0 * straight()), "more than 201 m from their middle.*are they in metres"),
        (cloud(straight(length=0.3)), "rod.length is 0.8 m"),
        (cloud(np.random.default_rng(1).uniform(0.0, 0.8, (200, 3))), "lie|scatter|points"),
        (replace(cloud(straight()), u=np.linspace(0.0, 800.0, 150)), "in metres"),
        (cloud(np.vstack([straight(100, 0.4), straight(100, 0.4) + UP])), "lie|scatter|points"),
    ],
)
def test_what_is_no_such_dlo_is_refused(seen, word):
    with pytest.raises(VisionError, match=word):
        PointObserver(SETTINGS).observe(seen)


def test_points_in_another_frame_than_the_command_are_refused():
    curve = bent(1)
    moved = cloud(tracked(curve, 1).positions + UP)
    with pytest.raises(VisionError):
        PointObserver(SETTINGS, curve.motion()).observe(moved)


@pytest.mark.slow
@pytest.mark.parametrize(("space", "end"), [(False, False), (True, False), (False, True)])
def test_standard_deviations_cover_and_wrong_curves_are_rare(space, end):
    shares, wrong, silent = [], 0, 0
    for seed in range(60):
        curve = bent(seed, space)
        observer = PointObserver(SETTINGS, curve.motion(end=end))
        try:
            result = observer.observe(tracked(curve, seed))
        except VisionError:
            silent += 1
            continue
        wrong += rms(away(result, curve)) > 4.0 * NOISE
        shares.append(covered(result, curve))
    across, along = np.mean(shares, axis=0)
    assert 0.9 < across < 0.99
    assert along > 0.9
    assert wrong <= 1
    assert silent <= 9
