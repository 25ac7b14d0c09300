# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`dlo/points` of bags: read, brought to the board's frame, observed; and what is refused."""

import math

import numpy as np
import pytest
from point_lists import LENGTH, SETTINGS, N, bent, tracked
from scipy.spatial.transform import Rotation

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.cli.main import main
from dlo_ros.errors import InputError
from dlo_ros.recordings import topics
from dlo_ros.recordings.image_building import image_message
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    cloud_message,
    command_message,
    transform_message,
)
from dlo_ros.recordings.messages import read_point_list
from dlo_ros.recordings.point_lists import points_on_board
from dlo_ros.recordings.read import read_recording
from dlo_ros.recordings.transforms import Transforms
from dlo_ros.recordings.write import BagWriter, copy_topics
from dlo_ros.spline import SplineBasis

BEGIN = 1_750_000_000_000_000_000
STEP = 33_333_333
TURN = Rotation.from_rotvec([0.3, -1.0, 2.0])
PLACE = np.array([0.2, -0.5, 1.0])


def cloud(frame="board", seed=1, stamp=BEGIN, columns=(), curve=None):
    """A list of points as a message, in a frame that is turned and moved against the board."""
    seen = tracked(curve or bent(1), seed)
    points = seen.positions if frame == "board" else TURN.inv().apply(seen.positions - PLACE)
    table = np.column_stack([points, *(np.full(len(points), v) for _, v in columns)])
    return cloud_message(
        BAG_MESSAGES, stamp, frame, ("x", "y", "z", *(n for n, _ in columns)), table
    )


def transform(parent="board", child="tracker", stamp=BEGIN, place=PLACE, turn=TURN):
    return transform_message(BAG_MESSAGES, stamp, parent, child, place, turn.as_quat())


def bag(path, frame="board", told=True, frames=3):
    curve = bent(1)
    with BagWriter(path) as writer:
        command = curve.motion().commands[0]
        message = command_message(BAG_MESSAGES, command)
        message.header.stamp = cloud().header.stamp
        writer.write(topics.COMMAND, message, BEGIN)
        if told:
            writer.write(topics.TRANSFORMS, transform(), BEGIN)
        for k in range(frames):
            stamp = BEGIN + k * STEP
            writer.write(topics.POINTS, cloud(frame, k, stamp), stamp)
    return path


@pytest.fixture
def params(tmp_path):
    SETTINGS.dump(tmp_path / "params.yaml")
    return str(tmp_path / "params.yaml")


@pytest.mark.parametrize("frame", ["board", "tracker"])
def test_observe_writes_what_the_points_show(frame, tmp_path, params, capsys):
    source, output = bag(tmp_path / "bag", frame), tmp_path / "seen"
    assert main(["observe", "--params", params, "--output", str(output), str(source)]) == 0
    assert "3 of 3 lists of points show the DLO" in capsys.readouterr().out
    found = read_recording(output, SETTINGS)
    assert len(found.observations) == 3 and found.commands and found.has_points
    curve, u = bent(1), np.linspace(0.0, LENGTH, 100)
    for seen in found.observations:
        shape = SplineBasis(N, LENGTH).evaluate(seen.control_points[:, :3], u)
        assert np.sqrt(np.mean(np.sum((shape - curve.at(u)) ** 2, axis=1))) < 0.003
        assert seen.points.std_along is not None


def test_tools_observe_points_by_themselves(tmp_path):
    manipulation = load_manipulation(bag(tmp_path / "bag"), SETTINGS)
    assert len(manipulation.observations) == 3


def with_images(path, topic="image_raw", **options):
    """A bag of points, and of images that show nothing."""
    bag(path.parent / "points", **options)
    nothing = image_message(BAG_MESSAGES, BEGIN, "camera", np.zeros((48, 64, 3), dtype=np.uint8))
    with BagWriter(path) as writer:
        copy_topics(path.parent / "points", writer)
        writer.write(topic, nothing, BEGIN)
    return path


def test_where_there_are_images_too_the_user_chooses(tmp_path, params, capsys, caplog):
    source, seen = with_images(tmp_path / "both"), tmp_path / "seen"
    call = ["observe", "--params", params, "--output", str(seen), str(source)]
    assert main(call) == 2 and "camera_info" in capsys.readouterr().err
    told = f"{source}: has images and dlo/points of another tracker; the images are observed"
    assert told in caplog.text and "with --points first" in caplog.text
    caplog.clear()
    with pytest.raises(InputError, match="camera_info"):
        load_manipulation(source, SETTINGS)
    assert told in caplog.text
    caplog.clear()
    assert main([*call, "--points"]) == 0 and not caplog.text
    assert "3 of 3 lists of points" in capsys.readouterr().out
    assert len(load_manipulation(seen, SETTINGS).observations) == 3 and not caplog.text
    assert main([*call, "--points", "--force", "--overlays", str(tmp_path)]) == 2
    assert "its dlo/points are observed, and no images" in capsys.readouterr().err


