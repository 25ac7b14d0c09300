# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Camera images and camera_info as arrays (no cv_bridge, no ROS).

Messages are read by attribute, so those of a bag and those of rclpy do alike.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import InputError
from dlo_ros.recordings.messages import array

Image = NDArray[np.uint8]
DepthImage = NDArray[np.float32]

MAX_PIXELS = 100_000_000
"""Larger images are refused before any memory is taken for them."""

# ROS names a Bayer pattern by its first two rows, OpenCV from the second row's second pixel on.
CONVERSIONS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "8UC4": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, cv2.COLOR_GRAY2BGR),
    "mono16": (2, cv2.COLOR_GRAY2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
}
"""Bytes per pixel and OpenCV conversion to BGR of each encoding of sensor_msgs/Image."""

DEPTHS: dict[str, tuple[str, float]] = {
    "16UC1": ("u2", 1e-3),
    "mono16": ("u2", 1e-3),
    "32FC1": ("f4", 1.0),
}
"""Type of a depth image's numbers and their unit [m] by encoding (REP 118)."""

DISTORTION_COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14)}


@dataclass(frozen=True)
class CameraInfo:
    """Intrinsics of the images as they are published (binning and region of interest applied).

    Args:
        width, height: size of the image [px].
        distortion_model: plumb_bob or rational_polynomial.
        d: distortion coefficients in OpenCV's order.
        k: camera matrix, row by row, 9 numbers [px].
        frame_id: optical frame.
    """

    width: int
    height: int
    distortion_model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    frame_id: str = ""


def read_camera_info(message: Any) -> CameraInfo:
    """Intrinsics of a sensor_msgs/CameraInfo.

    Raises:
        InputError: not calibrated (zeros), not finite, or of an unknown distortion model.
    """
    k, d = array(message.k, "camera_info: k", 9), array(message.d, "camera_info: d")
    width, height = int(message.width), int(message.height)
    if not 0 < width * height <= MAX_PIXELS:
        raise InputError(f"camera_info says {width} x {height} pixels; give the image's size")
    if not (k[0] > 0.0 and k[4] > 0.0):
        raise InputError(
            f"camera_info has focal lengths {k[0]:g} and {k[4]:g}; the camera is not calibrated"
        )
    if abs(k[8] - 1.0) > 1e-6 or np.any(k[[3, 6, 7]] != 0.0):
        raise InputError("camera_info: k is no camera matrix (last row 0 0 1)")
    model = str(message.distortion_model)
    if not model and not np.any(d):
        model, d = "plumb_bob", np.zeros(5)  # an ideal camera, as simulators publish it
    allowed = DISTORTION_COEFFICIENTS.get(model)
    if allowed is None:
        raise InputError(
            f"camera_info has distortion_model '{model[:40]}'; "
            f"known are {' and '.join(DISTORTION_COEFFICIENTS)}"
        )
    if d.size and d.size not in allowed:
        raise InputError(
            f"camera_info has {d.size} coefficients d; {model} has {' or '.join(map(str, allowed))}"
        )
    bx, by = max(int(message.binning_x), 1), max(int(message.binning_y), 1)
    roi = message.roi
    if roi.width and roi.height:
        width, height = int(roi.width), int(roi.height)
        k[2] -= float(roi.x_offset)
        k[5] -= float(roi.y_offset)
    k[:3] /= bx
    k[3:6] /= by
    return CameraInfo(
        width=width // bx,
        height=height // by,
        distortion_model=model,
        d=tuple(d.tolist()) or (0.0,) * 5,
        k=tuple(k.tolist()),
        frame_id=str(message.header.frame_id),
    )


def read_image(message: Any) -> Image:
    """BGR picture of a sensor_msgs/Image or CompressedImage, shape (height, width, 3).

    Raises:
        InputError: unknown encoding, sizes that contradict each other, damaged or too large.
    """
    if hasattr(message, "format"):
        return decode(bytes(memoryview(message.data)))
    return _read_raw(message)


def _read_raw(message: Any) -> Image:
    width, height, step = int(message.width), int(message.height), int(message.step)
    encoding = str(message.encoding)
    if encoding not in CONVERSIONS:
        raise InputError(
            f"image has encoding '{encoding[:40]}'; known are {', '.join(CONVERSIONS)}"
        )
    size, conversion = CONVERSIONS[encoding]
    _check_size(width, height)
    data = np.frombuffer(message.data, dtype=np.uint8)
    if step < width * size:
        raise InputError(
            f"image has step {step}; {width} pixels of {encoding} need {width * size} bytes"
        )
    if data.size != step * height:
        raise InputError(
            f"image has {data.size} bytes; {height} rows of step {step} are {step * height}"
        )
    rows = data.reshape(height, step)[:, : width * size]
    if encoding == "mono16":
        # The high byte alone: what the observer needs is 8 bits deep.
        rows = rows[:, 0 if message.is_bigendian else 1 :: 2]
        size = 1
    pixels = np.ascontiguousarray(rows).reshape(height, width, size)
    if conversion is None:
        return pixels.copy()
    if encoding.startswith("bayer") and min(width, height) < 4:
        raise InputError(f"image of {width} x {height} pixels is too small for {encoding}")
    return np.asarray(cv2.cvtColor(pixels, conversion), dtype=np.uint8)


