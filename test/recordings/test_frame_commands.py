# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The imposed motion from a robot's frames and poses in a bag; and what is refused."""

from contextlib import nullcontext
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest
from point_lists import SETTINGS, bent, tracked
from scipy.spatial.transform import Rotation

from dlo_ros.cli.main import main
from dlo_ros.errors import ParameterError, RecordingError
from dlo_ros.observation import Observation
from dlo_ros.parameters import CommandParameters, Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import deserialise, open_bag
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    cloud_message,
    float_message,
    header,
    transform_message,
)
from dlo_ros.recordings.read import read_recording
from dlo_ros.recordings.tables import write_bag
from dlo_ros.recordings.transforms import common_instants
from dlo_ros.recordings.write import BagWriter

BEGIN = 1_750_000_000_000_000_000
STEP = 10_000_000
COUNT = 50
OFFSET = (0.0, 0.01, 0.1, *Rotation.from_rotvec([0.0, -np.pi / 2.0, 0.0]).as_quat().tolist())
"""The gripper's z axis points along the DLO, 0.1 m before the flange."""
BASE = (np.array([0.3, 0.2, -0.1]), Rotation.from_rotvec([0.0, 0.0, 0.7]))
"""The robot's base on the board."""


def flange(k, end="start"):
    """Place and rotation of a flange in the base at step k."""
    sign = 1.0 if end == "start" else -1.0
    return np.array([0.1 * sign + 0.002 * k, 0.0, 0.3]), Rotation.from_rotvec([0.0, 0.01 * k, 0.2])


def clamp(k, end="start"):
    """Place and rotation of the clamp on the board."""
    place, turn = flange(k, end)
    at = place + turn.apply(OFFSET[:3])
    return BASE[0] + BASE[1].apply(at), BASE[1] * turn * Rotation.from_quat(OFFSET[3:])


def pose_message(k, end="start", frame="base"):
    place, turn = flange(k, end)
    kinds = "geometry_msgs/msg/"
    x, y, z = place.tolist()
    point = BAG_MESSAGES.make(kinds + "Point", x=x, y=y, z=z)
    x, y, z, w = turn.as_quat().tolist()
    rotation = BAG_MESSAGES.make(kinds + "Quaternion", x=x, y=y, z=z, w=w)
    pose = BAG_MESSAGES.make(kinds + "Pose", position=point, orientation=rotation)
    stamp = header(BAG_MESSAGES, BEGIN + k * STEP, frame)
    return BAG_MESSAGES.make(kinds + "PoseStamped", header=stamp, pose=pose)


def bag(
    path, ends=("start", "end"), poses=False, base=True, spoil=None, lost=(), late=0, seen=(0,),
    only=MappingProxyType({}), ahead=MappingProxyType({}),
):  # fmt: skip
    with BagWriter(path) as writer:
        if base:
            message = transform_message(
                BAG_MESSAGES, BEGIN, "board", "base", BASE[0], BASE[1].as_quat()
            )
            writer.write(topics.TRANSFORMS, message, BEGIN)
        for k in (k for k in range(COUNT) if k not in lost):
            stamp = BEGIN + k * STEP + late
            for end in (e for e in ends if k in only.get(e, [k])):
                place, turn = flange(k, end)
                if poses:
                    message = pose_message(k, end)
                    message.header.stamp.sec += ahead.get(end, 0)
                    q = message.pose.orientation
                else:
                    message = transform_message(
                        BAG_MESSAGES, stamp, "base", f"{end}_tool", place, turn.as_quat()
                    )
                    q = message.transforms[0].transform.rotation
                if spoil is not None and k == 3:
                    q.w = spoil
                topic = topics.MOVING_TRANSFORMS
                if poses:
                    topic = topics.START_POSE if end == "start" else topics.END_POSE
                writer.write(topic, message, stamp)
        points = tracked(bent(1), 1).positions
        for stamp in (BEGIN + k for k in seen):
            message = cloud_message(BAG_MESSAGES, stamp, "board", ("x", "y", "z"), points)
            writer.write(topics.POINTS, message, stamp)
    return path


