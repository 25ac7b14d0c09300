# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Points of another tracker as tables, and ROS 1 bags, become bags; and what is refused."""

import numpy as np
import pytest
from point_lists import SETTINGS, bent, tracked
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dlo_ros.cli.main import main
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import deserialise, open_bag
from dlo_ros.recordings.camera_bags import iterate_together
from dlo_ros.recordings.images import read_camera_info, read_image
from dlo_ros.recordings.messages import read_point_list, stamp_of
from dlo_ros.recordings.read import read_recording
from dlo_ros.recordings.table_rows import ORIGIN

NOETIC = get_typestore(Stores.ROS1_NOETIC)
TF = "tf2_msgs/msg/TFMessage"
NOETIC.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
BEGIN = 1_500_000_000


@pytest.fixture
def params(tmp_path):
    SETTINGS.dump(tmp_path / "params.yaml")
    return str(tmp_path / "params.yaml")


def run(params, tmp_path, kind, *words):
    output = tmp_path / "out"
    call = ["import", "--format", kind, "--params", params, "--output", str(output), *words]
    return main([*call]), output


def table(tmp_path, *, told=False, frames=3, seed=1):
    """A CSV file of points in no order, its lines shuffled; and the lists."""
    lists = [tracked(bent(1), seed + k, given=told) for k in range(frames)]
    rows = []
    for k, seen in enumerate(lists):
        more = [] if not told else [seen.u, np.full(len(seen.u), 0.003)]
        rows += [(k / 30.0, *row) for row in np.column_stack([seen.positions, *more])]
    order = np.random.default_rng(1).permutation(len(rows))
    head = "time_s,x,y,z" + (",u,std" if told else "")
    lines = [head, *(",".join(repr(float(v)) for v in rows[k]) for k in order)]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines) + "\n")
    return path, lists


@pytest.mark.parametrize("told", [False, True])
def test_a_table_of_points_becomes_a_bag_that_observe_reads(told, tmp_path, params, capsys):
    path, lists = table(tmp_path, told=told)
    command = tmp_path / "command.csv"
    command.write_text("time_s,name,x,y,z,qx,qy,qz,qw\n0.0,start,0,0,0,0,0,0,1\n")
    status, output = run(params, tmp_path, "points", str(path), str(command))
    assert status == 0 and "3 lists of 150 points" in capsys.readouterr().out
    with open_bag(output) as bag:
        seen = [read_point_list(deserialise(m)) for m in bag.messages(bag.find(topics.POINTS))]
    assert [s.stamp for s in seen] == [ORIGIN, ORIGIN + 33_333_333, ORIGIN + 66_666_667]
    for got, given in zip(seen, lists, strict=True):
        assert np.allclose(np.sort(got.positions[:, 0]), np.sort(given.positions[:, 0]), atol=1e-6)
        assert (got.u is not None) is told and (got.std is not None) is told
    assert len(read_recording(output, SETTINGS).commands) == 1


def test_a_table_may_come_from_a_spreadsheet(tmp_path, params):
    path = tmp_path / "points.csv"
    path.write_bytes(b"\xef\xbb\xbftime_s, x, y, z\r\n0.0, 0.1, 0.0, 0.2\r\n")
    assert run(params, tmp_path, "points", str(path))[0] == 0


def test_a_table_may_be_parquet(tmp_path, params):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    seen = tracked(bent(1), 1)
    columns = {name: seen.positions[:, k] for k, name in enumerate("xyz")}
    whole = arrow.table({"time_s": np.zeros(len(seen.positions)), **columns})
    parquet.write_table(whole, tmp_path / "points.parquet")
    assert run(params, tmp_path, "points", str(tmp_path / "points.parquet"))[0] == 0


INSTANTS = np.array([1_750_000_000_000_000_000, 1_750_000_000_033_333_333])
SECONDS = np.array([0.0, 1.0 / 30.0])


