# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings: rosbag2 folders read, written and played, and messages from and to arrays."""

from dlo_ros.recordings.bag import Bag, RawMessage, deserialise, open_bag
from dlo_ros.recordings.image_building import camera_info_message, compressed_message, image_message
from dlo_ros.recordings.images import CameraInfo, read_camera_info, read_image
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    MessageFactory,
    command_message,
    float_message,
    points_message,
    spline_message,
)
from dlo_ros.recordings.messages import (
    read_command,
    read_observation,
    read_points,
    read_spline,
    unwrap_in_time,
)
from dlo_ros.recordings.read import BagContents, iterate_images, read_recording
from dlo_ros.recordings.write import BagWriter, copy_topics

__all__ = [
    "BAG_MESSAGES",
    "Bag",
    "BagContents",
    "BagWriter",
    "CameraInfo",
    "MessageFactory",
    "RawMessage",
    "camera_info_message",
    "command_message",
    "compressed_message",
    "copy_topics",
    "deserialise",
    "float_message",
    "image_message",
    "iterate_images",
    "open_bag",
    "points_message",
    "read_camera_info",
    "read_command",
    "read_image",
    "read_observation",
    "read_points",
    "read_recording",
    "read_spline",
    "spline_message",
    "unwrap_in_time",
]
