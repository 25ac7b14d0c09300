# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Corners of an imposed motion, at which steps end, and kinks that steps pass by."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command

from dlo_ros.command import Command
from dlo_ros.rod import dynamics
from dlo_ros.rod.resolution import build
from dlo_ros.rod.state import rest_state
from dlo_ros.rod.statics import settle

LENGTH = PAPER.rod.length
RADIUS = 0.1


def led(points, *, velocities=True, turning=0.0):
    """A start led half round a circle in a second, the other end held."""
    angle = np.linspace(0.0, np.pi, points)
    circle = RADIUS * np.stack([1.0 - np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
    speed = RADIUS * np.pi * np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)
    held = np.tile([0.75 * LENGTH, 0.0, 0.0], (points, 1))
    imposed = command(["start", "end"], angle / np.pi, np.stack([circle, held], axis=1))
    rotations = np.array(imposed.rotations)
    half = 0.5 * turning * np.sin(angle) ** 2
    rotations[:, 0] = np.stack([0.0 * half, np.sin(half), 0.0 * half, np.cos(half)], axis=1)
    rotations[::2] *= -1.0  # the same rotations
    moving = np.stack([speed, 0.0 * speed], axis=1) if velocities else imposed.velocities
    return replace(imposed, rotations=rotations, velocities=moving)


def followed(monkeypatch, settings, imposed, stamps, flat):
    """The motion, and that in which each point ends a step, which are the same."""
    model, boundary = build(settings, imposed, 14)
    shape = np.zeros((model.basis.control_points, 4))
    u = model.basis.greville / LENGTH
    shape[:, 0], shape[:, 2] = 0.75 * LENGTH * u, -0.3 * LENGTH * np.sin(np.pi * u)
    if not flat:
        shape[:, 1] = 0.02 * LENGTH * np.sin(np.pi * u)
    start = settle(model, boundary, rest_state(0, shape, model), imposed, 0).state
    found = dynamics.follow(model, boundary, start, imposed, stamps)
    monkeypatch.setattr(Command, "corners", lambda command, *_: command.times)
    exact = dynamics.follow(model, boundary, start, imposed, stamps)
    off = np.linalg.norm((found.shapes - exact.shapes)[..., :3], axis=2)
    assert off.max() < 1e-3 * LENGTH
    return found, exact


def test_a_polyline_has_corners_where_it_is_far_from_a_smooth_curve():
    imposed = led(11, velocities=False)
    sagitta = RADIUS * (1.0 - np.cos(0.05 * np.pi))  # of a chord, from the middle of which it is
    assert len(imposed.corners(1.05 * sagitta, LENGTH)) == 2  # it sets out and stops suddenly
    np.testing.assert_allclose(imposed.corners(0.9 * sagitta, LENGTH), np.linspace(0.0, 1.0, 11))


def test_a_motion_with_velocities_has_corners_where_it_sets_out_and_stops():
    np.testing.assert_allclose(led(11).corners(1e-9, LENGTH), [0.0, 1.0])


def test_a_clamp_that_turns_has_corners_by_how_far_the_dlo_reaches():
    imposed = led(11, turning=1.0)
    assert len(imposed.corners(1e-3, 1e-3)) == 2
    assert len(imposed.corners(1e-3, LENGTH)) > 5
    near, far = (0.1 * reach**2 for reach in (1e-3 * LENGTH, LENGTH))  # 0.1 s from point to point
    assert len(imposed.corners(1e-3, LENGTH, near)) == 2
    np.testing.assert_array_equal(
        imposed.corners(1e-3, LENGTH, 1e3 * far), imposed.corners(1e-3, LENGTH)
    )


@pytest.mark.parametrize("flat", [False, True], ids=["space", "plane"])
def test_a_clamp_that_trembles_in_a_recording_needs_few_steps(monkeypatch, flat):
    """A direction measured to 2 mrad, 100 times a second: the DLO follows beside the clamp only."""
    settings = replace(PAPER, simulation=replace(PAPER.simulation, tolerance=1e-3))
    imposed = led(101)
    rotations = np.array(imposed.rotations)
    half = 1e-3 * np.random.default_rng(4).normal(size=101)
    rotations[:, 0] = np.stack([0.0 * half, np.sin(half), 0.0 * half, np.cos(half)], axis=1)
    imposed = replace(imposed, rotations=rotations)
    found, exact = followed(monkeypatch, settings, imposed, [SECOND // 2, SECOND], flat)
    assert found.steps < 0.8 * exact.steps


def test_a_single_point_is_no_corner():
    imposed = led(11)
    first = {k: getattr(imposed, k)[:1] for k in ("times", "positions", "rotations", "velocities")}
    assert len(replace(imposed, **first).corners(0.0, LENGTH)) == 0


@pytest.mark.parametrize("velocities", [False, True], ids=["polyline", "smooth"])
@pytest.mark.parametrize("flat", [False, True], ids=["space", "plane"])
def test_a_path_of_a_thousand_points_needs_few_steps(monkeypatch, velocities, flat):
    """As where each of its points ends a step, within what a step may add."""
    settings = replace(PAPER, simulation=replace(PAPER.simulation, tolerance=1e-3))
    imposed = led(1001, velocities=velocities, turning=0.3)
    stamps = [SECOND // 4, SECOND]
    found, exact = followed(monkeypatch, settings, imposed, stamps, flat)
    assert found.steps < 0.3 * exact.steps
    np.testing.assert_allclose(
        found.shapes[0, 0, :3], imposed.sample(stamps[0])[0][0], rtol=0.0, atol=1e-9
    )