def check_image_size(picture: Image | DepthImage, info: CameraInfo) -> None:
    """Refuse a picture of another size than its intrinsics are for.

    Raises:
        InputError: the sizes differ.
    """
    if picture.shape[:2] != (info.height, info.width):
        raise InputError(
            f"image of {picture.shape[1]} x {picture.shape[0]} pixels; camera_info says "
            f"{info.width} x {info.height}"
        )


def read_depth(message: Any) -> DepthImage:
    """Depths of a sensor_msgs/Image [m], NaN where there is none, shape (height, width).

    Raises:
        InputError: unknown encoding or sizes that contradict each other.
    """
    encoding = str(message.encoding)
    if encoding not in DEPTHS:
        raise InputError(
            f"depth image has encoding '{encoding[:40]}'; known are {', '.join(DEPTHS)}"
        )
    with np.errstate(invalid="ignore"):  # some NaN signal
        depth = _read_numbers(message, "depth image") * np.float32(DEPTHS[encoding][1])
    return np.where(np.isfinite(depth) & (depth > 0.0), depth, np.float32(np.nan))


def read_mask(message: Any) -> Image:
    """Mask of a sensor_msgs/Image, 1 where any of its colours is not zero, shape (height, width).

    Numbers of 16 bits, as of labels, are looked at as a whole.

    Raises:
        InputError: unknown encoding or sizes that contradict each other.
    """
    if str(message.encoding) in DEPTHS:
        return np.asarray(_read_numbers(message, "mask") != 0.0, dtype=np.uint8)
    return np.asarray(read_image(message).any(axis=2), dtype=np.uint8)


def _read_numbers(message: Any, what: str) -> DepthImage:
    """Numbers of an image whose encoding is one of `DEPTHS`, shape (height, width)."""
    width, height, step = int(message.width), int(message.height), int(message.step)
    encoding = str(message.encoding)
    number = np.dtype((">" if message.is_bigendian else "<") + DEPTHS[encoding][0])
    _check_size(width, height)
    data = np.frombuffer(message.data, dtype=np.uint8)
    if step < width * number.itemsize or data.size != step * height:
        raise InputError(
            f"{what} has {data.size} bytes and step {step}; {height} rows of {width} pixels "
            f"of {encoding} are something else"
        )
    rows = np.ascontiguousarray(data.reshape(height, step)[:, : width * number.itemsize])
    return rows.view(number).astype(np.float32)


def decode(data: bytes) -> Image:
    """BGR picture of a JPEG or PNG file's bytes, shape (height, width, 3), EXIF rotation ignored.

    Raises:
        InputError: neither JPEG nor PNG, cut short, damaged or too large.
    """
    if data.startswith(b"\xff\xd8"):
        width, height = _jpeg_size(data)
    elif data.startswith(b"\x89PNG\r\n\x1a\n"):
        width, height = _png_size(data)
    else:
        raise InputError("compressed image is neither JPEG nor PNG")
    _check_size(width, height)
    # The board's pose refers to the sensor's raster, so a rotation noted in EXIF is not applied.
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        picture = None
    if picture is None or picture.shape != (height, width, 3):
        raise InputError("compressed image is damaged and cannot be decoded")
    return np.asarray(picture, dtype=np.uint8)


def _check_size(width: int, height: int) -> None:
    if width <= 0 or height <= 0:
        raise InputError(f"image is {width} x {height} pixels; it is empty")
    if width * height > MAX_PIXELS:
        raise InputError(
            f"image says {width} x {height} pixels; more than {MAX_PIXELS // 10**6} Mpx is refused"
        )


def _png_size(data: bytes) -> tuple[int, int]:
    """Width and height from the header; checks that all is there, by each chunk's checksum.

    Decoders show what they got of a damaged file; what is missing would be taken for ground.
    """
    at, size = 8, None
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        kind, end = data[at + 4 : at + 8], at + 8 + length
        if end + 4 > len(data):
            break
        if zlib.crc32(data[at + 4 : end]) != struct.unpack(">I", data[end : end + 4])[0]:
            raise InputError("PNG image is damaged (a checksum is wrong)")
        if kind == b"IHDR" and length == 13:
            size = struct.unpack(">II", data[at + 8 : at + 16])
        if kind == b"IEND" and size is not None:
            return int(size[0]), int(size[1])
        at = end + 4
    raise InputError("PNG image is cut short or damaged")


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Width and height from the frame header; checks that the picture has an end."""
    at, size = 2, None
    while at + 9 < len(data):
        if data[at] != 0xFF:
            break
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker == 0xDA:  # the picture itself; its bytes 0xFF are stuffed, so the end is unique
            if size is None or data.rfind(b"\xff\xd9", at) < 0:
                break
            return size
        if marker in (0x01, *range(0xD0, 0xD8)):  # markers without a length
            at += 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            size = (int(width), int(height))
        at += 2 + int(struct.unpack(">H", data[at + 2 : at + 4])[0])
    raise InputError("JPEG image is cut short or damaged")
