# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Results with the stamp of the shape that they belong to, and with their standard deviations."""

from __future__ import annotations

from dlo_ros.errors import InputError
from dlo_ros.identification.estimate import Estimate
from dlo_ros.inference.err import Deviation
from dlo_ros.nodes import qos
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import metric_message

ERR_UNIT = "m"
ESTIMATES = {"young_modulus": "Pa", "density": "kg/m^3", "specific_modulus": "m^2/s^2"}
"""Unit of each quantity that is estimated."""


class Metrics:
    """Publishes `dlo/metrics`, where statistics_msgs is installed.

    Args:
        node: node that publishes.
    """

    def __init__(self, node: DloNode) -> None:
        self._node = node
        self._publisher = node.optional_publisher(topics.METRICS, qos.DEEP)

    def err(self, stamp: int, apart: Deviation) -> None:
        """ERR of the shape observed at a stamp [ns], with its spread along the DLO."""
        self._publish("err", ERR_UNIT, stamp, apart.mean, apart.std, apart.maximum)

    def estimate(self, stamp: int, estimate: Estimate) -> None:
        """The estimates from the shapes up to a stamp [ns], with their standard deviations."""
        for name, unit in ESTIMATES.items():
            value, std = getattr(estimate, name), getattr(estimate, f"{name}_std")
            self._publish(name, unit, stamp, value, std)

    def _publish(
        self,
        name: str,
        unit: str,
        stamp: int,
        average: float,
        std: float | None,
        maximum: float | None = None,
    ) -> None:
        if self._publisher is None:
            return
        source = self._node.get_fully_qualified_name().lstrip("/")
        try:
            message = metric_message(
                ROS_MESSAGES, source, name, unit, stamp, average=average, std=std, maximum=maximum
            )
        except InputError as err:
            self._node.health.warn("metrics", f"{name} not published on {topics.METRICS}: {err}")
            return
        self._publisher.publish(message)
