# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Cameras calibrated to one another and to the board."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from calibration_scenes import DISTORTION, MATRIX, SIZE, Lens, chessboard, pixels_of, turned
from scipy.spatial.transform import Rotation

from dlo_ros.cli.calibrate_cameras import write_cameras
from dlo_ros.cli.main import main
from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.vision.calibration.camera_file import camera_file
from dlo_ros.vision.calibration.camera_fit import Intrinsics
from dlo_ros.vision.calibration.camera_network import calibrate_cameras
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Charuco, parse_pattern

PATTERN = parse_pattern("chessboard:7x5:0.02")
LENS = Intrinsics(MATRIX, DISTORTION, "plumb_bob", *SIZE)
BOTH = {"left": LENS, "right": LENS}
# The left camera in the right one's frame: 60 mm aside, looking across.
ACROSS = Rotation.from_rotvec([0.01, 0.12, 0.02]).as_matrix()
ASIDE = np.array([-0.06, 0.004, 0.008])
TILTS = ((0.0, 0.0, 0.0), (0.35, 0.1, 0.2), (-0.3, 0.3, -0.1), (0.1, -0.35, 0.05))


def sights():
    """The pattern's pose in the left camera at each instant; the first one is the board's."""
    for k, tilt in enumerate(TILTS):
        yield turned(*tilt), np.array([0.02 * (k - 1), 0.01 * k, 0.42 + 0.02 * k])


def view(name, rotation, translation, rng, half_turn=False, pattern=PATTERN):
    corners = np.arange(len(pattern.points))
    points = pattern.points * ([-1.0, -1.0, 1.0] if half_turn else 1.0)
    pixels = pixels_of(points, rotation, translation) + rng.normal(0.0, 0.05, (len(points), 2))
    return PatternView(name, *SIZE, corners, pixels, 2.0)


def instants(rng, aside=ASIDE):
    result = []
    for k, (rotation, translation) in enumerate(sights()):
        right = ACROSS @ rotation, ACROSS @ translation + aside
        result.append(
            {"left": view(f"l{k}", rotation, translation, rng),
             "right": view(f"r{k}", *right, rng, half_turn=k % 2 == 1)}
        )  # fmt: skip
    return result


def check_poses(poses, tolerance):
    """The board's origin in both cameras, and how one is turned to the other."""
    _, centre = next(sights())
    np.testing.assert_allclose(poses["left"].translation, centre, atol=tolerance)
    np.testing.assert_allclose(
        poses["right"].translation, ACROSS @ centre + ASIDE, atol=1.5 * tolerance
    )
    left, right = (Rotation.from_quat(poses[n].rotation).as_matrix() for n in ("left", "right"))
    turn = Rotation.from_matrix(right @ left.T @ ACROSS.T).magnitude()
    assert turn < 5.0 * tolerance
    # z of the board is up in the picture, y away from the camera.
    np.testing.assert_allclose(left[:, 2], [0.0, -1.0, 0.0], atol=0.02)


def test_the_board_in_both_cameras():
    found = calibrate_cameras(instants(np.random.default_rng(1)), 0, BOTH, PATTERN)
    check_poses(found.poses, 3e-4)
    distance, std = found.distances["right"]
    assert distance == pytest.approx(np.linalg.norm(ASIDE), abs=max(4.0 * std, 1e-4))
    assert 0.0 < std < 1e-3
    assert found.instants == 4 and found.rms < 0.12


def test_a_small_standard_deviation_is_told(tmp_path):
    found = calibrate_cameras(instants(np.random.default_rng(1)), 0, BOTH, PATTERN)
    found = replace(found, distances={"right": (0.0617982, 3.2e-5)})
    told = write_cameras(found, tmp_path / "cameras.yaml")
    assert told.startswith("right 61.798 +- 0.032 mm from left; corners within 0.")


def rolled(pattern, angle, tilts, rng, farthest=0.0):
    """Instants of a right camera that is turned about its axis by an angle [rad], and that turn.

    A pattern that says which corner is which is never counted from the other end.
    """
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix() @ ACROSS
    told = isinstance(pattern, Charuco)
    result = []
    for k, tilt in enumerate(tilts):
        rotation, away = turned(*tilt), 0.0 if k else farthest
        translation = np.array([0.02 * (k - 1), 0.01 * k - 0.02, 0.42 + 0.02 * k + away])
        there = turn @ rotation, turn @ translation + ASIDE
        result.append(
            {"left": view(f"l{k}", rotation, translation, rng, pattern=pattern),
             "right": view(f"r{k}", *there, rng, k % 2 == 1 and not told, pattern)}
        )  # fmt: skip
    return result, turn


