# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recorded motions along smooth paths, and the forces that corners would exaggerate."""

from dataclasses import replace

import numpy as np
from rods import PAPER, held_start
from scipy.spatial.transform import Rotation

from dlo_ros.cli.loads import borne
from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.observation import Observation
from dlo_ros.rod.first_guess import first_guess
from dlo_ros.rod.resolution import build
from dlo_ros.rod.statics import settle
from dlo_ros.smooth_command import smoothed

LENGTH, PERIOD, REACH, TURN = 0.4, 1.0, 0.05, 0.5


def swung(times, **others):
    """The start goes to and fro along x and turns about y, beginning at rest."""
    phase = 2.0 * np.pi * np.asarray(times) / PERIOD
    share = 0.5 - 0.5 * np.cos(phase)
    rotations = Rotation.from_rotvec(TURN * share[:, None] * [0.0, 1.0, 0.0]).as_quat()
    positions = np.column_stack([REACH * share, 0.0 * share, 0.0 * share])
    given = {"velocities": np.full((len(share), 1, 3), np.nan), "control_points": 10} | others
    return Command(0, ("start",), times, positions[:, None], rotations[:, None], **given)


def speeds(command, times):
    step = 1e-5
    return np.diff(command.positions_at(np.add.outer(times, [-step, step]).ravel())[:, 0, 0])[
        ::2
    ] / (2.0 * step)


def test_it_goes_through_the_points_as_the_motion_that_was_recorded_did():
    rate = np.arange(0.0, 1.001, 0.04)
    found = smoothed(swung(rate), LENGTH)
    fine = np.linspace(0.05, 0.95, 301)
    exact, rough = swung(fine), swung(rate)
    off = np.abs(found.positions_at(fine) - exact.positions).max()
    assert off < 0.1 * np.abs(rough.positions_at(fine) - exact.positions).max()
    np.testing.assert_allclose(found.positions_at(rate), rough.positions, atol=1e-12)
    for t in fine:
        _, rotation = found.sample(round(t * NANOSECONDS))
        turn = (Rotation.from_quat(rotation[0]) * Rotation.from_quat(exact.sample(
            round(t * NANOSECONDS))[1][0]).inv()).magnitude()  # fmt: skip
        assert turn < 1e-3
    # Velocities before and after a point agree, as those of straight pieces do not.
    beside = np.concatenate([rate[1:-1] - 1e-4, rate[1:-1] + 1e-4])
    before, after = speeds(found, beside).reshape(2, -1)
    assert np.abs(after - before).max() < 2e-3
    before, after = speeds(rough, beside).reshape(2, -1)
    assert np.abs(after - before).max() > 0.03


def test_a_corner_stays_one_and_velocities_that_are_given_stay():
    times = np.arange(0.0, 1.001, 0.1)
    corner = swung(times, velocities=np.full((11, 1, 3), np.nan))
    positions = np.zeros((11, 1, 3))
    positions[:, 0, 0] = 0.1 * np.minimum(times, 1.0 - times)
    found = smoothed(replace(corner, positions=positions), LENGTH)
    at = np.array([0.2, 0.497, 0.503, 0.8])
    np.testing.assert_allclose(speeds(found, at), [0.1, 0.1, -0.1, -0.1], atol=1e-6)
    assert found.times[-1] == 1.0 and np.all(np.diff(found.times) > 0.0)

    given = np.zeros((11, 1, 3))  # it stops at every point
    found = smoothed(swung(times, velocities=given), LENGTH)
    np.testing.assert_allclose(speeds(found, times[1:-1]), 0.0, atol=1e-3)


def test_two_points_are_a_straight_way():
    way = swung(np.array([0.0, 0.5]))
    assert smoothed(way, LENGTH) is way


def test_forces_in_a_report_are_those_of_the_motion_and_not_of_its_corners():
    """A light, stiff and short rod follows its grip: the force is that of mass and acceleration."""
    settings = replace(PAPER, rod=replace(PAPER.rod, young_modulus=5e9), gravity=(0.0, 0.0, -9.81))
    model, boundary = build(settings, held_start(), 10)
    straight = np.column_stack([boundary.published.greville, np.zeros((10, 3))])
    near = first_guess(model, boundary, held_start(), 0, straight)
    shape = settle(model, boundary, near, held_start(), 0).state.q[:10]
    times = np.arange(0.0, 1.001, 0.02)
    seen = tuple(Observation(round(t * NANOSECONDS), shape) for t in times)
    command = swung(times)
    (row,) = borne([Manipulation("push", (command,), seen)], settings)
    mass = settings.rod.linear_density * settings.rod.length
    weight = 9.81 * mass
    # REACH / 2 (2 pi / PERIOD)^2 = 1 m/s^2 along x, and what turning adds at half the length.
    assert weight < row.start < 1.6 * weight and row.end is None
