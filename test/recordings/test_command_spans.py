# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings whose shapes and commands are of different times, and shapes without a stamp."""

import re

import numpy as np
import pytest
import recordings_samples as samples

from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.errors import RecordingError
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import open_bag
from dlo_ros.recordings.command_spans import Span, seen_spans, unseen_motion
from dlo_ros.recordings.message_building import BAG_MESSAGES, cloud_message
from dlo_ros.recordings.point_lists import iterate_points
from dlo_ros.recordings.read import iterate_images, read_recording
from dlo_ros.recordings.write import BagWriter

SECOND = 1_000_000_000
BEGIN = 1_750_000_000 * SECOND


def command(far=0.1, seconds=2.0, stamp=BEGIN):
    """A clamp that goes a distance [m]."""
    places = np.array([[[0.0, 0.0, 0.0]], [[far, 0.0, 0.0]]])
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1, 1))
    return Command(
        stamp, ("start",), np.array([0.0, seconds]), places, turns, np.full((2, 1, 3), np.nan), 8
    )


@pytest.mark.parametrize(
    ("first", "last", "told"),
    [
        (-0.5, 0.1, ""),
        (1.0, 3.0, ""),
        (1.9, 90.0, ""),
        (-5.0, -3.0, "before the commanded motion, 1750000000.000 to 1750000002.000 s"),
        (60.0, 62.0, "after the commanded motion"),
    ],
)
def test_a_motion_that_is_not_seen_is_told(first, last, told):
    span = Span("/left/points", BEGIN + round(first * SECOND), BEGIN + round(last * SECOND))
    lines = unseen_motion([command()], [span])
    assert len(lines) == bool(told)
    if told:
        assert told in lines[0] and lines[0].startswith("/left/points, ")
        assert f"the clocks differ (by {first:.3f} s if both began together)" in lines[0]
    assert unseen_motion([command(far=0.0)], [span]) == []  # a grip that rests
    assert unseen_motion([], [span]) == []


def test_commands_that_follow_one_another_are_one_motion():
    span = Span("points", BEGIN + 3 * SECOND, BEGIN + 4 * SECOND)
    assert unseen_motion([command(), command(stamp=BEGIN + 2 * SECOND)], [span]) == []
    assert unseen_motion([command(far=0.0), command(far=0.0, stamp=BEGIN + SECOND)], [span]) == []


def cloud(stamp):
    table = np.linspace(0.0, 0.4, 60).reshape(20, 3)
    return cloud_message(BAG_MESSAGES, stamp, "board", ("x", "y", "z"), table)


def moved(tmp_path, seconds):
    """A bag whose shapes and images are stamped so much later; None: not at all."""
    with BagWriter(tmp_path / "bag") as writer:
        for topic, message, stamp in samples.messages():
            if topics.COMMAND not in topic:
                own = message.header.stamp
                own.sec = 0 if seconds is None else own.sec + seconds
                own.nanosec = 0 if seconds is None else own.nanosec
            writer.write(topic, message, stamp)
        at = 0 if seconds is None else samples.START + seconds * SECOND
        for k in range(2):
            writer.write(topics.POINTS, cloud(at), samples.START + k)
    return tmp_path / "bag"


def test_shapes_of_another_clock_are_told_by_whoever_reads_the_bag(tmp_path):
    recording = read_recording(moved(tmp_path, 60), samples.SETTINGS)
    told = [line for line in recording.skipped if "lies wholly after the commanded mo" in line]
    assert sorted(line.partition(",")[0] for line in told) == [
        "/dlo/observed", "/dlo/points", "/image_raw",
    ]  # fmt: skip
    assert recording.observations


def test_shapes_without_a_stamp_are_refused_with_the_mend(tmp_path):
    bag = moved(tmp_path, None)
    with open_bag(bag) as opened:
        assert seen_spans(opened) == []
    recording = read_recording(bag, samples.SETTINGS)
    assert not recording.observations
    told = r"have no stamp \(header.stamp is zero\); let their driver stamp them"
    assert any(re.search(f"messages on /dlo/observed {told}", line) for line in recording.skipped)
    with pytest.raises(RecordingError, match=f"messages on /image_raw {told}"):
        list(iterate_images(bag))
    with pytest.raises(RecordingError, match=f"messages on /dlo/points {told}"):
        list(iterate_points(bag, samples.SETTINGS))


def test_simulated_time_may_begin_at_zero(tmp_path):
    recording = read_recording(moved(tmp_path, -samples.START // SECOND), samples.SETTINGS)
    assert recording.observations[0].stamp < SECOND
    assert len(recording.observations) == 4


def test_tables_of_other_times_are_told_at_once(tmp_path, caplog):
    samples.SETTINGS.dump(tmp_path / "params.yaml")
    (tmp_path / "points.csv").write_text("time_s,x,y,z\n10,0,0,0\n11,0,0,0\n")
    (tmp_path / "command.csv").write_text(
        "time_s,name,x,y,z,qx,qy,qz,qw\n0,start,0,0,0,0,0,0,1\n1,start,0,0,0.1,0,0,0,1\n"
    )
    call = ["import", "--format", "points", "--params", str(tmp_path / "params.yaml")]
    call += ["--output", str(tmp_path / "bag")]
    assert main([*call, str(tmp_path / "points.csv"), str(tmp_path / "command.csv")]) == 0
    assert "command.csv: what is seen, 1750000010.000 to 1750000011.000 s, lies" in caplog.text
