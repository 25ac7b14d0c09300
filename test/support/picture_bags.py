# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Bags of rendered pictures."""

import cv2

from dlo_ros.recordings import (
    BAG_MESSAGES,
    BagWriter,
    CameraInfo,
    camera_info_message,
    command_message,
    compressed_message,
)

STAMP = 1_700_000_000_000_000_000


def write_bag(path, scene, pictures, command=None):
    c = scene.camera()
    info = CameraInfo(
        c.width, c.height, "plumb_bob", c.distortion, tuple(c.matrix.ravel().tolist()), "camera"
    )
    with BagWriter(path) as writer:
        for k, picture in enumerate(pictures):
            stamp = STAMP + k * 33_000_000
            writer.write("camera_info", camera_info_message(BAG_MESSAGES, stamp, info), stamp)
            data = cv2.imencode(".png", picture)[1].tobytes()
            message = compressed_message(BAG_MESSAGES, stamp, "camera", data, "png")
            writer.write("image_raw/compressed", message, stamp)
        if command is not None:
            writer.write("dlo/command", command_message(BAG_MESSAGES, command), STAMP - 1)
