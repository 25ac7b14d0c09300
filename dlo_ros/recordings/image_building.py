# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Messages from pictures and calibrations, for a bag or for rclpy alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dlo_ros.recordings.images import CameraInfo, Image
from dlo_ros.recordings.message_building import MessageFactory, header


def image_message(factory: MessageFactory, stamp: int, frame_id: str, picture: Image) -> Any:
    """sensor_msgs/Image of a BGR picture (height, width, 3) or a grey one (height, width)."""
    grey = picture.ndim == 2
    return factory.make(
        "sensor_msgs/msg/Image",
        header=header(factory, stamp, frame_id),
        height=int(picture.shape[0]),
        width=int(picture.shape[1]),
        encoding="mono8" if grey else "bgr8",
        is_bigendian=0,
        step=int(picture.shape[1]) * (1 if grey else 3),
        data=factory.octets(np.ascontiguousarray(picture, dtype=np.uint8).tobytes()),
    )


def depth_message(
    factory: MessageFactory, stamp: int, frame_id: str, depth: NDArray[np.uint16]
) -> Any:
    """sensor_msgs/Image of depths [mm], 0 where there is none, shape (height, width)."""
    return factory.make(
        "sensor_msgs/msg/Image",
        header=header(factory, stamp, frame_id),
        height=int(depth.shape[0]),
        width=int(depth.shape[1]),
        encoding="16UC1",
        is_bigendian=0,
        step=int(depth.shape[1]) * 2,
        data=factory.octets(np.ascontiguousarray(depth, dtype="<u2").tobytes()),
    )


def compressed_message(
    factory: MessageFactory, stamp: int, frame_id: str, data: bytes, kind: str = "jpeg"
) -> Any:
    """sensor_msgs/CompressedImage of a JPEG or PNG file's bytes."""
    return factory.make(
        "sensor_msgs/msg/CompressedImage",
        header=header(factory, stamp, frame_id),
        format=kind,
        data=factory.octets(data),
    )


def camera_info_message(factory: MessageFactory, stamp: int, info: CameraInfo) -> Any:
    """sensor_msgs/CameraInfo of an unbinned image, P = [K | 0]."""
    k = info.k
    return factory.make(
        "sensor_msgs/msg/CameraInfo",
        header=header(factory, stamp, info.frame_id),
        height=info.height,
        width=info.width,
        distortion_model=info.distortion_model,
        d=factory.doubles(info.d),
        k=factory.doubles(k),
        r=factory.doubles((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)),
        p=factory.doubles((*k[:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0)),
        binning_x=0,
        binning_y=0,
        roi=factory.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        ),
    )
