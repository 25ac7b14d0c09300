# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Subscribers of the topics that a player publishes, and whether the nodes among them are ready.

A node of this package publishes on its latched topic `~/ready` whether it takes data: its
subscriptions exist some seconds after its start, while it may compile for minutes.
"""

from __future__ import annotations

import time
from collections.abc import Collection
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from std_msgs.msg import Bool

from dlo_ros.nodes.qos import LATCHED, RELIABLE

READY = "/ready"
READY_TYPE = "std_msgs/msg/Bool"

GRAPH_PERIOD = 0.2
"""Seconds between two looks at the graph; each asks for the endpoints of all topics."""


class Listeners:
    """Nodes that subscribe to some topics, and their readiness.

    Args:
        node: the player, whose callbacks are run by `update` alone.
        topics: full names of the topics that are played.
        awaited: names of nodes that must be there, relative to the player's namespace.
    """

    def __init__(self, node: Node, topics: Collection[str], awaited: Collection[str] = ()) -> None:
        self._node = node
        self._topics = tuple(topics)
        here = node.get_namespace().rstrip("/")
        self._awaited = [n if n.startswith("/") else f"{here}/{n}" for n in awaited]
        self._listening: set[str] = set()
        self._ready: dict[str, bool | None] = {}  # None: it has not said
        self._said: dict[str, str] = {}
        self._subscriptions: dict[str, Any] = {}
        self._looked = -GRAPH_PERIOD
        self._diagnostics = node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def update(self, seconds: float) -> None:
        """Process messages on readiness, waiting up to the given time [s]."""
        now = time.monotonic()
        if now - self._looked >= GRAPH_PERIOD:
            self._looked = now
            self._look()
        self._executor.spin_once(timeout_sec=seconds)

    def pending(self) -> dict[str, str]:
        """The nodes that are waited for: name and what each is doing."""
        known = [name for name in self._ready if name in self._listening]
        wanted = dict.fromkeys([*self._awaited, *known])
        return {name: self._state(name) for name in wanted if not self._ready.get(name)}

    def close(self) -> None:
        """Forget all."""
        self._executor.remove_node(self._node)
        self._executor.shutdown(timeout_sec=1.0)
        for subscription in (self._diagnostics, *self._subscriptions.values()):
            self._node.destroy_subscription(subscription)

    def _state(self, name: str) -> str:
        if name not in self._ready:
            return "not there yet"
        return self._said.get(name, "starting")

    def _look(self) -> None:
        """Find who listens, and the topics on which nodes say whether they are ready."""
        self._listening = {
            full_name(info)
            for topic in self._topics
            for info in self._node.get_subscriptions_info_by_topic(topic)
        }
        there = set()
        for topic, kinds in self._node.get_topic_names_and_types():
            if topic.endswith(READY) and READY_TYPE in kinds and self._tells(topic):
                there.add(topic.removesuffix(READY))
        for gone in set(self._ready) - there:
            del self._ready[gone]
            self._said.pop(gone, None)
            self._node.destroy_subscription(self._subscriptions.pop(gone))
        for name in there - set(self._ready):
            self._ready[name] = None
            self._subscriptions[name] = self._node.create_subscription(
                Bool,
                f"{name}{READY}",
                lambda message, name=name: self._hear(name, message),
                LATCHED,
            )

    def _tells(self, topic: str) -> bool:
        """Whether the node that the topic is named after publishes it, latched."""
        return any(
            full_name(info) == topic.removesuffix(READY)
            and info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            for info in self._node.get_publishers_info_by_topic(topic)
        )

    def _hear(self, name: str, message: Bool) -> None:
        if name in self._ready:
            self._ready[name] = bool(message.data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._said["/" + status.name.partition(":")[0].lstrip("/")] = status.message


def full_name(info: Any) -> str:
    """Full name of the node that an endpoint belongs to."""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"
