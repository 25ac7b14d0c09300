# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""RViz markers of curves and control points."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from dlo_ros.nodes import qos
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import header
from dlo_ros.spline import FloatArray, SplineBasis

SAMPLES = 60
PERIOD = 0.05
"""Seconds between two markers at least; RViz draws no faster."""


class Markers:
    """Draws splines of one colour, only while there is a subscriber.

    Args:
        node: node that publishes.
        name: namespace of the markers, such as `observed`.
        colour: red, green, blue, 0 to 1.
    """

    def __init__(self, node: DloNode, name: str, colour: tuple[float, float, float]) -> None:
        self._node = node
        self._name = name
        red, green, blue = colour
        self._colour = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        rod = node.settings.rod
        basis = SplineBasis(rod.control_points, rod.length)
        self._matrix = basis.matrix(np.linspace(0.0, rod.length, SAMPLES))
        self._diameter = rod.diameter
        self._publisher = node.publisher(topics.MARKERS, qos.RELIABLE)
        self._last = 0

    def spline(self, stamp: int, control_points: FloatArray) -> None:
        """Show a spline; control points of shape (n, 3 or 4) [m]."""
        if not 0 <= stamp - self._last < PERIOD * 1e9 and self._publisher.get_subscription_count():
            self._last = stamp
            positions = control_points[:, :3]
            curve = self._marker(stamp, 0, Marker.LINE_STRIP, self._diameter)
            curve.points = _points(self._matrix @ positions)
            knots = self._marker(stamp, 1, Marker.SPHERE_LIST, 2.0 * self._diameter)
            knots.points = _points(positions)
            self._publisher.publish(MarkerArray(markers=[curve, knots]))

    def text(self, stamp: int, position: FloatArray, text: str) -> None:
        """Show a line of text at a position [m], shape (3,)."""
        if not 0 <= stamp - self._last < PERIOD * 1e9 and self._publisher.get_subscription_count():
            self._last = stamp
            marker = self._marker(
                stamp, 0, Marker.TEXT_VIEW_FACING, 0.05 * self._node.settings.rod.length
            )
            (marker.pose.position,) = _points(position[None, :3])
            marker.text = text
            self._publisher.publish(MarkerArray(markers=[marker]))

    def _marker(self, stamp: int, number: int, kind: int, size: float) -> Any:
        marker = Marker(ns=self._name, id=number, type=kind, action=Marker.ADD)
        marker.header = header(ROS_MESSAGES, stamp, self._node.settings.frame_id)
        marker.pose.orientation.w = 1.0
        marker.scale = Vector3(x=size, y=size, z=size)
        marker.color = self._colour
        return marker


def _points(positions: FloatArray) -> list[Any]:
    return [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in positions]
