# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The board's pose in the camera as a transform on /tf_static."""

from __future__ import annotations

from typing import Any

from dlo_ros.errors import InputError
from dlo_ros.nodes import qos
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import transform_message


class BoardTransform:
    """Publishes the transform from the camera's frame to `frame_id`.

    It does so where tf2_msgs is installed and the parameter `publish_tf` asks for it.

    Args:
        node: node that publishes, with its settings.
    """

    def __init__(self, node: DloNode) -> None:
        self._node = node
        self._publisher: Any = None
        self._frame: str | None = None
        self._last: tuple[Any, ...] = ()
        if node.settings.publish_tf:
            self._publisher = node.optional_publisher(
                topics.TRANSFORMS, qos.LATCHED, topics.TRANSFORMS_TYPE
            )

    def seen_by(self, frame: str) -> None:
        """Set the name of the camera's frame, as camera_info has it."""
        self._frame = frame
        self.update()

    def update(self) -> None:
        """Publish the transform where it is known and has changed."""
        settings = self._node.settings
        now = (self._frame, settings.camera)
        if self._publisher is None or self._frame is None or now == self._last:
            return
        self._last = now
        pose = settings.camera
        try:
            message = transform_message(
                ROS_MESSAGES, self._node.now(), self._frame, settings.frame_id,
                pose.translation, pose.rotation,
            )  # fmt: skip
        except InputError as err:
            self._node.health.warn("transform", f"no transform on {topics.TRANSFORMS}: {err}")
            return
        self._publisher.publish(message)
