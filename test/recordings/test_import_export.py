# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings as tables and back: bag -> CSV -> bag, bag -> Parquet -> bag; what is refused."""

import json

import numpy as np
import pytest

from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.recordings.read import read_recording
from dlo_ros.recordings.table_rows import ORIGIN
from dlo_ros.recordings.tables import spline_columns, write_bag
from dlo_ros.spline import SplineBasis

N = 6
SETTINGS = Settings(RodParameters(0.4, 0.004, 5e7, 2500.0, control_points=N))
BEGIN = 1_750_000_000_123_456_789
FRAMES = 5


@pytest.fixture
def params(tmp_path):
    SETTINGS.dump(tmp_path / "params.yaml")
    return str(tmp_path / "params.yaml")


def recording(*, cloud=True, fast=True):
    """Commands and observations of a short motion."""
    random = np.random.default_rng(3)
    times = np.array([0.0, 0.1, 0.25])
    positions = random.normal(scale=0.1, size=(3, 2, 3))
    rotations = np.zeros((3, 2, 4))
    rotations[..., 1], rotations[..., 3] = np.sin(0.3), np.cos(0.3)
    speed = random.normal(size=(3, 2, 3)) if fast else np.full((3, 2, 3), np.nan)
    first = Command(BEGIN, ("start", "end"), times, positions, rotations, speed, N)
    second = Command(
        BEGIN + 300_000_000, ("start", "end"), times[:1], positions[2:], rotations[2:],
        np.full((1, 2, 3), np.nan), N,
    )  # fmt: skip
    seen = []
    for k in range(FRAMES):
        shape = np.zeros((N, 4))
        shape[:, 0] = SplineBasis(N, 0.4).greville
        shape += 1e-3 * random.normal(size=(N, 4))
        u = np.linspace(0.0, 0.4, 7)
        points = CentrelinePoints(random.normal(size=(7, 3)), u, np.full(7, 1e-4))
        seen.append(Observation(BEGIN + k * 33_333_333, shape, points if cloud else None))
    return (first, second), tuple(seen)


def bag(tmp_path, name="bag", **kinds):
    commands, seen = recording(**kinds)
    write_bag(tmp_path / name, SETTINGS, commands, seen)
    return str(tmp_path / name)


def same_shapes(a, b, tolerance):
    assert [o.stamp for o in a] == [o.stamp for o in b]
    for x, y in zip(a, b, strict=True):
        assert np.allclose(x.control_points, y.control_points, atol=tolerance, rtol=0.0)


@pytest.mark.parametrize("cloud", [False, True])
@pytest.mark.parametrize("fast", [False, True])
def test_bag_csv_bag(params, tmp_path, capsys, cloud, fast):
    source, tables = bag(tmp_path, cloud=cloud, fast=fast), str(tmp_path / "tables")
    call = ["export", "--params", params, "--recording", source, "--format", "csv"]
    assert main([*call, "--output", tables]) == 0
    back = str(tmp_path / "back")
    assert main(["import", "--format", "csv", "--params", params, "--output", back, tables]) == 0
    assert f"{FRAMES} observed splines, {FRAMES * cloud} with measured points, 2 commands" in (
        capsys.readouterr().out
    )
    before, after = read_recording(source, SETTINGS), read_recording(back, SETTINGS)
    same_shapes(before.observations, after.observations, 1e-15)
    for a, b in zip(before.commands, after.commands, strict=True):
        assert (a.stamp, a.names) == (b.stamp, b.names)
        for part in ("times", "positions", "rotations", "velocities"):
            assert np.array_equal(getattr(a, part), getattr(b, part), equal_nan=True), part
    for x, y in zip(before.observations, after.observations, strict=True):
        assert (x.points is None) == (y.points is None) == (not cloud)
        if cloud:
            assert np.array_equal(x.points.positions, y.points.positions)
            assert np.array_equal(x.points.std, y.points.std)


def test_bag_parquet_bag(params, tmp_path):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: make test-export")
    source, folder = bag(tmp_path), tmp_path / "set"
    call = ["export", "--params", params, "--recording", source, "--format", "parquet"]
    assert main([*call, "--recording", source, "--output", str(folder)]) == 0
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (2, 2 * FRAMES)
    assert info["fps"] == pytest.approx(30.0, rel=1e-6)
    assert info["features"]["observation.state"]["names"] == spline_columns(N)
    lines = (folder / "meta/episodes.jsonl").read_text().splitlines()
    assert [json.loads(line)["length"] for line in lines] == [FRAMES, FRAMES]
    back = str(tmp_path / "back")
    call = ["import", "--format", "parquet", "--params", params, "--output", back, str(folder)]
    assert main([*call, "--episode", "1"]) == 0
    before, after = read_recording(source, SETTINGS), read_recording(back, SETTINGS)
    same_shapes(before.observations, after.observations, 1e-7)  # 32 bits
    [command] = after.commands
    for o in before.observations:  # what was imposed at each picture
        ruling = [c for c in before.commands if c.stamp <= o.stamp][-1]
        for a, b in zip(ruling.sample(o.stamp), command.sample(o.stamp), strict=True):
            assert np.allclose(a, b, atol=1e-7)


