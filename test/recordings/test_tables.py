# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Tables and data sets: which commands they have, dates in seconds, folders of episodes."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.inference.forecast import motion_of
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    command_message,
    observation_messages,
)
from dlo_ros.recordings.point_tables import read_point_tables
from dlo_ros.recordings.read import read_recording
from dlo_ros.recordings.tables import read_csv, write_bag
from dlo_ros.recordings.wrench_table import read_wrench_tables
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import SplineBasis

N = 6
SETTINGS = Settings(RodParameters(0.4, 0.004, 5e7, 2500.0, control_points=N))
BEGIN = 1_750_000_000_123_456_789


@pytest.fixture
def params(tmp_path):
    SETTINGS.dump(tmp_path / "params.yaml")
    return str(tmp_path / "params.yaml")


def recording():
    """Two commands, and splines with points on them."""
    times, rotations = np.array([0.0, 0.1, 0.25]), np.zeros((3, 1, 4))
    rotations[..., 3] = 1.0
    positions = np.random.default_rng(3).normal(scale=0.1, size=(3, 1, 3))
    unknown = np.full((3, 1, 3), np.nan)
    first = Command(BEGIN, ("start",), times, positions, rotations, unknown, N)
    second = replace(first, stamp=BEGIN + 300_000_000, positions=2.0 * positions)
    basis = SplineBasis(N, 0.4)
    u, shape, on = np.linspace(0.0, 0.4, 30), np.zeros((N, 4)), np.zeros((30, 3))
    shape[:, 0], on[:, 0] = basis.greville, u
    points = CentrelinePoints(on, u, np.full(30, 1e-4))
    stamps = [BEGIN + k * 33_333_333 for k in range(5)]
    return (first, second), tuple(Observation(s, shape, points) for s in stamps)


@pytest.mark.parametrize("later", [0, -200_000_000])
def test_a_command_that_was_replaced_before_it_began_is_not_exported(params, tmp_path, later):
    """The later received one of two with one stamp holds; one with an earlier stamp drops both."""
    (first, second), seen = recording()
    commands = (first, second, replace(first, stamp=second.stamp + later))
    with BagWriter(tmp_path / "bag") as writer:
        for k, command in enumerate(commands):
            message = command_message(BAG_MESSAGES, command)
            writer.write("dlo/command", message, BEGIN + k)
        for topic, message in (pair for o in seen for pair in observation_messages("board", o)):
            writer.write(topic, message, BEGIN + 10)
    call = ["export", "--params", params, "--recording", str(tmp_path / "bag"), "--format", "csv"]
    assert main([*call, "--output", str(tmp_path / "tables")]) == 0
    call = ["import", "--format", "csv", "--params", params, "--output", str(tmp_path / "back")]
    assert main([*call, str(tmp_path / "tables")]) == 0
    before, after = (
        motion_of(read_recording(tmp_path / name, SETTINGS)) for name in ("bag", "back")
    )
    for stamp in (BEGIN, BEGIN + 150_000_000, BEGIN + 10**9):
        a, b = (np.hstack(m.at(stamp).sample(stamp)) for m in (before, after))
        np.testing.assert_allclose(a, b)


def test_dates_in_seconds_are_read_to_the_nanosecond(params, tmp_path):
    tables, seconds, out = (tmp_path / name for name in ("tables", "seconds", "back"))
    write_bag(tmp_path / "bag", SETTINGS, *recording())
    call = ["export", "--params", params, "--recording", str(tmp_path / "bag"), "--format", "csv"]
    assert main([*call, "--output", str(tables)]) == 0
    seconds.mkdir()
    for path in tables.iterdir():
        if path.name != "points.csv":
            text = re.sub(r"(?m)^(\d{10})(\d{9}),", r"\1.\2,", path.read_text())
            (seconds / path.name).write_text(text.replace("stamp_ns", "time_s"))
    call = ["import", "--format", "csv", "--params", params, "--output", str(out)]
    assert main([*call, str(seconds), str(tables / "points.csv")]) == 0
    found = read_recording(out, SETTINGS)
    assert [o.stamp for o in found.observations] == [o.stamp for o in recording()[1]]
    assert all(o.points is not None for o in found.observations)  # those have the same stamps


@pytest.mark.parametrize(
    ("head", "line", "said"),
    [
        ("time_s,x,y,z,x,y,z", "0,0,0,0,1,0,0", "its first line names the column 'x' twice"),
        ("time_s;name;x;y;z", "0;start;0;0;0", "with commas between them"),
    ],
)
def test_columns_that_cannot_be_told_apart_are_refused(params, tmp_path, capsys, head, line, said):
    """Two markers side by side: of columns with one name the last one would count."""
    (tmp_path / "table.csv").write_text(f"{head}\n{line}\n")
    kind = "points" if "," in head else "csv"
    call = ["import", "--format", kind, "--params", params, "--output", str(tmp_path / "bag")]
    assert main([*call, str(tmp_path / "table.csv")]) == 2
    error = capsys.readouterr().err
    assert "table.csv: its first line" in error and said in error


