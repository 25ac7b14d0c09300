# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The board's pose in the cameras as transforms on /tf_static."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.nodes import qos
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import transform_message


class BoardTransform:
    """Publishes the transforms that join the cameras' frames to `frame_id`.

    A frame has one parent: `frame_id` has the first camera's frame, and is that of the others. It
    does so where tf2_msgs is installed and the parameter `publish_tf` asks for it.

    Args:
        node: node that publishes, with its settings.
    """

    def __init__(self, node: DloNode) -> None:
        self._node = node
        self._publisher: Any = None
        self._frames: dict[str, str] = {}
        self._last: tuple[Any, ...] = ()
        if node.settings.publish_tf:
            self._publisher = node.optional_publisher(
                topics.TRANSFORMS, qos.LATCHED, topics.TRANSFORMS_TYPE
            )

    def seen_by(self, frame: str, camera: str = "") -> None:
        """Set the name of a camera's frame, as its camera_info has it.

        Args:
            frame: name of the frame.
            camera: the camera's name; empty: the one camera.
        """
        self._frames[camera] = frame
        self.update()

    def update(self) -> None:
        """Publish the transforms where they are known and have changed."""
        settings = self._node.settings
        poses = settings.camera_poses
        frames = {name: self._frames[name] for name in poses if name in self._frames}
        now = (frames, poses)
        if self._publisher is None or not frames or now == self._last:
            return
        self._last = now
        try:
            if len(set(frames.values())) < len(frames):
                raise InputError(
                    f"the cameras {', '.join(frames)} have the frames {', '.join(frames.values())}"
                    "; give each camera_info a frame of its own"
                )
            made = [self._joining(name, frame) for name, frame in frames.items()]
        except InputError as err:
            self._node.health.warn("transform", f"no transform on {topics.TRANSFORMS}: {err}")
            return
        # All in one message, since of a latched topic the last one counts.
        made[0].transforms = [one for message in made for one in message.transforms]
        self._publisher.publish(made[0])

    def _joining(self, camera: str, frame: str) -> Any:
        """The transform between a camera's frame and the board."""
        poses, board = self._node.settings.camera_poses, self._node.settings.frame_id
        pose, ends = poses[camera], (frame, board)
        place, turn = np.array(pose.translation), Rotation.from_quat(pose.rotation)
        if camera != next(iter(poses)):
            turn, ends = turn.inv(), (board, frame)
            place = -turn.apply(place)
        return transform_message(
            ROS_MESSAGES, self._node.now(), *ends, place.tolist(), turn.as_quat().tolist()
        )
