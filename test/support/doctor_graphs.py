# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Graphs of nodes as `doctor` sees them, and what it finds wrong."""

from dataclasses import replace

from conftest import ROOT

from dlo_ros.doctor.finding import Level
from dlo_ros.doctor.graph import Endpoint, Graph, Header, NodeState
from dlo_ros.recordings import topics

POSES = topics.TYPES[topics.OBSERVED]
DEFAULT = ROOT / "config" / "default.yaml"
SHARED = {
    "use_sim_time": False,
    "frame_id": "board",
    "rod.length": 0.4,
    "rod.diameter": 0.004,
    "rod.control_points": 10,
}
NODES = tuple(
    NodeState(f"/{name}", True, 0, "works", SHARED)
    for name in ("observer", "simulator", "identifier")
)
HEALTHY = Graph(
    "rmw_fastrtps_cpp",
    5.0,
    {
        "/dlo/observed": (
            Endpoint("/observer", POSES, True),
            Endpoint("/simulator", POSES, False),
            Endpoint("/identifier", POSES, False),
        ),
        "/dlo/command": (
            Endpoint("/robot", topics.TYPES[topics.COMMAND], True, latched=True),
            Endpoint("/simulator", topics.TYPES[topics.COMMAND], False, latched=True),
        ),
    },
    nodes=NODES,
    headers={
        "/dlo/observed": Header("board", 999.9, 1000.0, 10),
        "/dlo/command": Header("board", 10.0, 1000.0),
    },
    frames=frozenset({"camera", "board"}),
)


def bad(findings, level=Level.WRONG):
    return [f for f in findings if f.level == level]


def one(findings, *words, level=Level.WRONG):
    """The one bad finding, whose text and remedy hold the words."""
    (found,) = bad(findings, level)
    for word in words:
        assert word in f"{found.text} -> {found.remedy}"
    assert found.remedy
    return found


def with_topic(name, *ends, **more):
    return replace(HEALTHY, topics={**HEALTHY.topics, name: ends}, **more)


def simulated(*, follow=True, **more):
    states = [replace(n, parameters=SHARED | {"use_sim_time": follow}) for n in NODES]
    return replace(HEALTHY, nodes=tuple(states), headers={}, **more)
