# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A node says how far its kernels are, answers meanwhile, and ends where they cannot be had."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from live_graph import Client, Process
from rcl_interfaces.srv import ListParameters

from dlo_ros.compilation import CompilationProgress
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes import kernel_preparation
from dlo_ros.nodes.kernel_preparation import LOADING, Preparation
from dlo_ros.nodes.qos import LATCHED
from dlo_ros.parameters import Settings

pytestmark = pytest.mark.live

NODES = ("observer", "simulator", "identifier")
PATIENCE = 10.0  # [s]
HALF = CompilationProgress(False, 0.4, 30.0)
DONE = CompilationProgress(True, 1.0, 0.0)


class StandIn:
    """A compilation that says what the test wants it to."""

    def __init__(self, progress=HALF):
        self.progress = progress
        self.stages = None
        self.stopped = False

    def __call__(self, stages):
        self.stages = stages
        return self

    def start(self):
        return not self.progress.done

    def poll(self):
        return self.progress

    def stop(self):
        self.stopped = True


class Node:
    """What `Preparation` asks of a node."""

    def __init__(self):
        self.published, self.logged = [], []

    def create_publisher(self, kind, topic, qos):
        assert topic == "~/ready" and qos is LATCHED
        return self

    def publish(self, message):
        self.published.append(message.data)

    def get_logger(self):
        return self

    def info(self, text):
        self.logged.append(text)


@pytest.fixture
def prepare(monkeypatch):
    """Makes a preparation, its node and the stand-in for its compilation."""

    def make(load=lambda: None, progress=HALF):
        compilation, node = StandIn(progress), Node()
        monkeypatch.setattr(kernel_preparation, "BackgroundCompilation", compilation)
        return Preparation(node, ("rod",), load), node, compilation

    return make


def until_it_ends(one):
    limit = time.monotonic() + PATIENCE
    while not (ended := one.proceed()) and not one.error:
        assert time.monotonic() < limit
        time.sleep(0.005)
    return ended


def test_first_compiled_then_loaded_then_ready(prepare):
    loaded, go = [], threading.Event()

    def load():
        assert go.wait(PATIENCE)
        loaded.append(threading.current_thread())

    one, node, compilation = prepare(load)
    assert compilation.stages == ("rod",) and node.published == [False]
    assert one.state == "compiling, 40 %, about 30 s"
    assert not one.proceed() and one.state == "compiling, 40 %, about 30 s"
    compilation.progress = DONE
    for _ in range(3):  # the node is not held up
        assert not one.proceed() and one.state == LOADING and not one.done
    go.set()
    assert until_it_ends(one) and one.done and not one.proceed()
    assert loaded and loaded[0] is not threading.main_thread()
    assert node.published == [False]  # the node says so when it has begun its work
    one.announce("waiting for a rope")
    assert node.published == [False, True]
    first, last = node.logged
    assert first.startswith("compiling the numerical kernels")
    assert last.startswith("ready: waiting for a rope; the kernels compiled for")


def test_no_word_of_compiling_where_all_is_compiled(prepare):
    one, node, _ = prepare(progress=DONE)
    states = {one.state}
    while not one.proceed():
        states.add(one.state)
    one.announce("waiting for a rope")
    assert node.logged == ["ready: waiting for a rope"]
    assert states == {LOADING}


def test_the_progress_is_logged_now_and_then(prepare, monkeypatch):
    one, node, _ = prepare()
    one.proceed()
    assert len(node.logged) == 1
    monkeypatch.setattr(kernel_preparation, "REPORT_INTERVAL", 0.0)
    one.proceed()
    assert node.logged[1:] == ["compiling, 40 %, about 30 s"]


def test_what_cannot_be_compiled_is_an_error(prepare):
    one, node, compilation = prepare()
    compilation.progress = CompilationProgress(False, 0.4, None, "no room")
    assert not one.proceed() and one.error == "no room" and one.state == "no room"
    compilation.progress = DONE
    assert not one.proceed() and not one.done and node.published == [False]


def test_what_cannot_be_loaded_is_an_error(prepare):
    def load():
        raise OSError("a file has vanished")

    one, node, _ = prepare(load, DONE)
    assert not until_it_ends(one) and not one.done and node.published == [False]
    assert one.error == "the compiled kernels cannot be loaded (OSError: a file has vanished)"


def test_a_node_that_ends_ends_what_it_has_started(prepare):
    one, _, compilation = prepare()
    one.stop()
    assert compilation.stopped


# --- live, with nothing compiled ---------------------------------------------------------------


@pytest.fixture
def starting(tmp_path, monkeypatch):
    """The three nodes, started at once with an empty cache of compiled kernels."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    rod = {"length": 0.4, "diameter": 0.004, "young_modulus": 4e6, "density": 2000.0}
    settings = Settings.from_mapping({f"rod.{name}": value for name, value in rod.items()})
    settings.dump(tmp_path / "params.yaml")
    words = ("--ros-args", "--params-file", str(tmp_path / "params.yaml"))
    domain = free_domain()
    client = Client(domain)
    nodes = {name: Process(tmp_path, name, *words, domain=domain) for name in NODES}
    yield client, nodes
    client.close()
    for process in nodes.values():
        process.process.kill()
        process.process.wait()


def children(process: int) -> list[int]:
    return [int(c) for c in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


@pytest.mark.live
def test_nodes_answer_while_they_compile_and_one_that_cannot_ends_alone(starting):
    client, nodes = starting
    statuses = client.hear("/diagnostics", kind="diagnostic_msgs/msg/DiagnosticArray")
    ready = {n: client.hear(f"/{n}/ready", LATCHED, "std_msgs/msg/Bool") for n in NODES}

    def compiling(name: str) -> bool:
        return any(
            status.name.startswith(f"{name}:") and status.message.startswith("compiling, ")
            for message in statuses
            for status in message.status
        )

    # Ten seconds on an idle machine; the compilation itself takes minutes here.
    client.until(lambda: all(map(compiling, NODES)), 40.0, "diagnostics")
    for name in NODES:
        names = client.call(ListParameters, f"/{name}/list_parameters", ListParameters.Request())
        assert "rod.length" in names.result.names
        assert [message.data for message in ready[name]] == [False]
    workers = {name: children(nodes[name].process.pid) for name in NODES}
    assert all(workers.values())
    for worker in workers["simulator"]:
        os.kill(worker, signal.SIGKILL)
    assert nodes["simulator"].wait() == 2
    *_, last = nodes["simulator"].said.splitlines()
    assert last == (
        "dlo_ros simulator: the numerical kernels could not be compiled: "
        "the compiling process was killed (signal 9)"
    )
    statuses.clear()
    client.until(lambda: compiling("observer") and compiling("identifier"), what="the others")
    for name in ("observer", "identifier"):
        assert nodes[name].interrupt(times=2) == 0, nodes[name].said
    for name in NODES:
        assert "Traceback" not in nodes[name].said and "ready" not in nodes[name].said
        for worker in workers[name]:
            assert not Path(f"/proc/{worker}").exists()
