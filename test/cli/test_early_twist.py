# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Twist that clamps imposed before the DLO was first observed is told: it is not simulated."""

from dataclasses import replace

import numpy as np
import pytest
from rods import SECOND, command
from scipy.spatial.transform import Rotation

from dlo_ros.cli.early_twist import imposed_twist, tell_early_twist
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.observation import Observation

SHAPE = np.zeros((10, 4))
AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def clamped(turns, tilts=0.0, roll=0.0, names=("start", "end")):
    """A command of one point a second; the end turns about the DLO by `turns` [rad].

    Args:
        tilts: direction of the end at each point, in the board's plane [rad].
        roll: angle about its axis at which the end is held at first [rad].
    """
    turns = np.asarray(turns, dtype=float)
    tilts = np.broadcast_to(tilts, turns.shape)
    about = [
        np.outer(angles, axis) for angles, axis in zip((tilts, turns + roll), AXES, strict=True)
    ]
    end = Rotation.from_rotvec(about[0]) * Rotation.from_rotvec(about[1])
    rotations = np.zeros((len(turns), 2, 4))
    rotations[:, 0, 3], rotations[:, 1] = 1.0, end.as_quat()
    places = np.tile([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]], (len(turns), 1, 1))
    result = command(list(names), np.arange(float(len(turns))), places)
    return result.led_through(rotations=rotations)


@pytest.mark.parametrize("roll", [0.0, 2.0])
def test_full_turns_add_up_and_going_elsewhere_is_no_twist(roll):
    turns, tilts = 2.0 * np.arange(5.0), np.linspace(0.0, 1.2, 5)
    assert imposed_twist([clamped(turns, tilts, roll)], 4 * SECOND) == pytest.approx(8.0)
    assert imposed_twist([clamped(turns, tilts, roll)], 3 * SECOND // 2) == pytest.approx(
        3.0, rel=0.01
    )
    assert imposed_twist([clamped(0.0 * turns, tilts, roll)], 4 * SECOND) == pytest.approx(0.0)
    assert imposed_twist([clamped(turns)], 0) == 0.0


def test_one_clamp_twists_nothing():
    assert imposed_twist([clamped([0.0, 2.0], names=("control_point_1", "end"))], SECOND) == 0.0
    assert imposed_twist([], SECOND) == 0.0


def test_a_new_grip_takes_the_dlo_as_it_is():
    free = replace(clamped([0.0, 0.0], names=("control_point_1", "end")), stamp=2 * SECOND)
    again = replace(clamped([0.0, 0.5]), stamp=4 * SECOND)
    commands = [clamped([0.0, 2.0]), free, again]
    assert imposed_twist(commands, 2 * SECOND - 1) == pytest.approx(2.0)
    assert imposed_twist(commands, 3 * SECOND) == 0.0
    assert imposed_twist(commands, 6 * SECOND) == pytest.approx(0.5)


def test_it_is_told_with_the_mend(caplog):
    turning = (clamped([0.0, 2.0]),)
    tell_early_twist(Manipulation("late", turning, (Observation(SECOND // 2, SHAPE),)))
    assert "late: the commanded clamps twist the DLO by 57 degrees before its first" in caplog.text
    assert "0.50 s after they begin" in caplog.text and "record from before" in caplog.text
    caplog.clear()
    tell_early_twist(Manipulation("early", turning, (Observation(0, SHAPE),)))
    assert caplog.text == ""
