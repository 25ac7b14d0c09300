# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where a straight wall may stand that a DLO has hit, by geometry."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.contact.peg_places import SLACK, STATIONS, Sight
from dlo_ros.diagnosis.contact.wall_places import TouchedWall, tangent, walls

ROD = PAPER.rod
DROP = 0.004
"""Drop of the level rope from one picture below to the next [m]."""
HEIGHT = -0.05


def landing(height, frames=40):
    """A level rope that falls on a table, pictures of it, and where it would be otherwise [m]."""
    u = np.linspace(0.04, 1.0, STATIONS) * ROD.length
    expected = np.zeros((frames, STATIONS, 2))
    expected[:, :, 0], expected[:, :, 1] = u, -DROP * np.arange(frames)[:, None]
    seen = expected.copy()
    seen[:, :, 1] = np.maximum(seen[:, :, 1], height)
    return Sight(ROD, (seen,), (expected,), (np.abs(seen - expected).max(axis=(1, 2)) > 1e-3,))


def test_a_wall_lies_where_the_observed_shapes_end():
    """And behind that as far as the DLO may have gone between two pictures."""
    view = landing(HEIGHT)
    found = walls(view)
    table, *others = (w for w in found if abs(w.angle) < 1e-6)
    assert table.z == pytest.approx(HEIGHT, abs=1e-6)
    first_wrong = view.expected[0][np.argmax(view.wrong[0]), 0, 1]
    assert max(w.z for w in others) == pytest.approx(HEIGHT + SLACK)
    assert min(w.z for w in others) == pytest.approx(first_wrong)
    start = table.start(ROD.diameter)
    assert start.effect == "wall" and not start.neutral
    assert start.block["offset"] == pytest.approx(HEIGHT - 0.5 * ROD.diameter, abs=1e-6)
    assert all(w.z > HEIGHT - 2.0 * DROP for w in found if np.cos(w.angle) > 0.9)


def test_a_wall_is_no_farther_than_predicted_shapes_reach_before_they_are_wrong():
    """A slow rope meets a table that no picture of it shows, but what is predicted does."""
    view = landing(HEIGHT)
    expected = np.maximum(view.expected[0], HEIGHT - 0.25 * DROP)
    tables = [w for w in walls(replace(view, expected=(expected,))) if abs(w.angle) < 1e-6]
    assert min(w.z for w in tables) == pytest.approx(HEIGHT - 0.25 * DROP, abs=1e-6)


def test_single_pictures_that_are_wrong_move_no_wall():
    view = landing(HEIGHT, 120)
    seen = view.seen[0].copy()
    seen[60, :, 1] -= 0.2
    assert tangent(replace(view, seen=(seen,)), 0.0).z == pytest.approx(HEIGHT, abs=1e-6)


def test_a_wall_turns_about_the_point_that_is_touched():
    wall = TouchedWall(0.1, -0.2, 0.3)
    turned, nearer = (wall.stepped(np.array(step), 0.01) for step in ((0.0, 0.5), (1.0, 0.0)))
    assert turned[:2] == wall[:2] and turned.angle == pytest.approx(0.8)
    here, there = (w.start(ROD.diameter).block for w in (wall, nearer))
    assert there["offset"] - here["offset"] == pytest.approx(0.01)
    assert there["angle"] == here["angle"] == pytest.approx(0.3)
    block = turned.start(ROD.diameter).block
    normal = np.array([np.sin(block["angle"]), np.cos(block["angle"])])
    assert normal @ wall[:2] - block["offset"] == pytest.approx(0.5 * ROD.diameter)


@pytest.mark.parametrize(("frames", "stands"), [(20, True), (60, False)])
def test_what_is_wrong_in_another_recording_hides_no_wall(frames, stands):
    """It goes astray far above the table, and is none if most pictures that are wrong are there."""
    view = landing(HEIGHT)
    above = np.zeros((frames, STATIONS, 2))
    above[:, :, 0] = view.seen[0][0, :, 0]
    other = Sight(
        ROD, (*view.seen, np.add(above, [0.0, 0.01])), (*view.expected, above),
        (*view.wrong, np.ones(frames, dtype=np.bool_)),
    )  # fmt: skip
    assert bool([w for w in walls(other) if abs(w.angle) < 1e-6]) == stands
