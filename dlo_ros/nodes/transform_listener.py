# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Listener to the transforms of a running system, /tf and /tf_static."""

from __future__ import annotations

from typing import Any

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

from dlo_ros.command import NANOSECONDS
from dlo_ros.nodes import qos
from dlo_ros.nodes.message_factory import installed
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.transforms import Transforms

KEPT = 10 * NANOSECONDS
"""Nanoseconds for which poses are remembered, as tf2 does."""

DEPTH = 100
"""Messages that may wait: robots publish each of their joints."""


class TransformListener:
    """Poses of frames from received transforms.

    Args:
        node: node that subscribes; it warns where tf2_msgs is missing.
    """

    def __init__(self, node: DloNode) -> None:
        self.transforms = Transforms()
        self._node = node
        self.available = installed(topics.TRANSFORMS_TYPE)
        if not self.available:
            return
        moving = QoSProfile(
            history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE
        )
        kind = topics.TRANSFORMS_TYPE
        node.subscribe(topics.TRANSFORMS, self._on_fixed, qos.FIXED_TRANSFORMS, kind)
        node.subscribe(topics.MOVING_TRANSFORMS, self._on_moving, moving, kind, drain=True)

    def _on_fixed(self, message: Any) -> None:
        self.take(message, fixed=True)

    def _on_moving(self, message: Any) -> None:
        self.take(message, fixed=False)

    def take(self, message: Any, *, fixed: bool) -> None:
        """Take a tf2_msgs/TFMessage."""
        try:
            self.transforms.add(message, fixed=fixed)
        finally:
            now = self._node.now()
            if now:
                self.transforms.forget(now - KEPT)
