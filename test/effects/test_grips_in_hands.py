# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A hand holds the DLO beside where its frame says, or askew, and takes that along as it turns."""

from dataclasses import replace

import numpy as np
import pytest
from lifted_rods import shapes, simulate
from rods import PAPER, SECOND, command, held_start
from scipy.spatial.transform import Rotation

from dlo_ros.effects import build, effects
from dlo_ros.inference.scene import scene
from dlo_ros.parameters import Settings
from dlo_ros.rod.packing import true_command
from dlo_ros.rod.resolution import build as build_rod

OFFSET = np.array([0.004, -0.003, 0.002])
FRAMES = {"command.source": "tf", "command.start_frame": "hand"}


def turning(*, smooth=False, points=5):
    """A start that is led and turned at random, by some 0.8 rad between two points."""
    rng = np.random.default_rng(0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.5, (points, 3)), axis=0)).as_quat()
    times = np.cumsum(rng.uniform(0.3, 0.9, points))
    found = command(["start"], times, rng.normal(0.0, 0.1, (points, 3)), turns)
    speeds = rng.normal(0.0, 0.3, found.velocities.shape)
    return replace(found, velocities=speeds) if smooth else found


def moved_by(imposed, **offsets):
    (effect,) = build({"grip_offset": offsets})
    return effect.impose(imposed)


def missed(imposed, **offsets):
    """Largest distance [m] of the moved start from its frame's origin and R(t) d beside it."""
    true, worst = moved_by(imposed, **offsets), 0.0
    for stamp in np.linspace(-0.5, 4.5, 2001) * SECOND:
        (place,), (turn,) = imposed.sample(int(stamp))
        (there,), (same,) = true.sample(int(stamp))
        wanted = place + Rotation.from_quat(turn).apply(offsets["start"])
        worst = max(worst, float(np.linalg.norm(there - wanted)))
        assert abs(turn @ same) == pytest.approx(1.0, abs=1e-12)
    return worst


@pytest.mark.parametrize("smooth", [False, True])
def test_the_offset_turns_with_the_hand_between_points_far_apart_too(smooth):
    size = np.linalg.norm(OFFSET)
    # Where a turn begins at once, no velocity is that of both sides.
    assert missed(turning(smooth=smooth), start=tuple(OFFSET)) < (0.03 if smooth else 2e-3) * size
    assert missed(turning(smooth=smooth), start=(0.0, 0.0, 0.0)) < 1e-15


