# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The demo around its nodes, which are played here: what it waits for, hears and makes of it."""

import contextlib
import json
import subprocess
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import recordings_samples
from rich.console import Console
from small_bags import SETTINGS, write_own

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue

from dlo_ros.cli.main import main
from dlo_ros.demo import live
from dlo_ros.demo.outcome import LiveOutcome
from dlo_ros.demo.processes import ProcessError
from dlo_ros.demo.result import remarks
from dlo_ros.demo.terminal_progress import Progress
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.output_monitor import monitoring
from dlo_ros.nodes.received_data import BACKLOG, ReceivedData
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
    received.simulated = [(0, received.young_modulus / 2000.0)]
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


def late(bag, settings):
    """The same, with a simulator that has the estimate only when all is over."""
    received = played(bag, settings)
    received.simulated = [(0, 2000.0), (max(received.observed), received.young_modulus / 2000.0)]
    return received


def plain_bag(tmp_path):
    bag = tmp_path / "bag"
    recordings_samples.write_plain(bag, recordings_samples.messages(images=False))
    recordings_samples.SETTINGS.dump(tmp_path / "params.yaml")
    return bag


@pytest.mark.parametrize(("late_passes", "known"), [(0, True), (1, True), (9, False)])
def test_what_a_busy_machine_left_behind_is_played_again_and_never_told_as_the_result(
    tmp_path, monkeypatch, capsys, late_passes, known
):
    bag = plain_bag(tmp_path)
    plays = []

    class Monitor(Nodes):
        def begin_again(self):
            self.received = ReceivedData(passes=self.received.passes + 1)

    class Started(Nodes):
        def __init__(self, *_):
            super().__init__()

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def start(self, name, words):
            plays.extend([words] * (name == "play"))
            return name

    monitor = Monitor()

    def listen(monitor, children, players, progress):
        passes = monitor.received.passes
        assert players == ["play"] * passes
        make = late if passes <= late_passes else played
        monitor.received = make(bag, recordings_samples.SETTINGS)
        monitor.received.passes = passes

    monkeypatch.setattr(live, "monitoring", lambda settings: contextlib.nullcontext(monitor))
    monkeypatch.setattr(live, "Children", Started)
    monkeypatch.setattr(live, "isolate", lambda logs: 7)
    monkeypatch.setattr(live, "_listen", listen)
    output = tmp_path / "out"
    assert main(["demo", "--bag", str(bag), "--output", str(output)]) == (0 if known else 1)
    assert len(plays) == min(late_passes + 1, live.PASSES) and len(set(map(tuple, plays))) == 1
    told = " ".join(capsys.readouterr().out.split())
    (row,) = json.loads((output / "estimate.json").read_text())["recordings"]
    assert (row["err"] == pytest.approx(1e-3)) if known else (row["err"] is None)
    assert ("-> 1.0 mm; E/mu" in told) == known
    assert ("-> unknown mm; E/mu" in told) == (not known)
    assert ("ERR at the end is not known: this machine was too busy" in told) == (not known)
    again = f"too busy for the nodes, so the recording was played {len(plays)} times"
    assert (again in told) == (late_passes > 0)
    assert (again in (output / "report.html").read_text()) == (late_passes > 0)


def test_the_simulator_is_in_time_with_what_it_had_then(tmp_path):
    bag = plain_bag(tmp_path)
    received = late(bag, recordings_samples.SETTINGS)
    last = max(received.observed)
    assert not received.in_time(last - 1) and received.in_time(last)
    received.simulated = []
    assert not received.in_time(last)
    ratio = received.young_modulus / 2000.0
    received.simulated = [(0, ratio + 190.0)]  # the estimate is known to 200
    assert received.in_time(last)
    received.take_diagnostics({"specific_modulus identifiable": "no"})
    received.simulated = [(0, 2000.0)]  # there is nothing better
    assert received.in_time(last)


def test_the_listener_waits_for_splines_that_wait(tmp_path, monkeypatch):
    """An estimate may take longer than silence lasts."""
    monkeypatch.setattr(live, "QUIET", 0.05)
    received = played(plain_bag(tmp_path), recordings_samples.SETTINGS)
    nodes = Nodes(received)
    nodes.messages = 3
    received.facts[BACKLOG] = "40"
    ends = time.monotonic() + 0.5

    def listen(seconds):
        if time.monotonic() > ends:
            received.facts[BACKLOG] = "0"

    nodes.listen = listen
    with Progress(Console(quiet=True), 1.0) as progress:
        live._listen(nodes, nodes, [nodes], progress)
        assert time.monotonic() > ends
        monkeypatch.setattr(live, "DRAINED_WITHIN", 0.1)
        nodes.listen, received.facts[BACKLOG] = lambda seconds: None, "40"
        live._listen(nodes, nodes, [nodes], progress)
    outcome = LiveOutcome(received.estimate(), None, 1e-3, None, {})
    (said,) = remarks(received, outcome)
    assert "40 observed shapes were still waiting" in said


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
            live._listen(nodes, nodes, [nodes], progress)

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

    def changed(node, **values):
        event = ParameterEvent(node=node)
        event.stamp.sec = 12
        for key, value in values.items():
            event.changed_parameters.append(
                Parameter(name=f"rod.{key}", value=ParameterValue(type=3, double_value=value))
            )
        return event

    with monitoring(settings) as monitor:
        given = settings.rod.specific_modulus
        for node in ("/identifier", "/left/simulator"):
            monitor._changed(changed(node, young_modulus=6e7, density=3000.0))
        monitor._changed(changed("/simulator", density=2000.0))
        assert monitor.received.simulated == [
            (0, given), (12 * 10**9, 2e4), (12 * 10**9, 3e4)
        ]  # fmt: skip
        monitor.begin_again()
        assert monitor.received.simulated == [(0, 3e4)] and monitor.received.passes == 2
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
