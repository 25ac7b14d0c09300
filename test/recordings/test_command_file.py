# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Commands from files: three forms of one motion, and what is wrong with a file in one line."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.recordings.command_file import read_command_file

ROD = Settings.from_mapping(
    {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 1e7, "rod.density": 2000.0}
)


def read(tmp_path, text, name="motion.yaml"):
    path = tmp_path / name
    path.write_text(text)
    return read_command_file(path, ROD)


EXPERIMENT = """
motion:
  start:
    - {time: 0.0, position: [0.0, 0.0, 0.1], angle: 0.0}
    - {time: 2.0, position: [0.2, 0.0, 0.1], angle: 1.0}
  control_point_10:
    - {time: 0.0, position: [0.3, 0.05, 0.0]}
"""
MESSAGE = """
header: {stamp: {sec: 0, nanosec: 0}, frame_id: board}
joint_names: [start, control_point_10]
points:
  - transforms:
      - {translation: {z: 0.1}}
      - {translation: {x: 0.3, y: 0.05}}
  - time_from_start: {sec: 2}
    transforms:
      - translation: {x: 0.2, z: 0.1}
        rotation: {x: 0.0, y: 0.479425538604203, z: 0.0, w: 0.8775825618903728}
      - {translation: {x: 0.3, y: 0.05}}
"""
TABLE = """time,start.x,start.z,start.angle,control_point_10.x,control_point_10.y,control_point_10.z
0.0,0.0,0.1,0.0,0.3,0.05,0.0
2.0,0.2,0.1,1.0,0.3,0.05,0.0
"""


def test_three_forms_say_the_same(tmp_path):
    forms = [
        read(tmp_path, EXPERIMENT), read(tmp_path, MESSAGE), read(tmp_path, TABLE, "motion.csv"),
        read(tmp_path, EXPERIMENT.replace("motion:\n", "").replace("\n  ", "\n")),
    ]  # fmt: skip
    for command in forms:
        assert command.names == ("start", "control_point_10") and command.stamp > 0
        assert command.end_stamp - command.stamp == 2_000_000_000
        for late in (0.0, 0.7, 2.0):
            position, rotation = command.sample(command.stamp + round(late * 1e9))
            assert position[0] == pytest.approx([0.1 * late, 0.0, 0.1])
            assert position[1] == pytest.approx([0.3, 0.05, 0.0])
            turned = Rotation.from_quat(rotation[0]).magnitude()
            assert turned == pytest.approx(0.5 * late)


def test_directions_and_quaternions_point_the_clamp_without_twist(tmp_path):
    text = "time,end.x,end.y,end.z,end.dx,end.dy,end.dz\n0,0,0,0,0,0,-2\n1,0,0,0,0,1,0\n"
    command = read(tmp_path, text, "motion.CSV")
    first, last = (Rotation.from_quat(q) for q in command.rotations[:, 0])
    assert first.apply([1, 0, 0]) == pytest.approx([0, 0, -1])
    assert first.apply([0, 1, 0]) == pytest.approx([0, 1, 0])  # turned about y alone
    assert last.apply([1, 0, 0]) == pytest.approx([0, 1, 0])
    # From direction to direction about the axis that is normal to both.
    assert (last * first.inv()).as_rotvec() == pytest.approx([np.pi / 2, 0, 0])
    back = read(tmp_path, "start: [{position: [0, 0, 0], direction: [-1, 0, 0]}]")
    turned = Rotation.from_quat(back.rotations[0, 0])
    assert turned.apply([1, 0, 0]) == pytest.approx([-1, 0, 0])
    spun = "time,start.x,start.z,start.qx,start.qy,start.qz,start.qw\n0,0,0,0.6,0,0,0.8\n"
    assert read(tmp_path, spun, "s.csv").rotations[0, 0] == pytest.approx([0.6, 0, 0, 0.8])


def test_names_with_times_of_their_own_get_points_at_all_times(tmp_path):
    command = read(
        tmp_path,
        "start: [{time: 0.0, position: [0, 0, 0], angle: 0}, {time: 1.0, position: [0, 0, 1], "
        "angle: 0}]\nend: [{time: 0.5, position: [1, 0, 0], angle: 0}]",
    )
    assert command.times == pytest.approx([0.0, 0.5, 1.0])
    assert command.positions[1, 0] == pytest.approx([0, 0, 0.5])
    assert command.positions[:, 1] == pytest.approx(np.tile([1.0, 0.0, 0.0], (3, 1)))


