# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Small recordings and messages that the tests of bags and nodes share."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from dlo_ros.command import Command
from dlo_ros.observation import CentrelinePoints
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    CameraInfo,
    camera_info_message,
    command_message,
    compressed_message,
    image_message,
    points_message,
    spline_message,
)
from dlo_ros.recordings.bag import TYPESTORE
from dlo_ros.spline import FloatArray

START = 1_700_000_000_000_000_000
STEP = 20_000_000
N = 8
SETTINGS = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.004,
        "rod.young_modulus": 1e6,
        "rod.density": 2000.0,
        "rod.control_points": N,
    }
)
INFO = CameraInfo(
    width=64,
    height=48,
    distortion_model="plumb_bob",
    d=(0.1, -0.05, 0.001, -0.002, 0.0),
    k=(80.0, 0.0, 31.5, 0.0, 81.0, 23.5, 0.0, 0.0, 1.0),
    frame_id="camera_optical",
)


def command(stamp: int = START) -> Command:
    """Both clamps, the end moving and turning, two points; velocities at the second alone."""
    positions = np.zeros((2, 2, 3))
    positions[0, 1] = 0.3, 0.0, -0.1
    positions[1, 1] = 0.25, 0.0, -0.12
    rotations = np.zeros((2, 2, 4))
    rotations[..., 3] = 1.0
    rotations[1, 1] = 0.0, math.sin(0.2), 0.0, math.cos(0.2)
    velocities = np.full((2, 2, 3), np.nan)
    velocities[1] = 0.01
    return Command(
        stamp=stamp,
        names=("start", "end"),
        times=np.array([0.0, 1.25]),
        positions=positions,
        rotations=rotations,
        velocities=velocities,
        control_points=N,
    )


def control_points(i: int = 0) -> FloatArray:
    """A curved shape that differs with i and twists by more than a turn, shape (N, 4)."""
    s = np.linspace(0.0, 1.0, N)
    x, z = 0.3 * s, -0.1 * np.sin(math.pi * s) - 0.001 * i
    return np.column_stack([x, np.zeros(N), z, 9.0 * s + 0.5 * i])


def centreline(i: int = 0) -> CentrelinePoints:
    """Five measured points."""
    u = np.linspace(0.0, 0.4, 5)
    xyz = np.column_stack([u, np.zeros(5), -0.01 * i - u**2])
    return CentrelinePoints(xyz, u, np.full(5, 2e-4) + 1e-5 * np.arange(5))


def picture(i: int = 0) -> np.ndarray:
    """A smooth BGR picture of the size that INFO says."""
    y, x = np.mgrid[0 : INFO.height, 0 : INFO.width]
    return np.stack([x * 3, y * 4, 100 + x + i], axis=-1).astype(np.uint8)


def messages(images: bool = True) -> list[tuple[str, object, int]]:
    """Topic, message and recording time of a whole manipulation."""
    b = BAG_MESSAGES
    result: list[tuple[str, object, int]] = [
        ("/dlo/command", command_message(b, command()), START - STEP)
    ]
    for i in range(4):
        stamp = START + i * STEP
        spline = spline_message(b, stamp, "board", control_points(i))
        result.append(("/dlo/observed", spline, stamp + 1000))
        if i % 2 == 0:
            cloud = points_message(b, stamp, "board", centreline(i))
            result.append(("/dlo/observed_points", cloud, stamp + 900))
        if images:
            result.append(("/camera_info", camera_info_message(b, stamp, INFO), stamp))
            raw = image_message(b, stamp, INFO.frame_id, picture(i))
            result.append(("/image_raw", raw, stamp + 500))
    return sorted(result, key=lambda item: item[2])


def jpeg(i: int = 0) -> bytes:
    return cv2.imencode(".jpg", picture(i), [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()


def compressed(i: int = 0) -> object:
    return compressed_message(BAG_MESSAGES, START + i * STEP, INFO.frame_id, jpeg(i))


def write_plain(
    path: Path,
    items: list[tuple[str, object, int]],
    plugin: StoragePlugin = StoragePlugin.MCAP,
    compression: tuple | None = None,
) -> Path:
    """Write a bag with rosbags alone, as another recorder would."""
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(*compression)
    with writer:
        connections = {}
        for topic, message, stamp in items:
            kind = message.__msgtype__
            if (topic, kind) not in connections:
                connections[topic, kind] = writer.add_connection(topic, kind, typestore=TYPESTORE)
            data = TYPESTORE.serialize_cdr(message, kind)
            writer.write(connections[topic, kind], stamp, data)
    return path
