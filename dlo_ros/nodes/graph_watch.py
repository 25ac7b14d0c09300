# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Observation of the ROS graph for a few seconds, without publishing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from dlo_ros.command import NANOSECONDS
from dlo_ros.doctor.graph import WATCHED, Endpoint, Graph, Header, NodeState
from dlo_ros.nodes import qos
from dlo_ros.nodes.listeners import READY, READY_TYPE, full_name
from dlo_ros.nodes.message_factory import installed, message_class
from dlo_ros.nodes.runtime import ros
from dlo_ros.recordings import topics

NAME = "_dlo_doctor"
"""The underscore hides it from `ros2 node list`."""

GRAPH_PERIOD = 0.3
"""Seconds between two looks at who is there."""

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
TRANSFORMS = {topics.MOVING_TRANSFORMS: qos.SENSOR, topics.TRANSFORMS: qos.LATCHED}
HEADER_TOPICS = (
    topics.OBSERVED,
    topics.OBSERVED_POINTS,
    topics.PREDICTED,
    topics.CAMERA_INFO,
    topics.COMMAND,
)
"""Topics whose headers are read; images are left to those who need them."""


@dataclass
class Arrival:
    """The last message of a topic: its header, and the times when it came."""

    frame: str
    stamp: float
    poses: int | None
    system: float
    ticks: dict[str, float]