HEAD = "time,start.x,start.z,start.angle\n"


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        ("[]", "m.yaml", "holds no motion"),
        ("start: 5", "m.yaml", "start is '5'; it must be a list"),
        ("start: [{time: 0}]", "m.yaml", "start, point 1 has no position"),
        ("start: [{position: [0, 0, 0]}]", "m.yaml", "no angle, direction or rotation"),
        ("start: [{position: [0, 0], angle: 0}]", "m.yaml", "must be 3 numbers"),
        ("start: [{position: [0, 0, .nan], angle: 0}]", "m.yaml", "must be a number"),
        ("start: [{position: [0, 0, 0], angle: 0, speed: 1}]", "m.yaml", "has 'speed'"),
        ("start: [{position: [0, 0, 0], angle: 0, direction: [1, 0, 0]}]", "m.yaml", "one of them"),
        ("start: [{position: [0, 0, 0], direction: [0, 0, 0]}]", "m.yaml", "direction is zero"),
        ("start: [{position: [0, 0, 0], rotation: [1, 1, 1, 1]}]", "m.yaml", "unit quaternion"),
        ("start: [{position: [0, 0, 0], angle: 0}, {time: 1, position: [0, 0, 0], angle: 4}]",
         "m.yaml", "half a turn"),
        ("start: [{position: [0, 0, 0], angle: 0}, {position: [0, 0, 0], angle: 0}]", "m.yaml",
         "times of 'start' must grow"),
        ("middle: [{position: [0, 0, 0]}]", "m.yaml", "names 'middle'"),
        ("start: []", "m.yaml", "'start' has no point"),
        ("joint_names: [start]\npoints: 3", "m.yaml", "points is '3'; it must be a list"),
        ("joint_names: [start]\npoints: []", "m.yaml", "has no points"),
        ("joint_names: [start]\nheader: {frame_id: world}\npoints: []", "m.yaml", "frame 'world'"),
        ("joint_names: [start]\npoints: [{transforms: []}]", "m.yaml", "0 transforms for 1 names"),
        ("joint_names: [start]\npoints: [{transforms: [{translation: {x: a}}]}]", "m.yaml",
         "is no trajectory"),
        ("joint_names: [start]\nheader: {stamp: {sec: 99999999999}}\npoints: [{transforms: [{}]}]",
         "m.yaml", "header.stamp is 99999999999 s"),
        (": : :", "m.yaml", "m.yaml"),
        ("", "m.csv", "no header"),
        (HEAD, "m.csv", "no header with a line of numbers"),
        (HEAD + "0,0,0\n", "m.csv", "line 2 has 3 cells; the header has 4"),
        (HEAD + "0,0,0,0\n1,0,x,0\n", "m.csv", "line 3: start.z is 'x'"),
        (HEAD + "0,0,0,0\n0,0,0,0\n", "m.csv", "times of 'start' must grow"),
        ("start.x,start.z\n0,0\n", "m.csv", "no column 'time'"),
        ("time,time\n0,0\n", "m.csv", "column 'time' twice"),
        ("time,start.x,start.z,start.w\n0,0,0,0\n", "m.csv", "column 'start.w'"),
        ("time,x\n0,0\n", "m.csv", "column 'x'"),
        ("time,start.x,start.angle\n0,0,0\n", "m.csv", "no column 'start.z'"),
        ("time,start.x,start.z,start.dx\n0,0,0,1\n", "m.csv", "no column 'start.dy'"),
        ("time,start.x,start.z,start.angle,start.dx\n0,0,0,1,1\n", "m.csv", "direction of"),
        ("time,start.x,start.z\n0,0,0\n", "m.csv", "no angle, direction or rotation"),
        ("time\n0\n", "m.csv", "names nothing"),
    ],
)  # fmt: skip
def test_a_malformed_file_is_refused_in_one_line(tmp_path, text, name, words):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, name)
    said = str(caught.value)
    assert words in said and name in said and "\n" not in said


def test_a_file_that_is_not_there_is_named(tmp_path):
    for name in ("none.csv", "none.yaml"):
        with pytest.raises(InputError, match=name):
            read_command_file(tmp_path / name, ROD)
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"bytes\.csv: is no CSV"):
        read_command_file(tmp_path / "bytes.csv", ROD)
