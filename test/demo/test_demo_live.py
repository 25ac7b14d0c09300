# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The demo around its nodes, which are played here: what it waits for, hears and makes of it."""

import json
import subprocess
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import recordings_samples
from rich.console import Console
from small_bags import SETTINGS, write_own

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from dlo_ros.cli.main import main
from dlo_ros.demo import live
from dlo_ros.demo.processes import ProcessError
from dlo_ros.demo.terminal_progress import Progress
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.output_monitor import monitoring
from dlo_ros.nodes.received_data import ReceivedData
from dlo_ros.recordings import read_recording, spline_message, topics

WARN, OK = DiagnosticStatus.WARN, DiagnosticStatus.OK


def played(bag, settings):
    """What the nodes would publish if they predicted 1 mm too high."""
    received = ReceivedData()
    for k, seen in enumerate(read_recording(bag, settings).observations):
        received.observed[seen.stamp] = seen.control_points
        received.predicted[seen.stamp] = seen.control_points + np.array([0.0, 0.0, 0.001, 0.0])
        received.tick(seen.stamp)
        received.err.append((seen.stamp, 0.001))
        received.take_estimate(1e7 + 1e5 * k, 2000.0)
    received.take_diagnostics({"specific_modulus std [m^2/s^2]": "200"})
    received.warnings.append("observer: a strange picture")
    return received


@pytest.mark.parametrize("images", [True, False])
def test_what_was_heard_becomes_a_result_with_pictures(images, tmp_path, monkeypatch, capsys):
    bag = tmp_path / "bag"
    if images:
        settings = SETTINGS
        write_own(bag)
    else:
        settings = recordings_samples.SETTINGS
        recordings_samples.write_plain(bag, recordings_samples.messages(images=False))
    settings.dump(tmp_path / "params.yaml")
    monkeypatch.setattr(live, "run_live", lambda run, console: played(run.bag, run.settings))
    output = tmp_path / "out"
    assert main(["demo", "--bag", str(bag), "--output", str(output)]) == 0
    assert "1.0 mm; E/mu" in capsys.readouterr().out.splitlines()[-1]
    tree = json.loads((output / "estimate.json").read_text())
    assert tree["specific_modulus"]["std"] == 200.0
    page = (output / "report.html").read_text()
    assert ("data:image/jpeg" in page) == images and "a strange picture" in page
    picture = cv2.imread(str(output / "overview.png"))
    assert picture.shape[0] > 300 and picture.std() > 5.0


def test_a_recording_that_cannot_be_made_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(subprocess, "run", lambda *_: SimpleNamespace(returncode=2))
    assert main(["demo", "--output", str(tmp_path / "out")]) == 2
    assert "the recording of c_shape could not be made" in capsys.readouterr().err


class Nodes:
    """Stands for the listener and the processes."""

    def __init__(self, received=None, missing=()):
        self.received = received or ReceivedData()
        self.messages = 0
        self.process = SimpleNamespace(poll=lambda: 0 if self.messages > 2 else None)
        self._missing = list(missing)

    def missing(self):
        return self._missing

    def listen(self, seconds):
        self.messages += self.messages < 3

    def state(self, name):
        return f"waiting for something that {name} needs"

    def check(self, *_):
        pass


def test_nodes_that_do_not_appear_are_named(monkeypatch):
    monkeypatch.setattr(live, "READY_WITHIN", 0.05)
    nodes = Nodes(missing=["observer", "identifier"])
    with pytest.raises(ProcessError, match=r"observer and identifier did not appear within 0 s"):
        live._wait_until_ready(nodes, nodes)


def test_a_run_without_result_says_what_each_node_waits_for(tmp_path, monkeypatch):
    monkeypatch.setattr(live, "QUIET", 0.05)
    bag = recordings_samples.write_plain(
        tmp_path / "bag", recordings_samples.messages(images=False)
    )
    whole = played(bag, recordings_samples.SETTINGS)

    def listen(received):
        nodes = Nodes(received)
        with Progress(Console(quiet=True), 1.0) as progress:
            live._listen(nodes, nodes, nodes, progress)

    with pytest.raises(ProcessError, match=r"nothing was observed .* something that observer"):
        listen(ReceivedData())
    with pytest.raises(ProcessError, match=r"could be compared .* simulator needs; identifier: "):
        listen(ReceivedData(observed=whole.observed))
    listen(whole)


def test_the_listener_keeps_what_is_well_formed_and_each_warning_once(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    settings = recordings_samples.SETTINGS
    shape = recordings_samples.control_points()
    good = spline_message(ROS_MESSAGES, 10**9, settings.frame_id, shape)
    short = spline_message(ROS_MESSAGES, 2 * 10**9, settings.frame_id, shape[:-1])

    def say(monitor, *statuses):
        monitor._diagnostics(
            DiagnosticArray(
                status=[
                    DiagnosticStatus(
                        name=f"{node}: task", level=level, message=message,
                        values=[KeyValue(key="specific_modulus std [m^2/s^2]", value="12")],
                    )
                    for node, level, message in statuses
                ]
            )
        )  # fmt: skip

    with monitoring(settings) as monitor:
        assert monitor.missing() == ["observer", "simulator", "identifier"]
        # Before the first prediction nobody has played anything: what is amiss then may pass.
        say(
            monitor,
            ("simulator", WARN, "nobody publishes a pose"),
            ("observer", WARN, "it is dark"),
        )
        assert len(monitor.received.warnings) == 2
        for topic in (topics.OBSERVED, topics.PREDICTED):
            monitor._spline(topic, good)
            monitor._spline(topic, short)
        assert list(monitor.received.observed) == list(monitor.received.predicted) == [10**9]
        assert monitor.state("identifier") == "it has no status yet"
        say(monitor, ("observer", WARN, "waiting for camera_info"), ("other", WARN, "is hot"))
        say(monitor, ("/left/observer", WARN, "3 px too thin"), ("identifier", OK, "estimating"))
        say(monitor, ("observer", WARN, "4 px too thin"), ("simulator", WARN, "4 px too thin"))
        assert monitor.state("observer") == "4 px too thin"
        assert monitor.received.warnings == ["observer: 3 px too thin", "simulator: 4 px too thin"]
        say(monitor, ("observer", WARN, "it is dark"))  # what lasts is told again
        assert monitor.received.warnings[2:] == ["observer: it is dark"]
        assert monitor.received.facts["specific_modulus std [m^2/s^2]"] == "12"
