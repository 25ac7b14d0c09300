# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The live simulator tells what the DLO does to its grip, and raises the alarm."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from live_graph import Client, Process, to_ros

from dlo_ros.command import Command
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.load_publishing import LoadPublisher
from dlo_ros.nodes.qos import DEEP, LATCHED
from dlo_ros.parameters import LimitParameters, Settings
from dlo_ros.recordings import BAG_MESSAGES, command_message, spline_message, topics
from dlo_ros.rod.loads.grip_reactions import Loading, Wrench
from dlo_ros.spline import SplineBasis

pytestmark = pytest.mark.live

N = 10
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
DOWN = [0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)]


def held_down(stamp=0, times=(0.0,), names=("start",)):
    """A clamp that holds the DLO's start downwards, at rest or moved to the right and back."""
    count = len(times)
    position = np.zeros((count, 1, 3))
    position[1::2, 0, 0] = 0.05
    rotation = np.tile(DOWN, (count, 1, 1))
    nothing = np.full((count, 1, 3), np.nan)
    return Command(stamp, names, np.array(times), position, rotation, nothing, N)


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """A simulator that runs from a hanging DLO, and a client that hears it."""
    folder = tmp_path_factory.mktemp("loads")
    params = folder / "params.yaml"
    ROD.dump(params)
    domain = free_domain()
    node = Process(
        folder, "simulator", "--ros-args", "--params-file", str(params), domain=domain
    )  # fmt: skip
    client = Client(domain)
    try:
        client.wait_for_ready("simulator")
        for topic in (*topics.LOADS, topics.PREDICTED):
            client.hear(topic, 100)
        command = client.publisher(topics.COMMAND, LATCHED)
        observed = client.publisher(topics.OBSERVED)
        command.publish(to_ros(command_message(BAG_MESSAGES, held_down())))
        shape = np.zeros((N, 4))
        shape[:, 2] = -SplineBasis(N, ROD.rod.length).greville

        def predicted():
            stamp = time.time_ns()
            observed.publish(to_ros(spline_message(BAG_MESSAGES, stamp, "board", shape)))
            client.spin(0.2)
            return client.heard[f"/{topics.PREDICTED}"]

        client.until(predicted, what="predictions")
        yield client
        assert node.interrupt() == 0, node.said
    finally:
        client.close()
        node.process.kill()


def statuses(client):
    heard = client.hear("/diagnostics", kind="diagnostic_msgs/msg/DiagnosticArray")
    return [s for m in heard for s in m.status if s.name.startswith("simulator:")]


def test_forces_come_with_predictions_and_limits_raise_the_alarm(graph):
    forces = graph.hear(topics.FORCE_START)
    graph.until(lambda: len(forces) >= 20, what="forces")
    last = forces[-1]
    assert last.header.frame_id == "board"
    shapes = graph.hear(topics.PREDICTED)
    graph.until(lambda: any(m.header.stamp == last.header.stamp for m in shapes), what="its shape")
    assert last.wrench.force.z == pytest.approx(WEIGHT, rel=1e-3)
    assert graph.hear(topics.TENSION)[-1].data == pytest.approx(WEIGHT, rel=1e-3)
    assert np.isfinite(graph.hear(topics.MIN_BEND_RADIUS)[-1].data)
    assert graph.hear(topics.FORCE_END) == []
    assert graph.set("simulator", limits__tension=-1.0).successful is False
    assert graph.set("simulator", limits__tension=0.5 * WEIGHT).successful

    def alarm():
        return [s for s in statuses(graph) if s.level == DiagnosticStatus.ERROR]

    graph.until(alarm, what="the alarm")
    assert "is beyond limits.tension" in alarm()[-1].message
    assert graph.set("simulator", limits__tension=LimitParameters().tension).successful
    graph.until(lambda: statuses(graph)[-1].level == DiagnosticStatus.OK, what="all is well")


def test_a_motion_is_tried_while_the_simulation_runs(graph):
    shapes = graph.hear(topics.REHEARSAL, DEEP)
    predicted = graph.hear(topics.PREDICTED)
    ask = graph.publisher(topics.REHEARSAL_COMMAND)
    begin = len(predicted)
    ask.publish(to_ros(command_message(BAG_MESSAGES, held_down(0, (0.0, 1.0, 2.0)))))
    asked = time.time_ns()
    graph.until(lambda: len(shapes) >= 101, what="the rehearsal")
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in shapes])
    assert abs(stamps[0] - asked) < 10**9  # zero means the moment of receipt
    assert len(stamps) == 101 and np.diff(stamps) == pytest.approx(2e7, abs=2.0)
    tips = np.array([m.poses[0].position.x for m in shapes])
    assert tips[50] == pytest.approx(0.05, abs=2e-3) and abs(tips[-1]) < 2e-3
    # Meanwhile the simulation has gone on, at its rate and under its own command.
    graph.spin(0.5)
    times = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in predicted[begin:]]
    assert np.diff(times) == pytest.approx(0.02, abs=1e-6)
    assert all(abs(m.poses[0].position.x) < 1e-6 for m in predicted)

    def told():
        return {v.key: v.value for s in statuses(graph)[-1:] for v in s.values}

    graph.until(lambda: told().get("rehearsals") == "1", what="the diagnostics")
    values = told()
    assert float(values["rehearsal tension [N]"]) > WEIGHT
    assert float(values["rehearsal force start [N]"]) > WEIGHT
    assert float(values["rehearsal bend radius [m]"]) < 4.0
    assert values["rehearsal band [mm]"] == "-"  # no standard deviation is stated

    # What is malformed is refused whole, and said.
    ask.publish(to_ros(command_message(BAG_MESSAGES, held_down(names=("start",)))))
    graph.until(lambda: len(shapes) >= 102, what="the shape at rest")
    wrong = to_ros(command_message(BAG_MESSAGES, held_down()))
    wrong.joint_names = ["middle"]
    ask.publish(wrong)
    graph.until(
        lambda: any("dlo/rehearsal_command names 'middle'" in s.message for s in statuses(graph)),
        what="the refusal",
    )
    graph.spin(0.3)
    assert len(shapes) == 102

    # One that should have begun some time ago is tried whole, with stamps as commanded.
    begun = time.time_ns() - 10**9
    ask.publish(to_ros(command_message(BAG_MESSAGES, held_down(begun, (0.0, 0.2, 0.4)))))
    graph.until(lambda: len(shapes) >= 123, what="the late motion")
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in shapes[102:]]
    assert stamps == [begun + k * 20_000_000 for k in range(21)]


def test_forces_that_are_not_finite_are_said_and_not_sent():
    sent, said = [], []
    publisher = SimpleNamespace(publish=sent.append)
    health = SimpleNamespace(values={}, warn=lambda kind, text: said.append(text))
    node = SimpleNamespace(settings=ROD, health=health, publisher=lambda *_: publisher)
    loads = LoadPublisher(node)
    loads.publish(1, Loading(None, None, float("nan"), 0.0, 1.0, 0.0))
    assert sent == [] and "not finite" in said[0]
    wrench = Wrench(np.zeros(3), np.full(3, np.inf))
    loads.publish(1, Loading(wrench, None, 1.0, 0.0, 1.0, 0.0))
    assert sent == [] and len(said) == 2
    loads.publish(1, Loading(None, None, 1.0, 0.0, 1.0, 0.0))
    assert len(sent) == 2 and len(said) == 2
