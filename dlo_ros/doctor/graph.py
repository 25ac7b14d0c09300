# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Observations of the ROS graph over a few seconds, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Value = float | int | str | bool | None

WATCHED = ("use_sim_time", "frame_id", "rod.length", "rod.diameter", "rod.control_points")
"""Parameters that must be the same in all nodes of one DLO."""


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription.

    Args:
        node: full name of its node.
        kind: type of its messages.
        publishes: whether it is a publisher.
        reliable: reliability, otherwise best effort.
        latched: durability transient local, otherwise volatile.
    """

    node: str
    kind: str
    publishes: bool
    reliable: bool = True
    latched: bool = False


@dataclass(frozen=True)
class NodeState:
    """One of the package's nodes.

    Args:
        name: full name.
        ready: whether it says that it takes data; None where it has not said.
        level: level of the node's last status on /diagnostics: 0 OK, 1 WARN, 2 ERROR, 3 STALE;
            None: no status.
        message: message of that status.
        parameters: values of `WATCHED`; those that it does not declare, or that it did not answer
            in time, are left out.
    """

    name: str
    ready: bool | None = None
    level: int | None = None
    message: str = ""
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def namespace(self) -> str:
        """Namespace of the node, without a slash at its end."""
        return self.name.rpartition("/")[0]


@dataclass(frozen=True)
class Header:
    """The last message of a topic.

    Args:
        frame: the message's `frame_id`.
        stamp: the message's stamp [s].
        clock: the time when it came [s], of /clock where that is heard, else of the system.
        poses: number of its poses; None where it holds none.
    """

    frame: str
    stamp: float
    clock: float
    poses: int | None = None


@dataclass(frozen=True)
class Graph:
    """All that was seen.

    Args:
        middleware: name of the ROS middleware.
        seconds: time for which the graph was watched [s].
        topics: endpoints of each topic that is of the interface, or of one of the package's nodes.
        images: full names and types of all topics with camera images.
        nodes: the package's nodes.
        clock: first and last time on each clock topic that was heard [s].
        headers: last headers by the full name of their topic.
        frames: all frames of /tf and /tf_static.
    """

    middleware: str
    seconds: float
    topics: Mapping[str, tuple[Endpoint, ...]] = field(default_factory=dict)
    images: Mapping[str, str] = field(default_factory=dict)
    nodes: tuple[NodeState, ...] = ()
    clock: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    headers: Mapping[str, Header] = field(default_factory=dict)
    frames: frozenset[str] = frozenset()

    def publishers(self, topic: str) -> list[Endpoint]:
        """Publishers of a topic."""
        return [e for e in self.topics.get(topic, ()) if e.publishes]

    def subscriptions(self, topic: str) -> list[Endpoint]:
        """Subscriptions to a topic."""
        return [e for e in self.topics.get(topic, ()) if not e.publishes]
