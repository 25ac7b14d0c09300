# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`predict` as a user calls it: splines, forces and limits."""

import numpy as np
import pytest

from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.parameters import Settings
from dlo_ros.recordings import BAG_MESSAGES, BagWriter, command_message, spline_message, topics
from dlo_ros.recordings.bag import TYPESTORE, open_bag
from dlo_ros.spline import SplineBasis

START, EVERY, FRAMES = 10**18, 40_000_000, 12
ROD = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.004,
        "rod.young_modulus": 1e7,
        "rod.density": 2000.0,
        "simulation.tolerance": 0.001,
    }
)
WEIGHT = ROD.rod.linear_density * 9.81 * ROD.rod.length


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A bag of a DLO that hangs from its start; the shapes are those of the first frame."""
    path = tmp_path_factory.mktemp("hanging") / "bag"
    n = ROD.rod.control_points
    down = np.array([[[0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)]]])
    nothing = np.full((1, 1, 3), np.nan)
    held = Command(START, ("start",), np.zeros(1), np.zeros((1, 1, 3)), down, nothing, n)
    shape = np.zeros((n, 4))
    shape[:, 2] = -SplineBasis(n, ROD.rod.length).greville
    with BagWriter(path) as writer:
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, held), START)
        for k in range(FRAMES):
            stamp = START + k * EVERY
            message = spline_message(BAG_MESSAGES, stamp, "board", shape)
            writer.write(topics.OBSERVED, message, stamp)
    return path


def parameters(tmp_path, **limits):
    path = tmp_path / "params.yaml"
    values = {**ROD.flat(), **{f"limits.{name}": value for name, value in limits.items()}}
    Settings.from_mapping(values).dump(path)
    return path


def messages(path, topic):
    with open_bag(path) as bag:
        kept = [c for c in bag.connections if topics.is_topic(c.topic, topic)]
        return [
            TYPESTORE.deserialize_cdr(raw.data, raw.connection.msgtype)
            for raw in bag.messages(kept)
        ]


def test_predict_writes_what_the_grip_bears(recording, tmp_path, capsys):
    params, out = parameters(tmp_path), tmp_path / "out"
    words = ["predict", "--params", str(params), "--output", str(out)]
    assert main([*words, str(recording)]) == 0
    said = capsys.readouterr().out
    forces = messages(out, topics.FORCE_START)
    assert len(forces) == FRAMES and messages(out, topics.FORCE_END) == []
    assert forces[0].header.frame_id == "board"
    assert [f.header.stamp.nanosec for f in forces] == [k * EVERY for k in range(FRAMES)]
    assert forces[0].wrench.force.z == pytest.approx(WEIGHT, rel=1e-3)
    for topic in (topics.TENSION, topics.MIN_BEND_RADIUS):
        values = [m.data for m in messages(out, topic)]
        assert len(values) == FRAMES and np.all(np.isfinite(values))
    assert messages(out, topics.TENSION)[0].data == pytest.approx(WEIGHT, rel=1e-3)
    assert "largest tension 0.0986 N at u = 0 m" in said and "limits" not in said
    # Forces of an earlier prediction are replaced, not doubled.
    again = tmp_path / "again"
    assert main(["predict", "--params", str(params), "--output", str(again), str(out)]) == 0
    assert len(messages(again, topics.FORCE_START)) == FRAMES


def test_an_observed_start_pulls_by_no_more_than_the_dlo_weighs(tmp_path, capsys):
    """Its first instant alone would: the noise of a shape bends it with many times its weight."""
    n, rng = ROD.rod.control_points, np.random.default_rng(0)
    down = np.array([[[0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)]]])
    nothing = np.full((1, 1, 3), np.nan)
    held = Command(START, ("start",), np.zeros(1), np.zeros((1, 1, 3)), down, nothing, n)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, held), START)
        for stamp in range(START, START + 3 * EVERY, EVERY):
            shape = np.zeros((n, 4))
            shape[:, 2] = -SplineBasis(n, ROD.rod.length).greville
            shape[1:, 0] = rng.normal(0.0, 1e-3, n - 1)
            message = spline_message(BAG_MESSAGES, stamp, "board", shape)
            writer.write(topics.OBSERVED, message, stamp)
    given = ["--params", str(parameters(tmp_path)), str(tmp_path / "bag"), "--force"]
    for start, count in (("equilibrium", 3), ("observed", 2), ("moving", 1)):
        out = tmp_path / "out.mcap"
        assert main(["predict", *given, "--start", start, "--output", str(out)]) == 0
        tension = [m.data for m in messages(out, topics.TENSION)]
        assert len(tension) == count and max(tension) < 1.5 * WEIGHT
        assert f"largest tension {max(tension):.3g} N" in capsys.readouterr().out


def test_predict_tells_of_limits(recording, tmp_path, capsys):
    params = parameters(tmp_path, tension=0.05, bend_radius=1e-3)
    words = ["predict", "--params", str(params), "--output", str(tmp_path / "out")]
    assert main([*words, str(recording)]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "limits." in line]
    assert len(lines) == 1
    assert "beyond limits.tension, 0.05 N" in lines[0] and "12 of 12 instants" in lines[0]


def test_predict_refuses_a_limit_that_is_none(recording, tmp_path, capsys):
    params = tmp_path / "params.yaml"
    ROD.dump(params)
    params.write_text(params.read_text().replace("tension: 0.0", "tension: -1.0"))
    words = ["predict", "--params", str(params), "--output", str(tmp_path / "out")]
    assert main([*words, str(recording)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "limits.tension is -1 N" in line


MOTION = """
start:
  - {time: 0.0, position: [0.0, 0.0, 0.0], direction: [0, 0, -1]}
  - {time: 1.0, position: [0.1, 0.05, 0.0], direction: [0.3, 0, -1]}