def test_parquet_is_what_lerobot_reads(params, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    folder = tmp_path / "set"
    call = ["export", "--params", params, "--recording", bag(tmp_path), "--format", "parquet"]
    assert main([*call, "--output", str(folder)]) == 0
    info = json.loads((folder / "meta/info.json").read_text())
    path = folder / info["data_path"].format(episode_chunk=0, episode_index=0)
    table = parquet.read_table(path)
    assert set(table.column_names) == set(info["features"])
    for name, feature in info["features"].items():
        column = table.column(name)
        assert feature["dtype"] in str(column.type).replace("float", "float32")
        if feature["shape"] != [1]:
            assert column.type.list_size == feature["shape"][0] == len(feature["names"])
    assert table.column("timestamp").to_pylist() == pytest.approx(
        np.arange(FRAMES) / 30.0, abs=1e-6
    )
    assert table.column("frame_index").to_pylist() == list(range(FRAMES))


def observed_csv(path, begin=0.0, points=N):
    rows = [",".join(["time_s", *spline_columns(points)])]
    for k in range(3):
        shape = np.zeros((points, 4))
        shape[:, 0] = np.linspace(0.0, 0.4, points)
        rows.append(",".join(map(str, [begin + 0.1 * k, *shape.ravel()])))
    path.write_text("\n".join(rows) + "\n")
    return path


def command_csv(path, text="start"):
    path.write_text(
        f"time_s,name,x,y,z,qx,qy,qz,qw\n0.0,{text},0,0,0,0,0,0,1\n0.5,start,0,0,0.1,0,0,0,1\n"
    )
    return path


def test_a_robots_own_tables_with_seconds(params, tmp_path):
    files = [observed_csv(tmp_path / "a.csv"), command_csv(tmp_path / "b.csv")]
    out = tmp_path / "bag"
    call = ["import", "--format", "csv", "--params", params, "--output", str(out)]
    assert main([*call, *map(str, files)]) == 0
    found = read_recording(out, SETTINGS)
    assert [o.stamp - ORIGIN for o in found.observations] == [0, 100_000_000, 200_000_000]
    [command] = found.commands
    assert command.stamp == ORIGIN and np.allclose(command.times, [0.0, 0.5])
    assert main([*call, *map(str, files)]) == 2  # it exists
    assert main([*call, "--force", *map(str, files)]) == 0


@pytest.mark.parametrize(
    ("observed", "command", "words"),
    [
        ("time_s,x\n0,1\n", None, "control_point_1.x"),
        (None, "time_s,name,x,y,z,qx,qy,qz,qw\n0,start,a,0,0,0,0,0,1\n", "line 2: x is 'a'"),
        (None, "time_s,name,x\n0,start,0\n", "qx"),
        (None, "time_s,name,x,y,z,qx,qy,qz,qw\n0,middle,0,0,0,0,0,0,1\n", "b.csv: dlo/command na"),
        (
            None,
            "time_s,name,x,y,z,qx,qy,qz,qw\n0,start,9e9,0,0,0,0,0,1\n",
            "line 2: is 9e+09 m away",
        ),
        (
            None,
            "time_s,time_from_start,name,x,y,z,qx,qy,qz,qw\n0,9e9,start,0,0,0,0,0,0,1\n",
            "line 2: is 9e+09 s from its start; metres and seconds are meant",
        ),
        (
            None,
            "time_s,name,x,y,z,qx,qy,qz,qw\n0,start,0,0,0,0,0,0,1\n1,end,0,0,0,0,0,0,1\n",
            "one line for each",
        ),
        (
            None,
            "time_s,name,x,y,z,qx,qy,qz,qw\n0,start,0,0,0,0,0,0,1\n1,start,0,0,0,0,0,0,0\n",
            "line 3: qx, qy, qz, qw have norm 0; a unit quaternion x, y, z, w is needed, (0, 0, 0",
        ),
        (None, "time_s,name,x,y,z,qx,qy,qz,qw\n0,end,0,0,0,0,3,0,4\n", "line 2: qx, qy, qz, qw"),
        (None, "time_s,name,x,y,z,qx,qy,qz,qw\n1.76e9,start,0,0,0,0,0,0,1\n", "different clocks"),
        (None, "name,x,y,z,qx,qy,qz,qw\nstart,0,0,0,0,0,0,1\n", "neither stamp_ns nor time_s"),
        ("", None, "no line"),
    ],
)
def test_tables_that_cannot_be_used(params, tmp_path, capsys, observed, command, words):
    a, b = observed_csv(tmp_path / "a.csv"), command_csv(tmp_path / "b.csv")
    if observed is not None:
        a.write_text(observed)
    if command is not None:
        b.write_text(command)
    out = tmp_path / "bag"
    call = ["import", "--format", "csv", "--params", params, "--output", str(out), str(a), str(b)]
    assert main(call) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and words in text and not out.exists()


def test_quaternions_are_normalised_and_those_of_control_points_mean_nothing(params, tmp_path):
    a, b = observed_csv(tmp_path / "a.csv"), tmp_path / "b.csv"
    b.write_text(
        "time_s,name,x,y,z,qx,qy,qz,qw\n0,start,0,0,0,0,0.62,0,0.82\n"
        f"0,control_point_{N},0,0,0.3,0,0,0,0\n"
    )
    out = tmp_path / "bag"
    call = ["import", "--format", "csv", "--params", params, "--output", str(out), str(a), str(b)]
    assert main(call) == 0
    [command] = read_recording(out, SETTINGS).commands
    turned = command.sample(ORIGIN)[1]
    assert np.allclose(turned[0], np.array([0.0, 0.62, 0.0, 0.82]) / np.hypot(0.62, 0.82))
    assert np.allclose(turned[1], [0.0, 0.0, 0.0, 1.0])


def test_measured_lines_without_numbers_are_left_out_and_told_of(params, tmp_path, caplog):
    tables, out = tmp_path / "tables", tmp_path / "back"
    call = ["export", "--params", params, "--recording", bag(tmp_path), "--format", "csv"]
    assert main([*call, "--output", str(tables)]) == 0
    for name, line, last in (("observed", 3, "nan"), ("points", 5, ""), ("points", 6, "-1")):
        path = tables / f"{name}.csv"
        lines = path.read_text().splitlines()
        lines[line - 1] = lines[line - 1].rpartition(",")[0] + "," + last
        path.write_text("\n".join(lines) + "\n")
    call = ["import", "--format", "csv", "--params", params, "--output", str(out), str(tables)]
    assert main(call) == 0
    assert f"line 3: control_point_{N}.theta is 'nan', no number (1 of {FRAMES}" in caplog.text
    assert f"line 5: std is '', no number (2 of {7 * FRAMES} lines" in caplog.text
    found = read_recording(out, SETTINGS).observations
    assert len(found) == FRAMES - 1
    assert [len(o.points.u) for o in found] == [5, *[7] * (FRAMES - 2)]


def test_points_of_no_spline_and_second_splines_are_told_of(params, tmp_path, caplog):
    tables, out = tmp_path / "tables", tmp_path / "back"
    call = ["export", "--params", params, "--recording", bag(tmp_path), "--format", "csv"]
    assert main([*call, "--output", str(tables)]) == 0
    observed, points = tables / "observed.csv", tables / "points.csv"
    observed.write_text(observed.read_text() + observed.read_text().splitlines()[1] + "\n")
    points.write_text(points.read_text().replace(f"{BEGIN},", f"{BEGIN + 7},"))
    call = ["import", "--format", "csv", "--params", params, "--output", str(out), str(tables)]
    assert main(call) == 0
    assert "observed.csv: 1 splines are left out that have a stamp of others" in caplog.text
    assert f"measured points at 1 of {FRAMES} stamps are left out: no sp" in caplog.text
    found = read_recording(out, SETTINGS).observations
    assert [o.points is None for o in found] == [True, *[False] * (FRAMES - 1)]


def test_points_beyond_the_dlo_are_told_of(params, tmp_path, caplog, capsys):
    """In millimetres, u would all be clipped to the end of the DLO."""
    tables, out = tmp_path / "tables", tmp_path / "back"
    call = ["export", "--params", params, "--recording", bag(tmp_path), "--format", "csv"]
    assert main([*call, "--output", str(tables)]) == 0
    points = tables / "points.csv"
    head, *lines = points.read_text().splitlines()
    place = head.split(",").index("u")

    def given(u_of):
        rows = [line.split(",") for line in lines]
        for k, row in enumerate(rows):
            row[place] = str(u_of(k, float(row[place])))
        points.write_text("\n".join([head, *(",".join(row) for row in rows)]) + "\n")

    call = ["import", "--format", "csv", "--params", params, "--output", str(out), str(tables)]
    given(lambda k, u: u + 100.0)
    assert main(call) == 2
    told = capsys.readouterr().err
    assert "points.csv: u is 100 to 100 m; the DLO is 0.4 m long (rod.length), and u is" in told
    given(lambda k, u: -1.0 if k == 0 else u)
    assert main(call) == 0
    assert f"points.csv: 1 of {len(lines)} points are left out: their u is not" in caplog.text


def test_other_control_points_and_missing_parts(params, tmp_path, capsys):
    a, b = observed_csv(tmp_path / "a.csv", points=N + 1), command_csv(tmp_path / "b.csv")
    call = ["import", "--format", "csv", "--params", params, "--output", str(tmp_path / "bag")]
    assert main([*call, str(a), str(b)]) == 2
    assert "rod.control_points" in capsys.readouterr().err
    assert main([*call, str(b)]) == 2 and "no file has observed" in capsys.readouterr().err
    observed_csv(a)
    assert main([*call, str(a)]) == 2 and "no file has commands" in capsys.readouterr().err
    assert main([*call, str(tmp_path / "none.csv")]) == 2
    assert "none.csv" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main([*call, str(tmp_path / "empty")]) == 2


def test_data_sets_that_cannot_be_used(params, tmp_path, capsys):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: make test-export")
    folder = tmp_path / "set"
    call = ["export", "--params", params, "--recording", bag(tmp_path), "--format", "parquet"]
    assert main([*call, "--output", str(folder)]) == 0
    assert main([*call, "--output", str(folder)]) == 2  # there is one already
    capsys.readouterr()
    out = str(tmp_path / "back")
    call = ["import", "--format", "parquet", "--params", params, "--output", out, str(folder)]
    for more, words in (
        (["--episode", "3"], "1 episodes"),
        (["--episode", "-1"], "--episode"),
        ([str(folder)], "one folder"),
    ):
        assert main([*call, *more]) == 2
        assert words in capsys.readouterr().err
    info = json.loads((folder / "meta/info.json").read_text())
    info["features"]["observation.state"]["names"][0] = "gripper"
    (folder / "meta/info.json").write_text(json.dumps(info))
    assert main(call) == 2 and "control_point_1.x" in capsys.readouterr().err
    (folder / "meta/info.json").write_text("{")
    assert main(call) == 2 and "no JSON" in capsys.readouterr().err
    assert main([*call[:-1], str(tmp_path)]) == 2 and "info.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("column", "frame", "value", "status", "words"),
    [
        ("observation.state", 1, [np.nan] * 4 * N, 0, "1 of 5 frames are left out"),
        ("observation.state", None, [np.nan] * 4 * N, 2, "no frame has control points"),
        ("observation.state", None, [0.0], 2, f"must have {4 * N} numbers a frame"),
        ("action", 1, [np.nan] * 14, 2, "position that is not finite"),
        ("action", 2, [0.0] * 14, 2, "the rotation of 'start' at point 2 has norm 0"),
        ("stamp_ns", 1, None, 2, "stamp_ns must be a number of nanoseconds"),
        ("stamp_ns", None, "late", 2, "stamp_ns must be a number of nanoseconds"),
        ("timestamp", 1, None, 2, "timestamp must be a number of seconds"),
    ],
)
def test_frames_of_a_data_set_that_hold_no_numbers(
    params, tmp_path, capsys, caplog, column, frame, value, status, words
):
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed: make test-export")
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = tmp_path / "set"
    call = ["export", "--params", params, "--recording", bag(tmp_path), "--format", "parquet"]
    assert main([*call, "--output", str(folder)]) == 0
    [path] = folder.rglob("*.parquet")
    columns = {
        name: cells
        for name, cells in parquet.read_table(path).to_pydict().items()
        if column != "timestamp" or name != "stamp_ns"
    }
    for k in range(FRAMES) if frame is None else (frame,):
        columns[column][k] = value
    parquet.write_table(arrow.table(columns), path)
    out = tmp_path / "back"
    call = ["import", "--format", "parquet", "--params", params, "--output", str(out), str(folder)]
    assert main(call) == status
    assert words in caplog.text + capsys.readouterr().err
    assert out.exists() is not bool(status)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--format", "csv"], "--recording"),
        (["--format", "mjcf", "--recording", "BAG"], "csv or parquet"),
        (["--format", "csv", "--recording", "BAG", "--sample", "3"], "--sample"),
        (["--format", "csv", "--recording", "BAG", "--recording", "BAG"], "one --recording"),
    ],
)
def test_options_that_do_not_go_together(params, tmp_path, capsys, options, words):
    options = [
        bag(tmp_path) if o == "BAG" and not (tmp_path / "bag").exists() else o for o in options
    ]
    call = ["export", "--params", params, "--output", str(tmp_path / "out")]
    assert main([*call, *options]) == 2
    assert words in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_without_pyarrow_it_is_said(params, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow.parquet", None)
    call = ["export", "--params", params, "--recording", bag(tmp_path), "--format", "parquet"]
    assert main([*call, "--output", str(tmp_path / "set")]) == 2
    assert "pip install -e '.[parquet]'" in capsys.readouterr().err
