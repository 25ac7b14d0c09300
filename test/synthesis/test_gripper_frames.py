# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A simulated robot's grippers in /tf give the experiment's motion again; the demo in space."""

import json
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dlo_ros.cli import demo
from dlo_ros.cli.main import main
from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.demo import plan
from dlo_ros.demo.overview_space import write_space_overview
from dlo_ros.demo.photographs import Photograph
from dlo_ros.demo.plan import plan_run
from dlo_ros.errors import InputError, RecordingError
from dlo_ros.files import read_yaml
from dlo_ros.nodes.received_data import ReceivedData
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import open_bag
from dlo_ros.recordings.camera_bags import iterate_together
from dlo_ros.recordings.read import read_recording
from dlo_ros.report import IdentificationReport, RecordingRow, ShapeFrame
from dlo_ros.synthesis.experiment import START_STAMP, find_experiment, read_experiment
from dlo_ros.synthesis.gripper_frames import MARGIN
from dlo_ros.synthesis.synthesize import synthesize

TURNED = (0.02, -0.03, 0.1, *Rotation.from_rotvec([0.3, -1.2, 0.4]).as_quat().tolist())
"""A clamp that points along none of the gripper's axes."""

VIEWS = [f"/{s}/{t}" for s in ("left", "right") for t in (topics.CAMERA_INFO, topics.COMPRESSED)]


def tree(**changes):
    return read_yaml(find_experiment("two_grippers")) | changes