@pytest.mark.parametrize(
    ("name", "cells", "kind", "first", "told"),
    [
        ("stamp_ns", INSTANTS, "int64", INSTANTS[0], ""),
        ("stamp_ns", INSTANTS.astype(float), "float64", INSTANTS[0], ""),
        ("stamp_ns", INSTANTS.astype(str), "string", INSTANTS[0], ""),
        ("time_s", INSTANTS, "timestamp[ns]", INSTANTS[0], ""),
        ("time_s", INSTANTS // 1000, "timestamp[us, tz=UTC]", INSTANTS[0], ""),
        ("time_s", INSTANTS - INSTANTS[0], "duration[ns]", ORIGIN, ""),
        ("time_s", [None, 0.0], "float64", ORIGIN, "row 0: time_s is '', no number (1 of 2"),
        ("stamp_ns", [None, INSTANTS[1]], "int64", INSTANTS[1], "row 0: stamp_ns is ''"),
        ("x", [np.nan, 0.0], "float64", ORIGIN + 33_333_333, "row 0: x is 'nan', no number (1 of"),
        ("x", [1e9, 0.0], "float64", ORIGIN + 33_333_333, "row 0: x is '1000000000.0', more than"),
        ("std", [0.0, 0.1], "float64", ORIGIN + 33_333_333, "row 0: std is '0.0'; it must be posi"),
        ("note", ["a", None], "string", ORIGIN, ""),
    ],
)  # fmt: skip
def test_a_parquet_column_is_read_as_its_type_says(
    name, cells, kind, first, told, tmp_path, params, caplog
):
    status, output = parquet_run(params, tmp_path, name, cells, kind)
    assert status == 0
    assert told in caplog.text if told else not caplog.text
    with open_bag(output) as made:
        stamps = [stamp_of(deserialise(m)) for m in made.messages()]
    assert len(stamps) == 2 - bool(told)
    assert abs(stamps[0] - first) <= 256  # as a float64 it is rounded to that


@pytest.mark.parametrize(
    ("name", "cells", "kind", "told"),
    [
        ("time_s", [], "float64", "has no row"),
        ("time_s", ["a", "b"], "string", "row 0: time_s is 'a', no number (none of its 2 lines"),
        ("stamp_ns", ["a", "b"], "string", "row 0: stamp_ns is 'a', no whole number of nanosec"),
        ("time_s", [1e30, 0.0], "float64", "row 0: the stamp 1e+39 ns lies after 2038"),
        ("stamp_ns", [-5, -5], "int64", "row 0: the stamp -5 ns lies before 1970"),
        ("x", [None, None], "null", "row 0: x is '', no number"),
        ("x", [[1.0], [2.0]], "list", "row 0: x is '[1.0]', no number"),
        ("x", None, "", "has no column x (it has y, z, time_s)"),
    ],
)
def test_parquet_files_that_hold_no_points_are_refused(
    name, cells, kind, told, tmp_path, params, capsys
):
    status, output = parquet_run(params, tmp_path, name, cells, kind)
    assert status == 2 and told in capsys.readouterr().err
    assert not output.exists()


def parquet_run(params, tmp_path, name, cells, kind):
    """Import of a Parquet file of two points, one column of which is replaced."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    types = {
        "list": arrow.list_(arrow.float64()), "timestamp[us, tz=UTC]": arrow.timestamp("us", "UTC"),
        "timestamp[ns]": arrow.timestamp("ns"), "duration[ns]": arrow.duration("ns"),
    }  # fmt: skip
    columns = {c: arrow.array([0.0, 0.1]) for c in "xyz"} | {"time_s": arrow.array(SECONDS)}
    if name == "stamp_ns":
        del columns["time_s"]
    if cells is None:
        del columns[name]
    else:
        kind = types.get(kind) or arrow.type_for_alias(kind)
        columns[name] = arrow.array(list(cells), from_pandas=False).cast(kind)
        columns = {c: v[: len(cells)] for c, v in columns.items()}
    parquet.write_table(arrow.table(columns), tmp_path / "points.PARQUET")
    return run(params, tmp_path, "points", str(tmp_path / "points.PARQUET"))


def test_a_file_that_is_no_parquet_is_refused(tmp_path, params, capsys):
    pytest.importorskip("pyarrow")
    (tmp_path / "points.parquet").write_text("time_s,x,y,z\n0,0,0,0\n")
    assert run(params, tmp_path, "points", str(tmp_path / "points.parquet"))[0] == 2
    assert "points.parquet: cannot be read as Parquet" in capsys.readouterr().err


def test_lines_without_a_point_are_left_out_and_told_of(tmp_path, params, capsys, caplog):
    path, _ = table(tmp_path)
    lines = path.read_text().splitlines()
    lines[3] = lines[3].rpartition(",")[0] + ",nan"
    lines[5] = lines[5].partition(",")[0] + ",,,"
    lines.insert(4, "")
    path.write_text("\n".join(lines) + "\n0.2,lost,0,0\n0.3,1e9,0,0\n,0,0,0\n")
    status, output = run(params, tmp_path, "points", str(path))
    assert status == 0 and "3 lists of 149 points" in capsys.readouterr().out
    assert "points.csv: line 4: z is 'nan', no number (5 of 453 lines are left out" in caplog.text
    with open_bag(output) as made:
        seen = [read_point_list(deserialise(m)) for m in made.messages(made.find(topics.POINTS))]
    assert sum(len(s.positions) for s in seen) == 448


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("time_s,x,y\n0,0,0\n", "has no column z"),
        ("x,y,z\n0,0,0\n", "neither stamp_ns nor time_s"),
        ("time_s,x,y,z\n1e30,0,0,0\n", "line 2: the stamp 1e+39 ns lies after 2038"),
        (f"stamp_ns,x,y,z\n{10**23},0,0,0\n", "line 2: the stamp 1e+23 ns lies after 2038"),
        ("time_s,x,y,z\n0,0,0,nan\n", "line 2: z is 'nan'"),
        ("time_s,x,y,z,std\n0,0,0,0,0\n", "line 2: std is '0'; it must be positive (none of"),
        ("time_s,X,Y,Z\n0,0,0,0\n", "has no column x, y, z (it has time_s, X, Y, Z)"),
        ("stamp_ns,x,y,z\n1e18,0,0,0\n", "stamp_ns is '1e18', no whole number of nanoseconds"),
    ],
)
def test_tables_that_are_none_are_refused(text, word, tmp_path, params, capsys):
    (tmp_path / "points.csv").write_text(text)
    assert run(params, tmp_path, "points", str(tmp_path / "points.csv"))[0] == 2
    assert word in capsys.readouterr().err


def test_files_of_two_clocks_are_refused(tmp_path, params, capsys):
    path, _ = table(tmp_path)
    command = tmp_path / "command.csv"
    command.write_text("time_s,name,x,y,z,qx,qy,qz,qw\n1.76e9,start,0,0,0,0,0,0,1\n")
    assert run(params, tmp_path, "points", str(path), str(command))[0] == 2
    assert "different clocks" in capsys.readouterr().err


def ros1(kind, **fields):
    return NOETIC.types[kind](**fields)


def header(frame, second=BEGIN):
    time = ros1("builtin_interfaces/msg/Time", sec=second, nanosec=0)
    return ros1("std_msgs/msg/Header", seq=7, stamp=time, frame_id=frame)


def image(value=10):
    data = np.full(4 * 6 * 3, value, dtype=np.uint8)
    return ros1("sensor_msgs/msg/Image", header=header("cam"), height=4, width=6, encoding="bgr8",
                is_bigendian=0, step=18, data=data)  # fmt: skip


def camera_info():
    roi = ros1("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
               do_rectify=False)  # fmt: skip
    k = np.array([100.0, 0.0, 3.0, 0.0, 100.0, 2.0, 0.0, 0.0, 1.0])
    return ros1("sensor_msgs/msg/CameraInfo", header=header("cam"), height=4, width=6,
                distortion_model="plumb_bob", D=np.zeros(5), K=k, R=np.eye(3).ravel(),
                P=np.zeros(12), binning_x=0, binning_y=0, roi=roi)  # fmt: skip


def pose_of(x):
    point = ros1("geometry_msgs/msg/Point", x=x, y=0.0, z=0.0)
    turn = ros1("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return ros1("geometry_msgs/msg/Pose", position=point, orientation=turn)


def pose():
    return ros1("geometry_msgs/msg/PoseStamped", header=header("board"), pose=pose_of(0.2))


def cloud():
    field = [
        ros1("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate("xyz")
    ]
    data = tracked(bent(1), 1).positions.astype("<f4")
    return ros1("sensor_msgs/msg/PointCloud2", header=header("board"), height=1, width=len(data),
                fields=field, is_bigendian=False, point_step=12, row_step=12 * len(data),
                data=np.frombuffer(data.tobytes(), np.uint8), is_dense=True)  # fmt: skip


def transforms():
    moved = ros1("geometry_msgs/msg/Vector3", x=0.1, y=0.0, z=0.0)
    turn = ros1("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    pose = ros1("geometry_msgs/msg/Transform", translation=moved, rotation=turn)
    one = ros1("geometry_msgs/msg/TransformStamped", header=header("base"), child_frame_id="hand",
               transform=pose)  # fmt: skip
    return ros1("tf2_msgs/msg/TFMessage", transforms=[one])


def bag(tmp_path, *messages):
    path = tmp_path / "old.bag"
    with Writer(path) as writer:
        for topic, message in messages:
            kind = message.__msgtype__
            connection = writer.add_connection(topic, kind, typestore=NOETIC)
            writer.write(connection, BEGIN * 10**9, NOETIC.serialize_ros1(message, kind))
    return str(path)


def test_a_ros_1_bag_is_converted_and_its_topics_named(tmp_path, params, capsys):
    source = bag(
        tmp_path, ("/camera/image_color", image()), ("/camera/camera_info", camera_info()),
        ("/tracker/cloud", cloud()), ("/left/pose", pose()), ("/tf", transforms()),
        ("/right/pose", pose()),
    )  # fmt: skip
    words = ("--topic", "dlo/start_pose=/left/pose", source)
    status, output = run(params, tmp_path, "ros1", *words)
    said = capsys.readouterr().out
    assert status == 0 and "not taken: /right/pose" in said
    assert "image_raw from /camera/image_color" in said
    with open_bag(output) as made:
        read = {m.topic: deserialise(m) for m in made.messages()}
    assert set(read) == {"/image_raw", "/camera_info", "/dlo/points", "/dlo/start_pose", "/tf"}
    assert read_image(read["/image_raw"])[0, 0, 0] == 10
    assert read_camera_info(read["/camera_info"]).k[0] == 100.0
    assert len(read_point_list(read["/dlo/points"]).positions) == 150
    assert stamp_of(read["/dlo/points"]) == BEGIN * 10**9
    assert read["/dlo/start_pose"].pose.position.x == 0.2
    assert read["/tf"].transforms[0].child_frame_id == "hand"


POSES = {"translation": [0.0, 0.0, 1.2], "rotation": [2**-0.5, 0.0, 0.0, 2**-0.5]}
STEREO = {"vision.cameras": ["left", "right"]} | {
    f"camera_{name}.{key}": value for name in ("left", "right") for key, value in POSES.items()
}
LEFT = (("/rig/left/image_raw", image(20)), ("/rig/left/camera_info", camera_info()))
RIGHT = (("/rig/right/image_color", image(30)), ("/rig/right/camera_info", camera_info()))


@pytest.fixture
def stereo(tmp_path):
    Settings.from_mapping({**SETTINGS.flat(), **STEREO}).dump(tmp_path / "stereo.yaml")
    return str(tmp_path / "stereo.yaml")


def test_a_ros_1_bag_of_two_cameras_has_the_topics_of_both(tmp_path, stereo, capsys):
    depth = (("/rig/depth/image_raw", image()), ("/rig/depth/camera_info", camera_info()))
    source = bag(tmp_path, *LEFT, *RIGHT, *depth, ("/dlo/points", cloud()))
    words = ("--topic", "right/image_raw=/rig/right/image_color", source)
    status, output = run(stereo, tmp_path, "ros1", *words)
    assert status == 0
    assert "not taken: /rig/depth/camera_info, /rig/depth/image_raw" in capsys.readouterr().out
    pictures = next(iterate_together(output, ["left", "right"]))
    assert [pictures[name].image[0, 0, 0] for name in ("left", "right")] == [20, 30]


@pytest.mark.parametrize(
    ("messages", "told"),
    [
        ((*LEFT, *RIGHT), "of the camera 'right' (vision.cameras); say which, as --topic right/imag"
                          "e_raw=/rig/right/image_color (not taken: /rig/right/image_color)"),
        (LEFT, "of the camera 'right' (vision.cameras); say which, as --topic right/image_raw=/NAME"
               " (not taken: none of that type)"),
        ((*LEFT, ("/right/image_raw", image())), "no topic is right/camera_info of the camera 'ri"),
        ((*LEFT, ("/other/left/image_raw", image())), "may each be left/image_raw; say which"),
    ],
)  # fmt: skip
def test_a_ros_1_bag_without_one_of_the_cameras_is_refused(
    messages, told, tmp_path, stereo, capsys
):
    assert run(stereo, tmp_path, "ros1", bag(tmp_path, *messages))[0] == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_points_of_a_ros_1_bag_need_no_images_of_the_cameras(tmp_path, stereo):
    assert run(stereo, tmp_path, "ros1", bag(tmp_path, ("/dlo/points", cloud())))[0] == 0


def test_a_depth_image_of_a_ros_1_bag_is_no_picture(tmp_path, params, capsys):
    source = bag(
        tmp_path, ("/camera/color/image_raw", image()),
        ("/camera/color/camera_info", camera_info()),
        ("/camera/aligned_depth_to_color/image_raw", image()),
        ("/camera/aligned_depth_to_color/camera_info", camera_info()),
    )  # fmt: skip
    assert run(params, tmp_path, "ros1", source)[0] == 0
    assert "image_raw from /camera/color/image_raw" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("messages", "words", "told"),
    [
        (
            (("/a", image()), ("/b", image())),
            (),
            "/a, /b may each be image_raw; say which, as --topic"
            " image_raw=/a, or name the cameras in vision.cameras",
        ),
        ((("/left/pose", pose()),), (), "has no topic that can be used (/left/pose"),
        ((("/a", image()),), ("--topic", "dlo/points=/a"), "PointCloud2 is needed"),
        ((("/a", image()),), ("--topic", "dlo/points=/b"), "the bag has /a"),
        ((("/a", image()),), ("--topic", "other=/a"), "'other' is none of image_raw"),
        ((("/a", image()),), ("--topic", "image_raw"), "OURS=THEIRS"),
    ],
)
def test_ros_1_bags_whose_topics_are_not_clear_are_refused(
    messages, words, told, tmp_path, params, capsys
):
    assert run(params, tmp_path, "ros1", *words, bag(tmp_path, *messages))[0] == 2
    assert told in capsys.readouterr().err


def test_files_that_are_no_ros_1_bag_are_refused(tmp_path, params, capsys):
    path = tmp_path / "old.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + b"\0" * 100)
    assert run(params, tmp_path, "ros1", str(path))[0] == 2
    assert "is no ROS 1 bag that can be read" in capsys.readouterr().err
    assert run(params, tmp_path, "ros1", str(tmp_path / "none.bag"))[0] == 2
    assert "no such file" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