def check_turn(found, turn):
    left, right = (
        Rotation.from_quat(found.poses[n].rotation).as_matrix() for n in ("left", "right")
    )
    assert Rotation.from_matrix(right @ left.T @ turn.T).magnitude() < 1.5e-3
    assert found.distances["right"][0] == pytest.approx(np.linalg.norm(ASIDE), abs=5e-4)


@pytest.mark.parametrize("angle", [1.0, 0.5 * np.pi, np.pi, -0.5 * np.pi])
@pytest.mark.parametrize(
    "text", ["chessboard:7x5:0.02", "chessboard:6x6:0.02", "charuco:7x5:0.02:0.015:5X5_100"]
)
def test_a_camera_may_be_mounted_turned(text, angle):
    pattern = parse_pattern(text)
    seen, turn = rolled(pattern, angle, TILTS, np.random.default_rng(4))
    check_turn(calibrate_cameras(seen, 0, BOTH, pattern), turn)


@pytest.mark.parametrize("seed", range(4))
def test_a_view_whose_tilt_is_ambiguous_does_not_mislead(seed):
    """A small pattern seen from the front has two poses; the first instant has it."""
    seen, turn = rolled(PATTERN, 0.0, TILTS, np.random.default_rng(seed), farthest=2.6)
    check_turn(calibrate_cameras(seen, 1, BOTH, PATTERN), turn)


def test_one_instant_tells_of_a_turned_camera_with_markers_only():
    rng, markers = np.random.default_rng(5), parse_pattern("charuco:7x5:0.02:0.015:5X5_100")
    seen, _ = rolled(PATTERN, 0.5 * np.pi, TILTS[1:2], rng)
    with pytest.raises(InputError, match=r"'right' stands turned .* tilted otherwise in each"):
        calibrate_cameras(seen, 0, BOTH, PATTERN)
    seen, turn = rolled(markers, 0.5 * np.pi, TILTS[1:2], rng)
    found = calibrate_cameras(seen, 0, BOTH, markers)
    assert found.instants == 1
    right = Rotation.from_quat(found.poses["right"].rotation).as_matrix()
    left = Rotation.from_quat(found.poses["left"].rotation).as_matrix()
    assert Rotation.from_matrix(right @ left.T @ turn.T).magnitude() < 0.02


def test_pictures_of_other_instants_are_refused():
    mixed = instants(np.random.default_rng(2))
    mixed[1]["right"], mixed[2]["right"] = mixed[2]["right"], mixed[1]["right"]
    with pytest.raises(InputError, match="taken at the same instant"):
        calibrate_cameras(mixed, 0, BOTH, PATTERN)
    apart = [{"left": i["left"]} if k % 2 else {"right": i["right"]} for k, i in enumerate(mixed)]
    with pytest.raises(InputError, match="no common instant"):
        calibrate_cameras(apart, 1, BOTH, PATTERN)


def test_what_the_tool_refuses(tmp_path, capsys):
    (tmp_path / "left.yaml").write_text(camera_file(LENS))
    for name in ("l", "r"):
        (tmp_path / name).mkdir()
    folders = [str(tmp_path / "l"), str(tmp_path / "r")]
    info = str(tmp_path / "left.yaml")
    call = ["calibrate", "--pattern", "chessboard:7x5:0.02", "--output", str(tmp_path / "out")]
    for words, message in (
        ([*folders, "--cameras", "left"], "give NAME=CAMERA_INFO"),
        ([*folders, "--cameras", f"left={info}"], "two cameras or more"),
        ([folders[0], "--cameras", f"left={info}", f"right={info}"],
         "names 2 cameras, and there are 1 folders; give one folder of pictures for each"),
        ([folders[0], str(tmp_path / "none"), "--cameras", f"left={info}", f"right={info}"],
         "none: is no folder"),
        ([*folders, "--cameras", f"left={info}", f"right={info}"], "--board is missing"),
        ([*folders, "--board", "b.png", "--cameras", f"left={info}", f"right={info}"],
         f"b.png: is not in {tmp_path / 'l'}, the folder of the camera 'left'"),
    ):  # fmt: skip
        assert main([*call, *words]) == 2
        assert message in capsys.readouterr().err
    (tmp_path / "l" / "b.png").write_text("no picture")
    assert main([*call, *words]) == 2
    assert capsys.readouterr().err.count(str(tmp_path / "l" / "b.png")) == 1