"""


def tried(tmp_path, *words, motion=MOTION, name="motion.yaml", **values):
    """Exit status of `predict --command`."""
    (tmp_path / name).write_text(motion)
    params = tmp_path / "params.yaml"
    Settings.from_mapping({**ROD.flat(), **values}).dump(params)
    out = tmp_path / "out"
    return out, main(
        ["predict", "--params", str(params), "--output", str(out), "--command",
         str(tmp_path / name), *words]
    )  # fmt: skip


def test_a_motion_is_tried_without_a_bag(tmp_path, capsys):
    out, status = tried(tmp_path, **{"rod.specific_modulus_std": 500.0, "limits.tension": 0.05})
    said = capsys.readouterr().out
    assert status == 0
    shapes = messages(out, topics.PREDICTED)
    assert len(shapes) == 51 == len(messages(out, topics.FORCE_START))
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in shapes]
    (command,) = messages(out, topics.COMMAND)
    assert stamps[0] == command.header.stamp.sec * 10**9
    assert np.diff(stamps) == pytest.approx(2e7) and len(command.points) == 2
    assert shapes[-1].poses[0].position.y == pytest.approx(0.05, abs=1e-6)
    first, band, tension, grips, alarm = said.splitlines()
    assert "51 predicted splines of 1.00 s" in first
    assert "standard deviations move the DLO by" in band
    assert "largest tension" in tension and "force of a grip" in grips
    assert "beyond limits.tension" in alarm


def test_an_estimate_gives_the_band(tmp_path, capsys):
    estimate = tmp_path / "estimate.json"
    estimate.write_text('{"information": {"matrix": [[400.0,-400,0,0],[-400,400,0,0],[0,0,9,0],'
                        "[0,0,0,9]]}}")  # fmt: skip
    assert tried(tmp_path, "--estimate", str(estimate))[1] == 0
    assert "move the DLO by" in capsys.readouterr().out
    for unusable in ("{}", '{"information": {"matrix": [[' + "9" * 400 + "]]}}"):
        estimate.write_text(unusable)
        assert tried(tmp_path, "--estimate", str(estimate), "--force")[1] == 2
        assert "estimate.json: holds no information" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "motion", "expected"),
    [
        (["bag"], MOTION, "either a BAG or --command"),
        (["--start", "moving"], MOTION, "--start is for BAG"),
        ([], "middle: [{position: [0, 0, 0]}]", "motion.yaml: names 'middle'"),
        ([], MOTION.replace("0.1, 0.05", "0.9, 0.05").replace("1.0,", "0.0005,"), "jumps"),
        ([], MOTION.replace("time: 1.0", "time: 9000.0"), "too long"),
    ],
)
def test_what_cannot_be_tried_is_refused_in_one_line(tmp_path, capsys, words, motion, expected):
    out, status = tried(tmp_path, *words, motion=motion)
    assert status == 2 and not out.exists()
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line


def test_neither_bag_nor_command(tmp_path, capsys):
    ROD.dump(tmp_path / "params.yaml")
    words = ["predict", "--params", str(tmp_path / "params.yaml"), "--output", str(tmp_path / "o")]
    assert main(words) == 2
    assert "either a BAG or --command" in capsys.readouterr().err