def test_depth_images_beside_points_are_no_images(tmp_path, params, capsys, caplog):
    source = with_images(tmp_path / "both", topics.DEPTH)
    call = ["observe", "--params", params, "--output", str(tmp_path / "seen"), str(source)]
    assert main(call) == 0 and not caplog.text
    assert "3 of 3 lists of points" in capsys.readouterr().out


def test_points_that_are_not_there_cannot_be_chosen(tmp_path, params, capsys):
    source = tmp_path / "bag"
    with BagWriter(source) as writer:
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, bent(1).motion().commands[0]), 1)
    call = ["observe", "--points", "--params", params, "--output", str(tmp_path / "seen")]
    assert main([*call, str(source)]) == 2
    assert "has no dlo/points; leave --points away" in capsys.readouterr().err
    assert main([*call, str(tmp_path / "picture.png")]) == 2
    assert "is no bag; --points is for bags" in capsys.readouterr().err


def test_a_frame_that_nothing_leads_to_is_named(tmp_path, params, capsys):
    source = bag(tmp_path / "bag", "tracker", told=False)
    call = ["observe", "--params", params, "--output", str(tmp_path / "seen"), str(source)]
    assert main(call) == 2
    told = capsys.readouterr().err
    assert "dlo/points is in frame 'tracker'" in told and "'board'" in told
    assert main([*call, "--overlays", str(tmp_path)]) == 2


def test_fields_of_points():
    both = read_point_list(cloud(columns=(("u", 0.1), ("std", 0.002))))
    assert np.allclose(both.u, 0.1) and np.allclose(both.std, 0.002)
    plain = read_point_list(cloud())
    assert plain.u is None and plain.std is None
    with pytest.raises(InputError, match="no usable point"):
        read_point_list(cloud(columns=(("std", -1.0),)))
    lacking = cloud()
    lacking.fields = lacking.fields[:2]
    with pytest.raises(InputError, match="lacks the float field z"):
        read_point_list(lacking)


def test_a_transform_that_ended_long_ago_is_refused():
    transforms = Transforms()
    transforms.add(transform(), fixed=False)
    points_on_board(cloud("tracker"), SETTINGS, transforms)
    late = cloud("tracker", stamp=BEGIN + 2_000_000_000)
    with pytest.raises(InputError, match=r"'tracker' in 'board' ends 2.00 s before"):
        points_on_board(late, SETTINGS, transforms)
    transforms.add(transform(stamp=BEGIN + 2_000_000_000), fixed=False)
    points_on_board(late, SETTINGS, transforms)


def test_moving_frames_are_interpolated_and_forgotten():
    transforms = Transforms()
    later = BEGIN + 1_000_000_000
    half = Rotation.from_rotvec([0.0, 0.0, 1.0])
    transforms.add(transform("base", "hand", turn=Rotation.identity()), fixed=False)
    transforms.add(transform("base", "hand", later, 3.0 * PLACE, half), fixed=False)
    transforms.add(transform("base", "board", place=-PLACE, turn=TURN), fixed=True)
    turned, moved = transforms.lookup("hand", "board", [BEGIN + 250_000_000])
    back = TURN.inv()
    assert np.allclose(moved[0], back.apply(1.5 * PLACE + PLACE))
    expected = back * Rotation.from_rotvec([0.0, 0.0, 0.25])
    assert np.allclose(turned[0], expected.as_matrix())
    assert transforms.instants("hand", "board") == [BEGIN, later]
    transforms.forget(later + 1)
    assert transforms.instants("hand", "board") == [later]
    transforms.forget()
    with pytest.raises(InputError, match="no transform leads from 'hand'"):
        transforms.check("hand", "board", later)


@pytest.mark.parametrize(
    "bad", [(math.nan, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)]
)
def test_rotations_that_are_none_are_refused_and_the_others_of_the_message_taken(bad):
    message, good = transform(), transform(child="hand")
    r = message.transforms[0].transform.rotation
    r.x, r.y, r.z, r.w = bad
    message.transforms.append(good.transforms[0])
    transforms = Transforms()
    with pytest.raises(InputError, match="rotation of tracker"):
        transforms.add(message, fixed=True)
    assert transforms.parents == {"hand": "board"}


def test_of_lists_of_one_stamp_one_counts(tmp_path, caplog):
    """Two trackers with one clock, or a list that was recorded twice, in another order."""
    source = bag(tmp_path / "bag", frames=1)
    with BagWriter(tmp_path / "two") as writer:
        copy_topics(source, writer, exclude=(topics.POINTS,))
        for k, late in enumerate((2, 0, 0, 1, 1)):
            stamp = BEGIN + late * STEP
            writer.write(topics.POINTS, cloud("board", k, stamp), BEGIN + k)
    found = load_manipulation(tmp_path / "two", SETTINGS)
    assert [o.stamp for o in found.observations] == [BEGIN + k * STEP for k in range(3)]
    assert "no list of points counts beside another of its stamp: 2 are left out" in caplog.text