class GraphWatch:
    """Collects topics, endpoints, nodes and messages of the graph.

    Args:
        node: node that subscribes to the graph's topics; it publishes nothing.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._own = node.get_fully_qualified_name()
        self._topics: dict[str, tuple[Endpoint, ...]] = {}
        self._images: dict[str, str] = {}
        self._ready: dict[str, bool | None] = {}
        self._said: dict[str, tuple[int | None, str]] = {}
        self._parameters: dict[str, dict[str, Any]] = {}
        self._clock: dict[str, tuple[float, float]] = {}
        self._arrivals: dict[str, Arrival] = {}
        self._frames: set[str] = set()
        self._subscribed: set[str] = set()
        self._asked: dict[str, Any] = {}
        self._subscribe("/diagnostics", DiagnosticArray, self._on_diagnostics, qos.RELIABLE)

    def look(self) -> None:
        """Find topics, endpoints and nodes, and subscribe to what is new."""
        found: dict[str, tuple[Endpoint, ...]] = {}
        for name, kinds in self._node.get_topic_names_and_types():
            if set(kinds) & set(topics.IMAGE_TYPES) and self._node.count_publishers(name):
                self._images[name] = kinds[0]
            if name.endswith(READY) and READY_TYPE in kinds:
                self._look_at_node(name.removesuffix(READY))
            if CLOCK_TYPE in kinds:
                self._hear(name, CLOCK_TYPE, self._on_clock, qos.SENSOR)
            if name in TRANSFORMS:
                self._hear(name, topics.TRANSFORMS_TYPE, self._on_transforms, TRANSFORMS[name])
            if topics.relative(name) or CLOCK_TYPE in kinds:
                found[name] = self._endpoints(name)
        for name in self._topics_of_nodes() - set(found):
            found[name] = self._endpoints(name)
        for name, ends in found.items():
            own = topics.relative(name)
            if own in HEADER_TOPICS and any(
                e.publishes and e.kind == topics.TYPES[own] for e in ends
            ):
                latched = own == topics.COMMAND and all(e.latched for e in ends if e.publishes)
                profile = qos.LATCHED if latched else qos.SENSOR
                self._hear(name, topics.TYPES[own], self._on_header, profile)
        self._topics = found

    def graph(self, middleware: str, seconds: float) -> Graph:
        """All observations so far.

        Args:
            middleware: name of the ROS middleware.
            seconds: time for which the graph was watched [s].
        """
        nodes = []
        for name, ready in self._ready.items():
            level, message = self._said.get(name, (None, ""))
            parameters = self._parameters.get(name, {})
            nodes.append(NodeState(name, ready, level, message, parameters))
        headers = {
            name: Header(a.frame, a.stamp, self._clock_of(name, a), a.poses)
            for name, a in self._arrivals.items()
        }
        return Graph(
            middleware, seconds, self._topics, self._images, tuple(nodes), self._clock, headers,
            frozenset(self._frames),
        )  # fmt: skip

    def _look_at_node(self, name: str) -> None:
        topic = f"{name}{READY}"
        if not any(e.node == name and e.publishes and e.latched for e in self._endpoints(topic)):
            return
        if name not in self._ready:
            self._ready[name] = None
            client = self._node.create_client(GetParameters, f"{name}/get_parameters")
            self._asked[name] = client
            self._hear(topic, READY_TYPE, self._on_ready, qos.LATCHED)
        client = self._asked.get(name)
        if client is not None and client.service_is_ready():
            self._asked[name] = None
            client.call_async(GetParameters.Request(names=list(WATCHED))).add_done_callback(
                lambda future: self._on_parameters(name, future)
            )

    def _topics_of_nodes(self) -> set[str]:
        """Topics of the package's nodes, but for those that every node has, and for replies."""
        found = set()
        for name in self._ready:
            namespace, _, base = name.rpartition("/")
            for ask in (
                self._node.get_publisher_names_and_types_by_node,
                self._node.get_subscriber_names_and_types_by_node,
            ):
                try:
                    found |= {topic for topic, _ in ask(base, namespace or "/")}
                except RuntimeError:  # it has just ended
                    continue
        return {t for t in found if t not in ("/rosout", "/parameter_events", "/diagnostics")}

    def _endpoints(self, topic: str) -> tuple[Endpoint, ...]:
        ends = [
            (info, publishes)
            for publishes, ask in (
                (True, self._node.get_publishers_info_by_topic),
                (False, self._node.get_subscriptions_info_by_topic),
            )
            for info in ask(topic)
        ]
        return tuple(
            Endpoint(
                full_name(info),
                str(info.topic_type),
                publishes,
                info.qos_profile.reliability == ReliabilityPolicy.RELIABLE,
                info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
            )
            for info, publishes in ends
            if full_name(info) != self._own
        )

    def _hear(
        self, topic: str, kind: str, take: Callable[[str, Any], None], profile: QoSProfile
    ) -> None:
        if topic not in self._subscribed and installed(kind):
            self._subscribe(topic, message_class(kind), lambda m: take(topic, m), profile)

    def _subscribe(
        self, topic: str, kind: Any, take: Callable[[Any], None], profile: QoSProfile
    ) -> None:
        self._subscribed.add(topic)
        self._node.create_subscription(kind, topic, take, profile)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            name = "/" + status.name.partition(":")[0].lstrip("/")
            self._said[name] = (int.from_bytes(status.level, "little"), status.message)

    def _on_ready(self, topic: str, message: Any) -> None:
        self._ready[topic.removesuffix(READY)] = bool(message.data)

    def _on_parameters(self, name: str, future: Any) -> None:
        answer = future.result()
        values = [] if answer is None else [parameter_value_to_python(v) for v in answer.values]
        known = zip(WATCHED, values, strict=False)
        self._parameters[name] = {key: value for key, value in known if value is not None}

    def _on_clock(self, topic: str, message: Any) -> None:
        now = seconds_of(message.clock)
        self._clock[topic] = (self._clock.get(topic, (now, now))[0], now)

    def _on_transforms(self, _: str, message: Any) -> None:
        for transform in message.transforms:
            self._frames |= {transform.header.frame_id, transform.child_frame_id}

    def _on_header(self, topic: str, message: Any) -> None:
        poses = len(message.poses) if hasattr(message, "poses") else None
        ticks = {clock: last for clock, (_, last) in self._clock.items()}
        header = message.header
        self._arrivals[topic] = Arrival(
            header.frame_id, seconds_of(header.stamp), poses, time.time(), ticks
        )

    def _clock_of(self, topic: str, arrival: Arrival) -> float:
        """Time of arrival: of the nearest /clock at or above the topic's namespace, or the system.

        What came before the first tick counts as having come with it.
        """
        above = [c for c in self._clock if topic.startswith(c.rpartition("/")[0] + "/")]
        if not above:
            return arrival.system
        clock = max(above, key=len)
        return arrival.ticks.get(clock, self._clock[clock][0])


def seconds_of(stamp: Any) -> float:
    """A builtin_interfaces/Time in seconds."""
    return float(stamp.sec + stamp.nanosec / NANOSECONDS)


def watch(seconds: float) -> Graph:
    """Look at the graph for a while.

    Args:
        seconds: time for which the graph is watched [s].
    """
    with ros([]):
        node = Node(NAME, enable_rosout=False, start_parameter_services=False)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            view = GraphWatch(node)
            end = time.monotonic() + seconds
            looked = -GRAPH_PERIOD
            while (now := time.monotonic()) < end:
                if now - looked >= GRAPH_PERIOD:
                    looked = now
                    view.look()
                executor.spin_once(timeout_sec=min(0.05, end - now))
            view.look()
            return view.graph(rclpy.get_rmw_implementation_identifier(), seconds)
        finally:
            executor.shutdown(timeout_sec=1.0)
            node.destroy_node()
