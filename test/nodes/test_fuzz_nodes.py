# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fuzzing of every subscription, service and parameter of the nodes (hypothesis).

`make fuzz` sends 100,000 messages, the ordinary tests 2,000. The nodes live on from one example to
the next, as they do beside a robot, so that defects are collected and examples not shrunk.
"""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from typing import Any

import pytest

pytest.importorskip("rclpy")

import hypothesis
from builtin_interfaces.msg import Time
from fuzz_graph import BEGIN, Graph, resident
from hostile import BITS, FLOATS, STRINGS, bounds, spoiled
from hypothesis import HealthCheck, Phase, given
from hypothesis import strategies as st
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rosgraph_msgs.msg import Clock

from dlo_ros.command import NANOSECONDS
from dlo_ros.parameter_table import PARAMETERS
from dlo_ros.recordings import topics

pytestmark = pytest.mark.live

SEED = int(os.environ.get("DLO_FUZZ_SEED", "1"))
MESSAGES = int(os.environ.get("DLO_FUZZ_MESSAGES", "2000"))
PORTION = 2000
BURST = 20
GROWTH = 250 * 2**20
"""Bytes that the process may grow by after the first tenth: some messages are a million numbers."""

KINDS = (
    "clock", "clock", "clock", "command", "command", "wild", "rehearsal", "tried",
    "spline", "spline", "spline", "predicted", "predicted", "points", "points", "image",
    "compressed", "camera_info", "mask", "service", "parameters", "parameters", "time",
)  # fmt: skip
NAMES = (
    *(p.name for p in PARAMETERS),
    "effects.point_mass.mass",
    "effects.ghost.x",
    "use_sim_time",
)


def deliver(draw: Any, graph: Graph) -> str:
    """Send the graph one message, request or time; returns the topic or service."""
    kind = draw(st.sampled_from(KINDS))
    if kind == "clock":
        graph.tick(graph.now + 20_000_000 * draw(st.integers(1, 3)))
        graph.spin(4)
        return "/clock"
    if kind == "time":
        return jump(draw, graph) if draw(st.integers(0, 5)) == 0 else deliver(draw, graph)
    if kind == "service":
        return call(draw, graph)
    if kind == "parameters":
        return set_parameters(draw, graph)
    most, variant = draw(st.sampled_from((0, 1, 3))), draw(st.integers(0, 2))
    late = draw(st.sampled_from((0, 0, 0, 0, 20_000_000, -20_000_000, -(10**9), 10**9, 10**11)))
    good, stamp = graph.good, max(graph.now + late, 0)
    topic, message = {
        "command": lambda: (topics.COMMAND, good.command(stamp, variant)),
        "wild": lambda: (topics.COMMAND, wild(draw, good.command(stamp, 1))),
        "rehearsal": lambda: (topics.REHEARSAL_COMMAND, good.command(stamp, variant)),
        "tried": lambda: (topics.REHEARSAL_COMMAND, wild(draw, good.command(stamp, 1))),
        "spline": lambda: (topics.OBSERVED, good.spline(stamp, 0.002 * variant)),
        "predicted": lambda: (topics.PREDICTED, good.spline(stamp, 0.001 * variant)),
        "points": lambda: (topics.OBSERVED_POINTS, good.points(stamp)),
        "image": lambda: (topics.IMAGE, good.image(stamp)),
        "compressed": lambda: (
            topics.COMPRESSED, good.compressed(stamp, "png" if variant == 1 else "jpeg")
        ),
        "camera_info": lambda: (topics.CAMERA_INFO, good.camera_info(stamp)),
        "mask": lambda: (topics.MASK, good.mask(stamp)),
    }[kind]()  # fmt: skip
    graph.send(topic, spoiled(draw, message, most))
    return topic


def wild(draw: Any, message: Any) -> Any:
    """A command that is well-formed and senseless: clamps that fly about, at any speed."""
    reach = st.floats(-0.5, 0.5)
    step = draw(st.sampled_from((1, 1000, 10**6, 10**8, 10**9)))
    for i, point in enumerate(message.points):
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(i * step, NANOSECONDS)
        for transform in point.transforms:
            place = transform.translation
            place.x, place.z = draw(reach), draw(reach)
            place.y = draw(st.sampled_from((0.0, 0.0, 0.0, 0.1)))
            angle = draw(st.floats(-3.2, 3.2))
            turned = transform.rotation
            turned.y, turned.w = math.sin(angle / 2.0), math.cos(angle / 2.0)
    return message


def jump(draw: Any, graph: Graph) -> str:
    """Time jumps, or a message on /clock makes no sense; then it goes on where it was."""
    second = draw(st.sampled_from((0, 0, 1, -1, 3600, -3600, -(2**31), 2**31 - 1)))
    nanosecond = draw(st.sampled_from((0, 1, 10**9 - 1, 10**9, 2**32 - 1)))
    now = graph.now // NANOSECONDS
    sec = second if abs(second) > 2**30 else now + second
    graph.clock(Clock(clock=Time(sec=sec, nanosec=nanosecond)))
    graph.spin(2)
    graph.tick(draw(st.sampled_from((graph.now, graph.now, BEGIN))))
    return "/clock"


def call(draw: Any, graph: Graph) -> str:
    """A service of a node, rclpy's own included."""
    node = graph.nodes[draw(st.sampled_from(sorted(graph.nodes)))]
    services = list(node.services)
    service = services[draw(st.integers(0, len(services) - 1))]
    graph.request(service, spoiled(draw, service.srv_type.Request()))
    return str(service.srv_name)


