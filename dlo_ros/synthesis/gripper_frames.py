# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The imposed motion as a robot publishes it: grippers as frames in `/tf` and as poses."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.frame_commands import CLOSEST, POSES, clamp_frames
from dlo_ros.recordings.message_building import BAG_MESSAGES, transform_message
from dlo_ros.recordings.write import BagWriter

PERIOD = NANOSECONDS // 100
"""Time between two poses of a gripper [ns]: robot drivers publish joints at 100 Hz or more."""

MARGIN = NANOSECONDS // 10
"""Time for which the grippers' poses are written before the first image and after the last [ns]."""


def check_frames(settings: Settings, command: Command, where: str) -> None:
    """Refuse frames that cannot express an experiment's motion.

    Args:
        settings: the true parameters.
        command: the imposed motion.
        where: name of the experiment file, for messages.

    Raises:
        InputError: a frame belongs to no grip, or a grip has no frame.
    """
    source = settings.command.source
    if source == "topic":
        return
    framed, held = set(clamp_frames(settings)), set(command.names)
    if not held <= framed or (source == "tf" and framed != held):
        raise InputError(
            f"{where}: command.source is '{source}' with frames for {_list(framed)}, but motion "
            f"moves {_list(held)}; name command.start_frame and command.end_frame for what is moved"
        )


def write_frames(writer: BagWriter, settings: Settings, command: Command, until: int) -> None:
    """Write the grippers' poses in the board frame, to `/tf` and as geometry_msgs/PoseStamped.

    The poses stand at every `PERIOD` and at the command's own points, so that interpolation between
    them gives the command again. Both transports say the same: a Python without a full ROS has no
    type support for the messages of /tf. With `command.source: pose` no frame has a name, and
    nothing is written to /tf.

    Args:
        writer: an open writer.
        settings: settings that name the frames and the clamps' offsets in them.
        command: command of the clamps.
        until: stamp of the last image [ns].
    """
    own = command.stamp + np.rint(command.times * NANOSECONDS).astype(np.int64)
    grid = np.arange(command.stamp - MARGIN, until + MARGIN + 1, PERIOD, dtype=np.int64)
    stamps = np.unique(np.concatenate([own[own <= grid[-1]], grid]))
    stamps = stamps[np.diff(stamps, prepend=stamps[0] - CLOSEST) >= CLOSEST]
    frames = clamp_frames(settings)
    for stamp in stamps.tolist():
        positions, rotations = command.sample(stamp)
        for name, position, rotation in zip(command.names, positions, rotations, strict=True):
            frame, offset = frames[name]
            turn = Rotation.from_quat(rotation) * Rotation.from_quat(offset[3:]).inv()
            place = position - turn.apply(offset[:3])
            message = transform_message(
                BAG_MESSAGES, stamp, settings.frame_id, frame, place.tolist(), turn.as_quat()
            )
            if settings.command.source == "tf":
                writer.write(topics.MOVING_TRANSFORMS, message, stamp)
            writer.write(POSES[name], _pose_of(message.transforms[0]), stamp)


def _pose_of(stamped: Any) -> Any:
    """geometry_msgs/PoseStamped of a geometry_msgs/TransformStamped."""
    place = stamped.transform.translation
    point = BAG_MESSAGES.make("geometry_msgs/msg/Point", x=place.x, y=place.y, z=place.z)
    pose = BAG_MESSAGES.make(
        "geometry_msgs/msg/Pose", position=point, orientation=stamped.transform.rotation
    )
    return BAG_MESSAGES.make("geometry_msgs/msg/PoseStamped", header=stamped.header, pose=pose)


def _list(names: set[str]) -> str:
    return " and ".join(sorted(names)) or "nothing"