def pictures(folder, count, side="left"):
    """Pictures of the pattern from one of the cameras, in a folder."""
    lens, rng = Lens(), np.random.default_rng(3)
    for k, (rotation, translation) in list(enumerate(sights()))[:count]:
        pose = rotation, translation
        if side == "right":
            pose = ACROSS @ rotation, ACROSS @ translation + ASIDE
        folder.mkdir(exist_ok=True)
        image = lens.picture(chessboard(7, 5), 0.02 / 24, *pose, rng)
        cv2.imwrite(str(folder / f"{k}.png"), image)


def test_cameras_that_see_no_common_pattern_are_named(tmp_path, capsys):
    left, right = tmp_path / "l", tmp_path / "r"
    pictures(left, 2)
    right.mkdir()
    (tmp_path / "info.yaml").write_text(camera_file(LENS))
    cameras = [f"{name}={tmp_path / 'info.yaml'}" for name in ("left", "right")]
    call = ["calibrate", "--pattern", "chessboard:7x5:0.02", "--output", str(tmp_path / "out")]
    call += ["--board", "0.png", "--cameras", *cameras, "--", str(left), str(right)]

    def refused():
        assert main(call) == 2
        return capsys.readouterr().err

    assert f"{right}: none of the 0 pictures of the camera 'right' shows the pattern" in refused()
    cv2.imwrite(str(right / "1.png"), np.full((600, 800, 3), 128, dtype=np.uint8))
    assert f"{right}: none of the 1 pictures of the camera 'right' shows the pattern" in refused()
    (right / "1.png").write_bytes((left / "1.png").read_bytes())
    (right / "1.png").rename(right / "other.png")
    assert f"{right}: no picture of the camera 'right' has the name of one of 'left'" in refused()
    cv2.imwrite(str(right / "1.png"), np.full((600, 800, 3), 128, dtype=np.uint8))
    told = refused()
    assert "'left' and 'right' never see the pattern at the same time: 'left' in 0.png" in told
    assert "'right' in other.png; show it where their views overlap" in told
    (right / "metadata.yaml").write_text("")
    assert f"{right}: is a bag; --cameras needs one folder of pictures for each" in refused()


def test_the_pictures_that_fit_worst_are_named():
    mixed = instants(np.random.default_rng(2))
    broken = mixed[2]["right"]
    moved = PatternView("r2", *SIZE, broken.corners, broken.pixels + 30.0, 2.0)
    with pytest.raises(InputError, match="most in l2 and r2; were the pictures of equal name"):
        calibrate_cameras([*mixed[:2], {**mixed[2], "right": moved}, mixed[3]], 0, BOTH, PATTERN)


def test_one_camera_given_twice_is_refused():
    views = instants(np.random.default_rng(2))
    twice = [{"left": views[k]["left"], "right": views[k]["left"]} for k in range(len(views))]
    with pytest.raises(InputError, match=r"'left' and 'right' are found at one place, 0\.0 mm"):
        calibrate_cameras(twice, 0, BOTH, PATTERN)


@pytest.mark.slow
def test_from_pictures_to_a_parameter_file(tmp_path, capsys):
    pictures(tmp_path / "l", 4)
    pictures(tmp_path / "r", 4, "right")
    (tmp_path / "info.yaml").write_text(camera_file(LENS))
    call = ["calibrate", "--pattern", "chessboard:7x5:0.02", "--output", str(tmp_path / "out")]
    cameras = [f"{name}={tmp_path / 'info.yaml'}" for name in ("left", "right")]
    call += [str(tmp_path / "l"), str(tmp_path / "r"), "--board", "0.png", "--cameras", *cameras]
    assert main(call) == 0
    told = re.search(r"right (60\.\d+) \+- (\S+) mm from left", capsys.readouterr().out)
    assert told is not None and 0.0 < float(told[2]) < 1.0
    rod = "/**:\n  ros__parameters:\n    rod: {length: 0.4, diameter: 0.004, density: 2000.0, "
    (tmp_path / "p.yaml").write_text(
        rod
        + "young_modulus: 1000000.0}\n"
        + "".join((tmp_path / "out" / "cameras.yaml").read_text().split("ros__parameters:\n")[1:])
    )
    check_poses(Settings.load(tmp_path / "p.yaml").cameras, 1e-3)