def set_parameters(draw: Any, graph: Graph) -> str:
    """Parameters set as `ros2 param set` does, with values of any type."""
    node = graph.nodes[draw(st.sampled_from(sorted(graph.nodes)))]
    wanted = draw(st.sampled_from(("set_parameters", "set_parameters_atomically")))
    (service,) = [s for s in node.services if s.srv_name.endswith(f"/{wanted}")]
    names = draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=3))
    values = [Parameter(name=name, value=value(draw)) for name in names]
    request = spoiled(draw, service.srv_type.Request(parameters=values), 1)
    before = node.settings
    answer = graph.request(service, request)
    if answer is not None and wanted == "set_parameters_atomically":
        changed = node.settings is not before
        assert answer.result.successful or not changed, "a refused change was made"
    return str(service.srv_name)


def value(draw: Any) -> ParameterValue:
    """A parameter's value, of one of ROS's types."""
    kind = draw(st.integers(0, 9))
    result = ParameterValue(type=kind)
    number = st.one_of(st.sampled_from(FLOATS), st.floats(), st.floats(0.1, 1e8))
    integer = st.one_of(st.sampled_from((0, 1, -1, *bounds("int64"))), st.integers(1, 10**6))
    size = st.sampled_from((0, 1, 2, 3, 4, 50, 100_000))
    if kind == ParameterType.PARAMETER_BOOL:
        result.bool_value = draw(st.booleans())
    elif kind == ParameterType.PARAMETER_INTEGER:
        result.integer_value = draw(integer)
    elif kind == ParameterType.PARAMETER_DOUBLE:
        result.double_value = draw(number)
    elif kind == ParameterType.PARAMETER_STRING:
        result.string_value = draw(st.sampled_from(STRINGS))
    elif kind == ParameterType.PARAMETER_BYTE_ARRAY:
        result.byte_array_value = [b"\1"] * draw(size)
    elif kind == ParameterType.PARAMETER_BOOL_ARRAY:
        result.bool_array_value = [True] * draw(size)
    elif kind == ParameterType.PARAMETER_INTEGER_ARRAY:
        result.integer_array_value = [draw(integer)] * draw(size)
    elif kind == ParameterType.PARAMETER_DOUBLE_ARRAY:
        result.double_array_value = [draw(number)] * draw(size)
    elif kind == ParameterType.PARAMETER_STRING_ARRAY:
        text = draw(st.sampled_from(STRINGS))
        result.string_array_value = [text] * min(draw(size), 2_000_000 // (len(text) + 1))
    return result


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("DLO_ROS_DEBUG", "")
    made = Graph(monkeypatch)
    yield made
    made.close()


@pytest.mark.slow
def test_nothing_that_arrives_brings_a_node_down(graph: Graph) -> None:
    """No defect, no number that is not finite, bounded memory; and all work goes on afterwards."""
    graph.works()
    began, memory = time.monotonic(), []
    slowest: list[Any] = [0.0, ""]
    defects: dict[str, str] = {}

    def fuzz(data: Any) -> None:
        for _ in range(BURST):
            # Of this thread: the machine may have other things to do.
            start = time.thread_time()
            what = deliver(data.draw, graph)
            took = time.thread_time() - start
            if took > slowest[0]:
                slowest[:] = [took, what]
        graph.spin()
        # Collected, since the nodes are not in the same state when hypothesis tries it again.
        for defect in graph.defects():
            defects.setdefault(defect[:60], defect)
        memory.append(resident())

    before = sum(graph.delivered.values())
    while (sent := sum(graph.delivered.values()) - before) < MESSAGES and not defects:
        # In portions, since hypothesis remembers all examples of a run.
        run = hypothesis.settings(
            max_examples=min(PORTION, MESSAGES) // BURST,
            deadline=None,
            database=None,
            phases=(Phase.generate,),
            suppress_health_check=list(HealthCheck),
        )(given(st.data())(fuzz))
        hypothesis.seed(SEED + sent)(run)()
    assert not defects, "\n".join(defects.values())
    published = Counter(graph.published)
    graph.works()
    early = max(memory[: max(len(memory) // 10, 1)])
    print(
        f"\n{sent} messages in {time.monotonic() - began:.0f} s; the slowest "
        f"{slowest[0]:.2f} s of processor ({slowest[1]}); "
        f"resident {early / 2**20:.0f} MiB after a tenth, "
        f"{max(memory) / 2**20:.0f} at most, {memory[-1] / 2**20:.0f} at the end\n"
        f"sent {dict(graph.delivered)}\npublished {dict(published)}"
    )
    assert max(memory) - early < GROWTH
    assert slowest[0] < 10.0, slowest


def test_the_generator_reaches_every_kind_of_number() -> None:
    """The table of integer bounds covers what the messages are made of."""
    assert all(low < high for low, high in map(bounds, BITS))
