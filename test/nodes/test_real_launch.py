# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The launch files under ROS's own `launch`, where it is installed: what starts, what it ends with.

What they ask it to start is tested in test_launch.py, also where there is none.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import recordings_samples as samples
from conftest import ROOT

pytest.importorskip("launch.actions", reason="ROS's launch is not installed (it is not on PyPI)")
pytest.importorskip("launch_ros.actions", reason="ROS's launch_ros is not installed")

from live_graph import Client

from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.qos import CLOCK
from dlo_ros.recordings import topics

pytestmark = pytest.mark.live

LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource

path, *arguments = sys.argv[1:]
service = LaunchService(argv=arguments, noninteractive=True)
given = [tuple(a.split(":=", 1)) for a in arguments]
source = AnyLaunchDescriptionSource(path)
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=given)])
)
sys.exit(service.run())
"""
"""What `ros2 launch` does, without the command."""

STARTED = 120.0
"""Seconds within which compiled nodes have started on a busy machine, and the recording plays."""

PYTHON = 1.0
"""Seconds that Python itself needs on a busy machine to start, when an interrupt is not quiet."""

PARAMETERS = "params_file:={params}"
BROKEN = "/**: {ros__parameters: {rod: {length: -1.0, diameter: 0.004}}}\n"


@pytest.fixture(scope="module")
def prefix(tmp_path_factory) -> Path:
    """A prefix of ROS's index with this package as an installation has it, and without RViz."""
    folder = tmp_path_factory.mktemp("prefix")
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "dlo_ros").touch()
    (folder / "share" / "dlo_ros").mkdir()
    for name in ("config", "launch", "package.xml"):
        (folder / "share" / "dlo_ros" / name).symlink_to(ROOT / name)
    (folder / "lib").mkdir()
    (folder / "lib" / "dlo_ros").symlink_to(ROOT / "scripts")
    return folder