def experiment(**changes):
    return read_experiment(tree(**changes), "two_grippers", "two_grippers.yaml")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A recording of three instants: the experiment, its bag and the settings beside it."""
    bag = tmp_path_factory.mktemp("bags") / "bag"
    short = experiment(duration=0.2, camera={"rate": 10.0})
    turned = replace(short.truth.command, start_offset=TURNED)
    short = replace(
        short,
        truth=replace(short.truth, command=turned),
        guess=replace(short.guess, command=turned),
    )
    synthesize(short, bag, edges=40, step=5e-3)
    return short, bag, Settings.load(bag / "params.yaml")


def test_two_cameras_0_3_m_apart_watch_grippers_that_move():
    whole = experiment()
    places = [
        -Rotation.from_quat(pose.rotation).inv().apply(pose.translation)
        for _, pose in whole.cameras.values()
    ]
    assert np.linalg.norm(places[0] - places[1]) == pytest.approx(0.3, abs=2e-3)
    assert [place[1] for place in places] == pytest.approx([-1.2, -1.2], abs=0.03)
    assert whole.spatial and whole.command.names == ("start", "end")
    assert np.all(np.ptp(whole.command.positions, axis=0).max(axis=1) > 0.05)


@pytest.mark.parametrize("source", ["tf", "pose"])
def test_frames_and_poses_are_read_back_as_the_command(made, source):
    short, bag, settings = made
    settings = replace(settings, command=replace(settings.command, source=source))
    recording = read_recording(bag, settings)
    (command,) = recording.commands
    assert not recording.skipped and command.names == short.command.names
    assert command.stamp == START_STAMP - MARGIN
    assert command.end_stamp == short.stamps[-1] + MARGIN
    for stamp in range(command.stamp, command.end_stamp, NANOSECONDS // 333):
        expected, turns = short.command.sample(stamp)
        positions, rotations = command.sample(stamp)
        np.testing.assert_allclose(positions, expected, atol=1e-9)
        off = Rotation.from_quat(rotations).inv() * Rotation.from_quat(turns)
        assert off.magnitude().max() < 1e-9


def test_the_frames_are_the_grippers_and_no_command_is_written(made):
    _, bag, settings = made
    with open_bag(bag) as recording:
        assert not recording.find(topics.COMMAND)
        assert {c.topic for c in recording.connections} == {
            topics.MOVING_TRANSFORMS, f"/{topics.START_POSE}", f"/{topics.END_POSE}",
            *VIEWS,
        }  # fmt: skip
    moved = replace(settings, command=replace(settings.command, start_frame="elsewhere"))
    with pytest.raises(RecordingError, match="elsewhere"):
        read_recording(bag, moved)


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ({"source": "tf", "start_frame": "left_gripper"}, "frames for start, but motion moves end"),
        ({"source": "tf", "start_frame": "a"}, "name command.start_frame and command.end_frame"),
    ],
)
def test_a_grip_without_frame_is_refused(block, reason):
    parameters = tree()["parameters"] | {"command": block}
    with pytest.raises(InputError) as caught:
        experiment(parameters=parameters)
    assert reason in str(caught.value) and "\n" not in str(caught.value)


def test_both_cameras_and_the_grippers_are_played(made, tmp_path, monkeypatch):
    _, bag, settings = made
    monkeypatch.setattr(plan, "installed", lambda kind: True)
    run = plan_run(bag, bag / "params.yaml", settings, tmp_path)
    assert run.has_images and set(run.topics) == {
        topics.MOVING_TRANSFORMS,
        *VIEWS,
    }  # fmt: skip
    monkeypatch.setattr(plan, "installed", lambda kind: False)
    with pytest.raises(InputError, match="tf2_msgs is missing"):
        plan_run(bag, bag / "params.yaml", settings, tmp_path)
    poses = replace(settings, command=replace(settings.command, source="pose"))
    played = plan_run(bag, bag / "params.yaml", poses, tmp_path).topics
    assert {f"/{topics.START_POSE}", f"/{topics.END_POSE}"} < set(played)
    assert topics.MOVING_TRANSFORMS not in played
    third = replace(settings, cameras={**settings.cameras, "top": settings.camera})
    with pytest.raises(RecordingError, match="neither images of camera 'top' nor dlo/observed"):
        plan_run(bag, bag / "params.yaml", third, tmp_path)


def played(bag, settings, std):
    """The messages of nodes that see the DLO as a straight line, and know E/mu that well.

    The simulator had that E/mu from the beginning: the recording is as short as what is judged.
    """
    heard = ReceivedData(simulated=[(0, 1e7 / 2000.0)])
    line = np.column_stack([np.linspace(0.0, 0.3, 10), *np.zeros((3, 10))])
    for k, images in enumerate(iterate_together(bag, list(settings.cameras))):
        stamp = images["left"].stamp
        heard.observed[stamp] = line
        heard.predicted[stamp] = line + np.array([0.0, 0.001, 0.001, 0.0])
        heard.tick(stamp)
        heard.err.append((stamp, 0.001))
        heard.take_estimate(1e7 + 1e4 * k, 2000.0)
    heard.take_diagnostics({"specific_modulus std [m^2/s^2]": std})
    return heard


@pytest.mark.slow
@pytest.mark.parametrize(("std", "status"), [("200", 0), ("-", 1)])
def test_the_demo_in_space_pictures_all_cameras_and_says_what_stays_unknown(
    made, tmp_path, monkeypatch, capsys, std, status
):
    _, bag, _ = made
    live = pytest.importorskip("dlo_ros.demo.live")
    seen = []
    monkeypatch.setattr(demo, "_synthesize", lambda name, output, console: bag)

    def run(planned, console):
        seen.append(planned)
        return played(planned.bag, planned.settings, std)

    monkeypatch.setattr(live, "run_live", run)
    assert main(["demo", "--space", "--output", str(tmp_path)]) == status
    said = capsys.readouterr().out
    assert "1.4 mm; E/mu" in said.splitlines()[-1]
    assert ("E/mu is not identified" in said) == bool(status)
    assert Settings.load(seen[0].params).command.source == seen[0].settings.command.source
    assert json.loads((tmp_path / "estimate.json").read_text())["true"]["specific_modulus"]
    picture = cv2.imread(str(tmp_path / "overview.png"))
    assert picture.shape[0] > 500 and picture[:300].std() > 20.0
    assert "data:image/jpeg" in (tmp_path / "report.html").read_text()


def test_the_view_in_space_shows_the_clamps_ways_without_pictures_too(tmp_path):
    motion = Motion([experiment().command])
    line = np.column_stack([np.linspace(0.0, 0.3, 10), *np.zeros((3, 10))])
    frames = tuple(ShapeFrame(time=0.1 * k, observed=line, err=0.001) for k in range(3))
    page = IdentificationReport(
        title="", headline="", estimates=(), tracks=(), noise_floor=None, remarks=(),
        recordings=(RecordingRow("a", "live", 0.4, None, 0.001, frames),),
    )  # fmt: skip
    write_space_overview(tmp_path / "a.png", page, {}, motion, START_STAMP)
    lone = Photograph(b"", 1, 1)
    write_space_overview(tmp_path / "b.png", page, {"left": {0: lone}}, motion, START_STAMP)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_space_is_a_recording_of_its_own(tmp_path, capsys):
    assert main(["demo", "--space", "--bag", "x", "--output", str(tmp_path / "out")]) == 2
    assert "leave --space or --bag out" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.live
def test_the_demo_in_space_finds_the_material(tmp_path):
    pytest.importorskip("rclpy")
    command = [sys.executable, "-m", "dlo_ros", "demo", "--space", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("ERR ")
    found = json.loads((tmp_path / "estimate.json").read_text())
    ratio = found["specific_modulus"]["value"] / found["true"]["specific_modulus"]["value"]
    assert ratio == pytest.approx(1.0, abs=0.1) and found["identifiable"]["specific_modulus"]
    assert found["recordings"][0]["err"] < 0.002