def test_columns_without_a_name_are_no_column_twice(params, tmp_path):
    """As spreadsheets leave them at the end of each line."""
    (tmp_path / "table.csv").write_text("time_s,x,y,z,,\n0,0,0,0,,\n")
    call = ["import", "--format", "points", "--params", params, "--output", str(tmp_path / "bag")]
    assert main([*call, str(tmp_path / "table.csv")]) == 0


def test_points_of_one_instant_in_several_files_are_one_list(tmp_path):
    """As of a tracker that writes a file for each marker; one that states u is another list."""
    for name, text in (
        ("a.csv", "time_s,x,y,z\n0,0,0,0\n1,0,0,0\n"),
        ("b.csv", "time_s,x,y,z\n0,1,0,0\n1,1,0,0\n"),
        ("c.csv", "time_s,x,y,z,u\n1,2,0,0,0.1\n"),
    ):
        (tmp_path / name).write_text(text)
    found = read_point_tables([tmp_path / name for name in ("a.csv", "b.csv", "c.csv")], SETTINGS)[
        1
    ]
    assert [(p.positions[:, 0].tolist(), p.u is None) for p in found] == [
        ([0.0, 1.0], True), ([2.0], False), ([0.0, 1.0], True),
    ]  # fmt: skip


def test_points_of_a_second_file_that_are_left_out_are_told(params, tmp_path, caplog):
    write_bag(tmp_path / "bag", SETTINGS, *recording())
    call = ["export", "--params", params, "--recording", str(tmp_path / "bag"), "--format", "csv"]
    assert main([*call, "--output", str(tmp_path / "tables")]) == 0
    first = tmp_path / "tables" / "points.csv"
    second = tmp_path / "second.csv"
    second.write_text("".join(first.read_text().splitlines(keepends=True)[:2]))
    seen = read_csv([tmp_path / "tables", second], SETTINGS)[1]
    assert [len(o.points.u) for o in seen] == [30] * 5
    assert "second.csv: points at 1 stamps are left out that others have" in caplog.text


def test_forces_of_one_stamp_are_told(tmp_path, caplog):
    table = tmp_path / "wrench.csv"
    lines = ["end,time_s,fx,fy,fz,tx,ty,tz", "start,0,1,0,0,0,0,0", "start,0,9,0,0,0,0,0"]
    table.write_text("\n".join([*lines, "end,0,2,0,0,0,0,0"]) + "\n")
    found = read_wrench_tables([table])
    assert [(w.end, w.force[:, 0].tolist()) for w in found] == [("start", [1.0]), ("end", [2.0])]
    assert "wrench.csv: 1 forces are left out that have a stamp of others" in caplog.text


def test_episodes_lie_in_folders_of_as_many_as_the_data_set_says(params, tmp_path, capsys):
    data = tmp_path / "set"
    pattern = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    for name, text in (
        ("meta/info.json", {"features": {}, "chunks_size": 2, "data_path": pattern}),
        ("data/chunk-001/episode_000003.parquet", {}),
    ):
        (data / name).parent.mkdir(parents=True)
        (data / name).write_text(json.dumps(text))
    call = ["import", "--format", "parquet", "--params", params, "--output", str(tmp_path / "bag")]
    assert main([*call, "--episode", "3", str(data)]) == 2
    assert "is missing" not in capsys.readouterr().err  # found, though it is no Parquet file
    assert main([*call, "--episode", "4", str(data)]) == 2
    assert "chunk-002/episode_000004.parquet: is missing" in capsys.readouterr().err


def test_names_of_another_data_set_may_be_numbers(params, tmp_path, capsys):
    pytest.importorskip("pyarrow")
    write_bag(tmp_path / "bag", SETTINGS, *recording())
    call = ["export", "--params", params, "--recording", str(tmp_path / "bag")]
    assert main([*call, "--format", "parquet", "--output", str(tmp_path / "set")]) == 0
    info = tmp_path / "set" / "meta" / "info.json"
    tree = json.loads(info.read_text())
    tree["features"]["action"]["names"] = list(range(7))
    info.write_text(json.dumps(tree))
    call = ["import", "--format", "parquet", "--params", params, "--output", str(tmp_path / "back")]
    assert main([*call, str(tmp_path / "set")]) == 2
    assert "no column has names such as start.x ... start.qw" in capsys.readouterr().err
