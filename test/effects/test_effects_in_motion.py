# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects on a rod in motion, and on what a camera measures of it."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from lifted_rods import STAMPS, lifted, shapes, simulate
from rods import PAPER, SECOND, command
from scipy.spatial.transform import Rotation

from dlo_ros.effects import build
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.hidden_effects import HiddenEffects

ROD = PAPER.rod


def test_a_delay_shifts_the_motion_in_time():
    late, _ = simulate(PAPER.with_effects({"command_delay": {"delay": 0.1}}), lifted(), STAMPS)
    shifted, _ = simulate(PAPER, lifted(SECOND // 10), STAMPS)
    np.testing.assert_allclose(shapes(late), shapes(shifted), atol=1e-5)


def test_added_damping_is_configured_damping():
    added = PAPER.with_effects(
        {"air_drag": {"coefficient": 0.04}, "internal_damping": {"relaxation_time": 0.01}}
    )
    damping = replace(PAPER.damping, air_drag=0.05, relaxation_time=0.012)
    one, _ = simulate(added, lifted(), STAMPS)
    other, _ = simulate(replace(PAPER, damping=damping), lifted(), STAMPS)
    np.testing.assert_allclose(shapes(one), shapes(other), atol=1e-9)


def test_slip_makes_the_rod_longer_as_far_as_the_motion_has_gone():
    settings = replace(PAPER, damping=replace(PAPER.damping, air_drag=1.0, relaxation_time=0.1))
    slipping = settings.with_effects({"clamp_slip": {"length": 0.02}})
    stamps = [4 * SECOND]
    slipped, _ = simulate(slipping, lifted(), stamps, spans=28)
    longer, _ = simulate(
        settings.with_effects({"length_error": {"difference": 0.02}}), lifted(), stamps, spans=28
    )
    np.testing.assert_allclose(shapes(slipped), shapes(longer), atol=1e-4)
    half, _ = simulate(slipping, lifted(), [SECOND // 4], spans=28)
    assert arc_length(half[0]) == pytest.approx(ROD.length + 0.01, rel=2e-4)


def test_the_path_over_which_a_grip_slips_is_the_commanded_one():
    """A hand that turns leads the DLO further than its frame where it holds it beside that."""
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.0, -0.8, 0.0]]).as_quat()
    turned = replace(lifted(), rotations=turns[:, None])
    damped = replace(PAPER, damping=replace(PAPER.damping, air_drag=1.0, relaxation_time=0.1))
    effects = {"clamp_slip": {"length": 0.02}, "grip_offset": {"start": (0.0, 0.02)}}
    half, whole = simulate(
        damped.with_effects(effects), turned, [SECOND // 4, SECOND], spans=28
    )[0]  # fmt: skip
    assert arc_length(half) == pytest.approx(ROD.length + 0.01, rel=2e-4)
    assert arc_length(whole) == pytest.approx(ROD.length + 0.02, rel=2e-4)


def arc_length(prediction):
    basis = SplineBasis(ROD.control_points, ROD.length)
    u, weight = basis.quadrature(8)
    return weight @ np.linalg.norm(basis.evaluate(prediction.control_points[:, :3], u, 1), axis=1)


def test_what_the_camera_measures_is_scaled_and_turned():
    plain, _ = simulate(PAPER, lifted(), STAMPS[:4])
    seen, _ = simulate(
        PAPER.with_effects({"camera_scale": {"ratio": 1.02}, "camera_rotation": {"angle": 0.1}}),
        lifted(), STAMPS[:4],
    )  # fmt: skip
    true = shapes(plain)
    c, s = np.cos(0.1), np.sin(0.1)
    # From x towards -z: the x axis turns to (cos, -sin).
    turned = np.stack([c * true[..., 0] + s * true[..., 2], true[..., 1],
                       c * true[..., 2] - s * true[..., 0]], axis=-1) / 1.02  # fmt: skip
    np.testing.assert_allclose(shapes(seen), turned, atol=2e-6)


def test_what_a_shifted_camera_measures_is_shifted():
    plain, _ = simulate(PAPER, lifted(), STAMPS[:4])
    seen, _ = simulate(
        PAPER.with_effects({"camera_shift": {"x": 0.003, "z": -0.05}}), lifted(), STAMPS[:4]
    )
    np.testing.assert_allclose(
        shapes(seen), shapes(plain) + np.array([0.003, 0.0, -0.05]), atol=1e-8
    )


def test_what_is_measured_is_taken_back():
    points = np.random.default_rng(0).normal(size=(5, 3))
    values = {"camera_rotation": {"angle": 0.2}, "camera_scale": {"ratio": 1.1},
              "camera_shift": {"x": 0.1, "z": 0.2}}  # fmt: skip
    for name, keys in values.items():
        (effect,) = build({name: keys})
        assert np.abs(effect.measured(points) - points).max() > 0.01
        np.testing.assert_allclose(effect.true(effect.measured(points)), points, atol=1e-14)


@pytest.mark.parametrize("names", [*permutations(("rotation", "scale", "shift"))], ids="-".join)
def test_errors_of_a_camera_act_in_one_order_whatever_the_files(names):
    keys = {"rotation": {"angle": 0.1}, "scale": {"ratio": 1.1}, "shift": {"x": 0.1, "z": 0.2}}
    given = {f"camera_{name}": keys[name] for name in names}
    points = np.array([[0.1, 0.0, 0.2], [0.3, 0.1, -0.2]])
    mapping = MeasurementMap(PAPER.with_effects(given))
    turned = Rotation.from_rotvec([0.0, 0.1, 0.0]).apply(points)
    expected = turned / 1.1 + np.array([0.1, 0.0, 0.2])
    np.testing.assert_allclose(mapping.measured(points), expected, atol=1e-14)
    np.testing.assert_allclose(mapping.true(mapping.measured(points)), points, atol=1e-14)
    np.testing.assert_allclose(HiddenEffects(given).measured(points), expected, atol=1e-14)


@pytest.mark.parametrize("offset", [(0.004, -0.006), (0.004, 0.0, -0.006)])
def test_a_moved_clamp_is_one_that_was_commanded_elsewhere(offset):
    commanded = lifted()
    moved = commanded.positions.copy()
    moved[:, commanded.names.index("start")] += [0.004, 0.0, -0.006]
    found, _ = simulate(
        PAPER.with_effects({"clamp_offset": {"start": offset}}), commanded, STAMPS[:6]
    )
    there, _ = simulate(PAPER, replace(commanded, positions=moved), STAMPS[:6])
    np.testing.assert_allclose(shapes(found), shapes(there), atol=1e-12)
    plain, _ = simulate(PAPER, commanded, STAMPS[:6])
    np.testing.assert_allclose(
        shapes(found)[:, 0], shapes(plain)[:, 0] + np.array([0.004, 0.0, -0.006]), atol=1e-9
    )


def test_a_moved_clamp_moves_both_control_points_of_its_end():
    names, points = ["control_point_1", "control_point_2"], [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]
    (effect,) = build({"clamp_offset": {"start": (0.01, 0.02)}})
    true = effect.impose(command(names, [0.0], [points]))
    np.testing.assert_allclose(true.positions[0], points + np.array([0.01, 0.0, 0.02]), atol=1e-15)
    (other,) = build({"clamp_offset": {"end": (0.01, 0.02)}})
    assert np.array_equal(other.impose(command(names, [0.0], [points])).positions[0], points)