def settings(source="tf", start="start_tool", end="end_tool"):
    own = CommandParameters(source, start, end, OFFSET, OFFSET)
    return replace(SETTINGS, command=own)


@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("ends", [("start",), ("start", "end"), ("end",)])
def test_frames_and_poses_become_the_motion_of_the_clamps(poses, ends, tmp_path):
    told = settings(
        "pose" if poses else "tf", *(f"{e}_tool" if e in ends else "" for e in ("start", "end"))
    )
    (command,) = read_recording(bag(tmp_path / "bag", ends, poses), told).commands
    assert command.names == ends and command.stamp == BEGIN and len(command.times) == COUNT
    for k in (0, 17, COUNT - 1):
        positions, rotations = command.sample(BEGIN + k * STEP)
        for at, end in enumerate(ends):
            place, turn = clamp(k, end)
            assert np.allclose(positions[at], place, atol=1e-9)
            assert abs(np.dot(rotations[at], turn.as_quat())) == pytest.approx(1.0, abs=1e-12)
    between, _ = command.sample(BEGIN + 17 * STEP + STEP // 2)
    middle = 0.5 * (clamp(17, ends[0])[0] + clamp(18, ends[0])[0])
    assert np.allclose(between[0], middle, atol=1e-6)


def test_frames_that_stand_still_are_a_command_that_holds(tmp_path):
    told = settings(start="base", end="")
    (command,) = read_recording(bag(tmp_path / "bag"), told).commands
    assert len(command.times) == 1 and command.names == ("start",)


@pytest.mark.parametrize(
    ("told", "options", "word"),
    [
        (settings(start="other"), {}, "no transform leads from 'other' to 'board'"),
        (settings(), {"base": False}, "no transform leads from 'start_tool' to 'board'"),
        (settings("pose"), {}, "no usable message on dlo/start_pose or dlo/end_pose"),
        (settings("pose"), {"poses": True, "base": False}, "no transform leads from"),
        (SETTINGS, {}, "has no dlo/command"),
    ],
)
def test_frames_that_are_missing_are_named(told, options, word, tmp_path):
    with pytest.raises(RecordingError, match=word):
        read_recording(bag(tmp_path / "bag", **options), told)


@pytest.mark.parametrize("source", ["tf", "pose"])
def test_a_motion_that_was_imported_as_a_command_is_told(source, tmp_path):
    made = read_recording(bag(tmp_path / "bag"), settings())
    shape = np.linspace([0.0] * 4, [0.3, 0.0, 0.0, 0.0], SETTINGS.rod.control_points)
    observation = Observation(BEGIN, shape)
    write_bag(tmp_path / "again", SETTINGS, made.commands, [observation])
    with pytest.raises(RecordingError, match="motion on dlo/command: for that set"):
        read_recording(tmp_path / "again", settings(source))
    again = read_recording(tmp_path / "again", SETTINGS)
    assert np.allclose(again.commands[0].positions, made.commands[0].positions)


@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("spoil", [float("nan"), 5.0])
def test_rotations_that_are_none_are_left_out_and_told(poses, spoil, tmp_path, caplog):
    told = settings("pose" if poses else "tf")
    (command,) = read_recording(bag(tmp_path / "bag", poses=poses, spoil=spoil), told).commands
    assert len(command.times) == COUNT - 1
    assert "the rotation of" in caplog.text


def test_gaps_of_the_frames_are_told_and_other_clocks_refused(tmp_path, caplog, monkeypatch):
    read_recording(bag(tmp_path / "whole"), settings())
    assert "no frames for" not in caplog.text
    monkeypatch.setattr(f"{__name__}.COUNT", 100)
    read_recording(bag(tmp_path / "gap", lost=range(5, 95)), settings())
    assert "start_tool, end_tool: no frames for 0.9 s from 1750000000.040 s" in caplog.text
    read_recording(bag(tmp_path / "once", lost=range(1, 100)), settings())
    assert "frame of" not in caplog.text  # clamps that stay may be told once
    read_recording(bag(tmp_path / "end", seen=(0, 2 * 10**9)), settings())
    assert (
        "dlo/points: seen up to 1.0 s after the last frame of start_tool, end_tool" in caplog.text
    )
    for late in (3600 * 10**9, -3600 * 10**9):
        with pytest.raises(RecordingError, match=r"dlo/points, .* outside the time of start_"):
            read_recording(bag(tmp_path / str(late), late=late), settings())


@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("told", [0, COUNT // 2, COUNT - 1])
def test_a_clamp_that_is_told_once_stays_while_the_other_moves(poses, told, tmp_path):
    path, source = tmp_path / "bag", "pose" if poses else "tf"
    once = bag(path, poses=poses, only={"end": [told]})
    (command,) = read_recording(once, settings(source)).commands
    assert len(command.times) == COUNT
    for k in (0, 20, COUNT - 1):
        positions, _ = command.sample(BEGIN + k * STEP)
        assert np.allclose(positions, [clamp(k)[0], clamp(told, "end")[0]], atol=1e-9)


def test_clamps_whose_clocks_differ_are_refused(tmp_path):
    """Each moves by its own clock, so that there is no motion of both."""
    apart = bag(tmp_path / "bag", poses=True, ahead={"end": 3600})
    with pytest.raises(
        RecordingError, match=r"until 1750000000\.490 s, and another one from 17500"
    ):
        read_recording(apart, settings("pose"))


def test_a_robot_that_begins_is_not_taken_to_stay():
    """Live, one pose has come of each frame before there are two."""
    moving, begun = list(range(0, 100, 10)), [50]
    assert common_instants([moving, begun], settled=40) == [50]
    assert common_instants([moving, begun], settled=60) == moving
    assert common_instants([moving, begun], 75, settled=60) == [80, 90]
    assert common_instants([begun, [70]]) == []


@pytest.fixture
def live():
    """Live frames without a graph: their commands, clock, warnings and published topics."""
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.live_frame_commands import POSES, FrameCommands

    commands, clock, warned, published = [], [BEGIN], [], set(POSES.values())
    health = SimpleNamespace(
        solved=lambda what: None,
        count=lambda what: None,
        warn=lambda what, text: warned.append(text),
    )
    node = SimpleNamespace(
        settings=settings("pose"), health=health, now=lambda: clock[0],
        every=lambda period, callback: None, subscribe=lambda *a, **options: None,
        is_published=published.__contains__, check_stamp=lambda stamp, what: None,
    )  # fmt: skip
    frames = FrameCommands(node, commands.append)
    base = transform_message(BAG_MESSAGES, BEGIN, "board", "base", BASE[0], BASE[1].as_quat())
    frames._listener.transforms.add(base, fixed=True)
    return SimpleNamespace(
        frames=frames, commands=commands, clock=clock, warned=warned, published=published, **POSES
    )


def test_live_a_clamp_that_is_told_once_does_not_stop_the_other(live):
    """The logic alone: three seconds of poses, a look at them every 20 ms."""
    frames, commands, clock = live.frames, live.commands, live.clock
    frames._on_pose(live.end, pose_message(0, "end"))
    for k in range(300):
        clock[0] = BEGIN + k * STEP
        frames._on_pose(live.start, pose_message(k))
        if k % 2:
            frames._proceed()
            frames._look()
    assert commands[-1].end_stamp == clock[0] and not live.warned
    positions, _ = commands[-1].sample(clock[0])
    assert np.allclose(positions, [clamp(299)[0], clamp(0, "end")[0]], atol=1e-9)


def test_live_a_pose_of_another_clock_stops_none_of_the_others(live):
    """One of a frame of /tf; what comes on the topics of poses is looked at there."""
    frames, clock = live.frames, live.clock
    live.published.remove(live.end)
    for k in range(100):
        clock[0] = BEGIN + k * STEP
        frames._on_pose(live.start, pose_message(10_000 if k == 50 else k))
        frames._proceed()
    assert live.commands[-1].end_stamp == clock[0] and not live.warned
    frames._look()
    assert "s ahead of the clock" in live.warned[0]


def test_the_ends_of_a_topic_are_read_without_what_lies_between(tmp_path):
    """Ten seconds of shapes; a namespace of its own that is silent for the last nine."""
    with BagWriter(tmp_path / "bag") as writer:
        for k in range(101):
            stamp = BEGIN + k * 100_000_000
            writer.write("dlo/err", float_message(BAG_MESSAGES, float(k)), stamp)
            if k < 10:
                writer.write("left/dlo/err", float_message(BAG_MESSAGES, -float(k)), stamp)
    with open_bag(tmp_path / "bag") as opened:
        ends = opened.ends("dlo/err")
        values = {n: [deserialise(m).data for m in both] for n, both in ends.items()}
        assert values == {"/dlo/err": [0.0, 100.0], "/left/dlo/err": [0.0, -9.0]}
        own = [c for c in opened.connections if c.topic == "/dlo/err"]
        late = list(opened.messages(own, since=opened.end - 1_000_000_000))
        assert [deserialise(m).data for m in late] == [float(k) for k in range(90, 101)]
        assert opened.ends("dlo/points") == {}


def test_observe_says_why_there_is_no_command_and_needs_none(tmp_path, caplog, capsys):
    settings(start="other").dump(tmp_path / "params.yaml")
    source = str(bag(tmp_path / "bag"))
    params = ["--params", str(tmp_path / "params.yaml")]
    assert main(["observe", *params, "--output", str(tmp_path / "out"), source]) == 0
    assert "command.source is 'tf'" in caplog.text + capsys.readouterr().err
    assert main(["identify", *params, "--output", str(tmp_path / "result"), source]) == 2
    assert "'other'" in capsys.readouterr().err


def test_parameters_of_the_source_are_checked_and_written(tmp_path):
    settings().dump(tmp_path / "params.yaml")
    assert Settings.load(tmp_path / "params.yaml").command == settings().command
    flat = SETTINGS.flat()
    with pytest.raises(ParameterError, match=r"give command.start_frame or command.end_frame"):
        Settings.from_mapping(flat | {"command.source": "tf"})
    with pytest.raises(ParameterError, match=r"command.end_offset is .* unit quaternion"):
        Settings.from_mapping(flat | {"command.end_offset": [0.0] * 7})


def test_poses_that_wait_are_taken_at_once_and_predictions_wait_for_them():
    """The logic alone: an executor takes one message of a topic at a time."""
    pytest.importorskip("rclpy")
    from dlo_ros.nodes import simulator
    from dlo_ros.nodes.node_base import DloNode

    taken, waiting = [], [("b", None), ("c", None)]
    handle = nullcontext()
    handle.take_message = lambda kind, raw: waiting.pop(0) if waiting else None
    callbacks = []

    def create(kind, topic, callback, qos, **options):
        callbacks.append(callback)
        return SimpleNamespace(handle=handle, msg_type=kind)

    node = SimpleNamespace(
        guarded=lambda what, callback: callback,
        _overriding=lambda topic: nullcontext(),
        create_subscription=create,
        waiting=lambda subscription: DloNode.waiting(node, subscription),
    )
    for drain in (False, True):
        DloNode.subscribe(node, topics.START_POSE, taken.append, None, drain=drain)
    callbacks[0]("a")
    assert taken == ["a"]
    callbacks[1]("a")
    assert taken == ["a", "a", "b", "c"]

    now, told = 10**18, 10**18 - 50_000_000
    motion = SimpleNamespace(commands=[SimpleNamespace(end_stamp=told)])
    for source, late, expected in (
        ("tf", 0, told), ("topic", 0, now), ("tf", 200_000_000, now + 200_000_000)
    ):  # fmt: skip
        fake = SimpleNamespace(
            now=lambda late=late: now + late,
            _simulation=SimpleNamespace(motion=motion),
            settings=SimpleNamespace(command=SimpleNamespace(source=source)),
        )
        assert simulator.SimulatorNode._known_until(fake) == expected
    motion.commands.clear()
    assert simulator.SimulatorNode._known_until(fake) == now + 200_000_000