class Launched:
    """A launch in a graph of its own; what it prints goes to a file."""

    def __init__(self, prefix: Path, folder: Path, file: str, *words: str, domain: int) -> None:
        self.log = folder / f"launch-{time.monotonic_ns()}.log"
        environment = os.environ | {
            "AMENT_PREFIX_PATH": str(prefix),
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder),
            "OMP_NUM_THREADS": "1",
        }
        path = prefix / "share" / "dlo_ros" / "launch" / f"{file}.launch.py"
        with self.log.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-c", LAUNCH, str(path), *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=folder,
                start_new_session=True,  # a group of its own, as a terminal has it
            )

    @property
    def said(self) -> str:
        return self.log.read_text()

    def wait(self, seconds: float = 60.0) -> int:
        return self.process.wait(seconds)

    def end(self, *, terminal: bool = False) -> int:
        """Interrupt the launch alone, or as Ctrl-C in a terminal does: all its processes."""
        if self.process.poll() is None:
            (os.killpg if terminal else os.kill)(self.process.pid, signal.SIGINT)
        try:
            return self.process.wait(20.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise AssertionError(f"does not end; it said: {self.said}") from None


@pytest.fixture
def launch(prefix, tmp_path):
    """Starts launches, and ends those that still run."""
    running: list[Launched] = []
    domain = free_domain()

    def start(file: str, *words: str) -> Launched:
        running.append(Launched(prefix, tmp_path, file, *words, domain=domain))
        running[-1].domain = domain
        return running[-1]

    yield start
    for launched in running:
        launched.end()


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> dict[str, str]:
    """Parameter files and recordings."""
    folder = tmp_path_factory.mktemp("given")
    samples.SETTINGS.dump(folder / "params.yaml")
    (folder / "broken.yaml").write_text(BROKEN)
    samples.write_plain(folder / "splines", samples.messages(images=False))
    samples.write_plain(folder / "recording", samples.messages())
    return {p.name.removesuffix(".yaml"): str(p) for p in folder.iterdir()}


@contextmanager
def listening(domain: int) -> Iterator[Client]:
    client = Client(domain)
    try:
        yield client
    finally:
        client.close()


@pytest.mark.parametrize(
    ("file", "words", "reason"),
    [
        ("dlo", ("params_file:=/none.yaml",), "params_file:=/none.yaml: no such file"),
        ("replay", ("bag:=/none",), "bag:=/none: no such bag"),
        ("dlo", ("rviz:=true",), "rviz needs the package rviz2, which is not installed"),
        ("dlo", ("video_device:=/dev/video0",), "video_device needs the package v4l2_camera"),
        ("replay", ("bag:={splines}", "observe:=true"), "holds no images; give observe:=false"),
    ],
)
def test_what_is_missing_ends_the_launch_before_anything_starts(launch, given, file, words, reason):
    launched = launch(file, *(word.format(**given) for word in words))
    assert launched.wait() == 1
    assert reason in launched.said and "process started" not in launched.said
    assert "Traceback" not in launched.said


@pytest.mark.parametrize("file", ["dlo", "replay"])
def test_a_node_that_refuses_its_parameters_ends_the_launch_and_all_else(launch, given, file):
    bag = ("bag:={splines}".format(**given),) if file == "replay" else ()
    launched = launch(file, "params_file:={broken}".format(**given), *bag)
    assert launched.wait() == 1, launched.said
    assert "rod.length is -1" in launched.said
    started = launched.said.count("process started with pid")
    ended = launched.said.count("process has finished") + launched.said.count("process has died")
    assert started == ended > 0, launched.said
    assert "ended with status 2, as it says above" in launched.said


def test_a_recording_that_cannot_be_played_fails_the_launch(launch, given, tmp_path):
    bag = samples.write_plain(tmp_path / "bag", samples.messages())
    (stored,) = bag.glob("*.mcap")
    stored.write_bytes(stored.read_bytes()[:2000])
    launched = launch("replay", f"bag:={bag}", PARAMETERS.format(**given))
    assert launched.wait() == 1, launched.said
    assert "damaged or cut short" in launched.said
    assert "play ended with status 2, as it says above" in launched.said


def test_nodes_that_are_never_ready_fail_the_launch(launch, given):
    """Nothing is ready within half a second."""
    words = ("bag:={splines}", PARAMETERS, "wait:=0.5")
    launched = launch("replay", *(word.format(**given) for word in words))
    assert launched.wait() == 1, launched.said
    assert "waited 0.5 s in vain for simulator (" in launched.said


def test_a_replay_of_splines_waits_plays_and_ends(launch, given):
    """One publisher of the splines, no observer, no images, and the clock of its namespace."""
    words = ("bag:={recording}", PARAMETERS, "observe:=false", "namespace:=left")
    launched = launch("replay", *(word.format(**given) for word in words))
    with listening(launched.domain) as client:
        heard = client.hear("/left/dlo/observed", kind=topics.TYPES[topics.OBSERVED])
        clock = client.hear("/left/clock", CLOCK, "rosgraph_msgs/msg/Clock")
        client.until(lambda: heard, STARTED, "the first spline")
        graph = client.node
        assert graph.count_publishers("/left/dlo/observed") == 1
        names = {name for name, _ in graph.get_topic_names_and_types()}
        assert not {n for n in names if "image_raw" in n or n == "/clock"} and clock
        nodes = set(graph.get_node_names_and_namespaces())
        assert nodes == {("client", "/")} | {
            (name, "/left") for name in ("simulator", "identifier", "player")
        }
        client.until(lambda: launched.process.poll() is not None, 60.0, "the end")
    assert launched.wait() == 0, launched.said
    assert len(heard) == 4 and "nobody listens" not in launched.said
    assert "Traceback" not in launched.said


def test_an_interrupt_ends_a_replay_that_still_waits(launch, given):
    launched = launch("replay", *(w.format(**given) for w in ("bag:={splines}", PARAMETERS)))
    with listening(launched.domain) as client:
        client.until(lambda: "waiting for " in launched.said, 30.0, "the player")
    assert launched.end() == 0, launched.said
    assert "Traceback" not in launched.said and "Caught exception" not in launched.said


@pytest.mark.parametrize(
    "moment", ["process started with pid", "waiting for ", "simulation starts"]
)
def test_ctrl_c_in_a_terminal_ends_a_replay_at_any_time(launch, given, moment):
    """Whatever ends first, of the processes and what launch notes; nothing is left."""
    words = ("bag:={recording}", PARAMETERS, "observe:=false")
    launched = launch("replay", *(word.format(**given) for word in words))
    with listening(launched.domain) as client:
        client.until(lambda: moment in launched.said, STARTED, moment)
        if "started" in moment:
            time.sleep(PYTHON)
    assert launched.end(terminal=True) == 0, launched.said
    assert "Traceback" not in launched.said and "Caught exception" not in launched.said
    with pytest.raises(ProcessLookupError):
        os.killpg(launched.process.pid, 0)
