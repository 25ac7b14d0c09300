# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A listener that records what the three nodes publish, for the demo."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError
from dlo_ros.file_parameter import NODES
from dlo_ros.nodes.message_factory import message_class
from dlo_ros.nodes.qos import LATCHED, RELIABLE
from dlo_ros.nodes.received_data import ReceivedData
from dlo_ros.nodes.runtime import ros
from dlo_ros.parameters import Settings
from dlo_ros.recordings import read_spline, topics
from dlo_ros.recordings.messages import stamp_of

SIMULATOR = "simulator"
CHANGES = 100
"""Changes of parameters that may wait to be heard."""


@contextmanager
def monitoring(settings: Settings) -> Iterator[OutputMonitor]:
    """A monitor while the block runs, ROS started and shut down around it."""
    with ros([]):
        monitor = OutputMonitor(settings)
        try:
            yield monitor
        finally:
            monitor.close()


class OutputMonitor(Node):
    """Receives splines, ERR, estimates and diagnostics.

    Args:
        settings: settings of the nodes, which the splines must fit.
    """

    def __init__(self, settings: Settings) -> None:
        use_sim_time = Parameter("use_sim_time", Parameter.Type.BOOL, True)
        super().__init__("demo_monitor", parameter_overrides=[use_sim_time])
        self.received = ReceivedData()
        self._young_modulus, self._density = settings.rod.young_modulus, settings.rod.density
        self._simulates(0)
        self.messages = 0
        self._executor = SingleThreadedExecutor()
        self._settings = settings
        self._states: dict[str, str] = {}
        self._kinds: set[str] = set()
        self._hear(topics.OBSERVED, lambda m: self._spline(topics.OBSERVED, m))
        self._hear(topics.PREDICTED, lambda m: self._spline(topics.PREDICTED, m))
        self._hear(topics.ERR, lambda m: self.received.err.append((self.received.now, m.data)))
        self._hear(topics.YOUNG_MODULUS, lambda m: self.received.take_estimate(m.data, None))
        self._hear(topics.DENSITY, lambda m: self.received.take_estimate(None, m.data))
        self.create_subscription(DiagnosticArray, "/diagnostics", self._diagnostics, 10)
        self.create_subscription(ParameterEvent, "/parameter_events", self._changed, CHANGES)
        self._executor.add_node(self)

    def begin_again(self) -> None:
        """Forget what was received, before the recording is played again."""
        self.received = ReceivedData(passes=self.received.passes + 1)
        self._simulates(0)
        self._kinds.clear()

    def listen(self, seconds: float) -> None:
        """Process at most one message, waiting for it up to the given time."""
        self._executor.spin_once(timeout_sec=seconds)

    def missing(self) -> list[str]:
        """Nodes without a status so far, or whose topics are not there yet."""
        present = set(self.get_node_names())
        expected = {
            "observer": (topics.OBSERVED,),
            "simulator": (topics.PREDICTED,),
            "identifier": (topics.ERR, topics.YOUNG_MODULUS, topics.DENSITY),
        }
        return [
            name
            for name, published in expected.items()
            if name not in present
            or name not in self._states
            or not all(self.count_publishers(topic) for topic in published)
        ]

    def close(self) -> None:
        """Leave the graph."""
        self._executor.remove_node(self)
        self._executor.shutdown(timeout_sec=1.0)
        self.destroy_node()

    def state(self, name: str) -> str:
        """The last status of a node."""
        return self._states.get(name, "it has no status yet")

    def _hear(self, topic: str, callback: Any) -> None:
        def receive(message: Any) -> None:
            self.messages += 1
            self.received.tick(int(self.get_clock().now().nanoseconds))
            callback(message)

        qos = LATCHED if topic in topics.LATCHED else RELIABLE
        self.create_subscription(message_class(topics.TYPES[topic]), topic, receive, qos)

    def _spline(self, topic: str, message: Any) -> None:
        kept = self.received.observed if topic == topics.OBSERVED else self.received.predicted
        if topic == topics.PREDICTED and not kept:
            # What was amiss while nothing had been played yet is over, or is reported again.
            self.received.warnings.clear()
            self._kinds.clear()
        try:
            kept[stamp_of(message)] = read_spline(message, self._settings, topic)
        except InputError as err:
            self.get_logger().warning(str(err), throttle_duration_sec=5.0)

    def _simulates(self, stamp: int) -> None:
        """Record E/mu of the simulator from a stamp [ns] on."""
        self.received.simulated.append((stamp, self._young_modulus / self._density))

    def _changed(self, event: Any) -> None:
        """Take what a node says of its changed parameters."""
        if event.node.rpartition("/")[2] != SIMULATOR:
            return
        changed = {p.name: p.value.double_value for p in event.changed_parameters}
        self._young_modulus = changed.get("rod.young_modulus", self._young_modulus)
        self._density = changed.get("rod.density", self._density)
        self._simulates(event.stamp.sec * NANOSECONDS + event.stamp.nanosec)

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.partition(":")[0].rpartition("/")[2]
            if name not in NODES:
                continue
            self._states[name] = status.message
            if status.level not in (DiagnosticStatus.OK, DiagnosticStatus.STALE):
                self._warn(f"{name}: {status.message}")
            if name == "identifier":
                self.received.take_diagnostics({v.key: v.value for v in status.values})

    def _warn(self, text: str) -> None:
        """Record a warning, once for all numbers that it may show; waiting is no fault."""
        if ": waiting for " in text:
            return
        kind = re.sub(r"[\d.]+", "#", text)
        if kind not in self._kinds:
            self._kinds.add(kind)
            self.received.warnings.append(text)
