# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What fails, and takes long to do so, must not take all of a node's time."""

import time

import pytest

pytest.importorskip("rclpy")

from fuzz_graph import Graph

from dlo_ros.errors import SimulationError
from dlo_ros.nodes import simulator
from dlo_ros.recordings import topics

pytestmark = [pytest.mark.live, pytest.mark.slow]

LONG = 0.3
"""Seconds that each attempt takes."""


@pytest.fixture
def graph(monkeypatch):
    made = Graph(monkeypatch)
    yield made
    made.close()


@pytest.mark.parametrize("what", ["advance", "start"])
def test_a_simulation_that_fails_slowly_leaves_half_of_the_time(graph, monkeypatch, what):
    graph.works()
    monkeypatch.setattr(simulator, "RETRY", 0.0)
    node, busy = graph.nodes["simulator"], []

    def fails(*_):
        time.sleep(LONG)
        busy.append(LONG)
        raise SimulationError("it does not converge")

    with monkeypatch.context() as patch:
        patch.setattr(node._simulation, what, fails)
        if what == "start":
            node.reset()
        began = time.monotonic()
        while time.monotonic() - began < 8.0 * LONG:
            graph.tick(graph.now + 10_000_000)
            if what == "start":
                graph.send(topics.COMMAND, graph.good.command(graph.now))
                graph.send(topics.OBSERVED, graph.good.spline(graph.now))
            node._tick()
            time.sleep(0.01)
        elapsed = time.monotonic() - began
    # Each wait is as long as the attempt before it; the loop may end right after an attempt.
    assert 2 * LONG <= sum(busy) <= 0.5 * elapsed + LONG
    graph.works()