def test_a_hand_that_rests_before_it_turns_moves_nothing():
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.2]]).as_quat()
    resting = command(["start"], [0.0, 1.0, 2.0], np.zeros((3, 3)), turns)
    resting = replace(resting, velocities=np.zeros((3, 1, 3)))
    true = moved_by(resting, start=tuple(OFFSET))
    for stamp in range(0, SECOND + 1, SECOND // 20):
        np.testing.assert_allclose(true.sample(stamp)[0][0], OFFSET, atol=1e-15)


def test_only_the_clamp_that_is_told_is_moved():
    both = command(
        ["start", "end", "control_point_5"], [0.0], [[[0.0] * 3, [0.3, 0, 0], [0.1] * 3]]
    )
    true = moved_by(both, end=tuple(OFFSET))
    np.testing.assert_allclose(
        true.positions[0], [[0.0] * 3, np.add(OFFSET, [0.3, 0, 0]), [0.1] * 3]
    )
    free = command(["control_point_1", "control_point_2"], [0.0], [[[0.0] * 3, [0.02, 0, 0]]])
    assert np.array_equal(moved_by(free, start=tuple(OFFSET)).positions, free.positions)


def test_two_numbers_are_along_the_dlo_and_across_it_in_the_plane():
    turn = Rotation.from_rotvec([0.0, 0.3, 0.0])
    held = command(["start"], [0.0], [[0.0] * 3], turn.as_quat()[None])
    wanted = turn.apply([0.004, 0.0, 0.002])
    for roll in (0.0, 0.5 * np.pi, np.pi):  # a hand may take the DLO any way up
        rolled = turn * Rotation.from_rotvec([roll, 0.0, 0.0])
        there = moved_by(
            replace(held, rotations=rolled.as_quat()[None, None]), start=(0.004, 0.002)
        )
        np.testing.assert_allclose(there.positions[0, 0], wanted, atol=1e-15)
    three = moved_by(held, start=(0.004, 0.0, 0.002))
    np.testing.assert_allclose(three.positions[0, 0], wanted, atol=1e-15)
    assert three.positions[0, 0, 1] == 0.0  # so that the rod stays in its planar form


def test_it_is_the_commanded_frame_whatever_turns_the_clamp_besides():
    turned = {"clamp_angle": {"start": (0.1, 0.2, 0.3)}}
    own = {"grip_offset": {"start": tuple(OFFSET)}}
    askew = {"grip_angle": {"start": (0.2, 0.1)}}
    found = []
    for given in (turned | askew | own, own | askew | turned):
        model, _ = build_rod(PAPER.with_effects(given), held_start(), 14)
        found.append(true_command(model, turning()))
    np.testing.assert_array_equal(found[0].positions, found[1].positions)
    same = np.abs(np.einsum("tkc,tkc->tk", found[0].rotations, found[1].rotations))
    np.testing.assert_allclose(same, 1.0, atol=1e-14)
    np.testing.assert_array_equal(
        found[0].positions, moved_by(turning(), start=tuple(OFFSET)).positions
    )


def test_variants_of_a_command_have_the_same_points():
    """Derivatives are differences of commands: how many points there are depends on no value."""
    quarter = Rotation.from_rotvec([[0.0, 0.0, 0.1 * k] for k in range(8)])
    for axis in np.eye(3):
        counts = set()
        for amount in (-1e-5, 0.0, 1e-5):
            turned = Rotation.from_rotvec(amount * axis) * quarter
            there = command(["start"], np.arange(8.0), np.zeros((8, 3)), turned.as_quat())
            counts.add(len(moved_by(there, start=(amount, 0.0, 0.0)).times))
        assert counts == {8}


@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize("source", ["topic", "tf", "pose"])
def test_it_is_a_part_of_the_set_up_where_a_robots_frames_command(source, spatial):
    settings = Settings.from_mapping({**PAPER.flat(), **FRAMES, "command.source": source})
    shapes = np.zeros((2, 10, 3))
    shapes[:, :, 0] = np.linspace(0.0, 0.4, 10)
    shapes[:, :, 1] = 0.1 * shapes[:, :, 0] * spatial
    view = scene(settings, ["start"], [shapes])
    assert view.in_hands == (source != "topic")
    own = effects()["grip_offset"]
    nothing = {"start": (0.0,) * (3 if spatial else 2)}
    assert own.setup(view) == (nothing if source != "topic" else {})
    assert own.starts(view) == []
    assert effects()["clamp_offset"].setup(view) == nothing
    askew = effects()["grip_angle"]
    assert askew.setup(view) == ({"start": (0.0, 0.0)} if spatial and source != "topic" else {})
    assert askew.starts(view) == []


def test_a_grip_that_is_askew_in_the_hand_stays_so_as_it_turns():
    (effect,) = build({"grip_angle": {"start": (0.2, -0.1)}})
    imposed = turning()
    true = effect.impose(imposed)
    hands, grips = (Rotation.from_quat(c.rotations[:, 0]) for c in (imposed, true))
    np.testing.assert_allclose(
        (hands.inv() * grips).as_rotvec(), [[0.0, 0.2, -0.1]] * 5, atol=1e-14
    )
    np.testing.assert_array_equal(true.positions, imposed.positions)


def test_about_the_dlo_a_hand_may_be_anyhow():
    """The effect has no number about x for this reason: the DLO begins free of twist."""
    twisting = command(
        ["start"], [0.0, 0.2], [[0.0] * 3, [0.02, 0.05, 0.03]],
        Rotation.from_rotvec([[0.0] * 3, [0.5, 0.2, 0.3]]).as_quat(),
    )  # fmt: skip
    rolled = Rotation.from_quat(twisting.rotations[:, 0]) * Rotation.from_rotvec([0.7, 0.0, 0.0])
    stamps = range(SECOND // 20, SECOND // 4, SECOND // 20)
    plain, _ = simulate(PAPER, twisting, stamps)
    other, _ = simulate(PAPER, replace(twisting, rotations=rolled.as_quat()[:, None]), stamps)
    assert np.abs(shapes(plain)[..., 1]).max() > 0.01
    np.testing.assert_allclose(shapes(other), shapes(plain), atol=1e-7)
