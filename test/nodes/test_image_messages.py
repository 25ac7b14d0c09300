# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Images and camera_info as messages: encodings, compression, damaged pictures, cut-outs."""

from __future__ import annotations

import struct
import warnings
import zlib

import cv2
import numpy as np
import pytest
import recordings_samples as samples
from hypothesis import given, settings
from hypothesis import strategies as st
from message_templates import fresh

from dlo_ros.errors import InputError
from dlo_ros.recordings import (
    BAG_MESSAGES,
    compressed_message,
    read_camera_info,
    read_image,
)
from dlo_ros.recordings.images import decode, read_depth, read_mask

NAN = float("nan")


def refusal(read, kind, changes):
    """The reason for which a message with changed fields is refused."""
    message = fresh(kind)
    for key, value in changes.items():
        setattr(message, key, value)
    with pytest.raises(InputError) as caught:
        read(message)
    return str(caught.value)


def raw(encoding: str, pixels: np.ndarray, padding: int = 0):
    """An image message whose rows are padded with bytes that must not be seen."""
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1).view(np.uint8)
    rows = np.hstack([rows, np.full((height, padding), 199, np.uint8)])
    message = fresh("image")
    message.encoding, message.height, message.width = encoding, height, width
    message.step, message.data = rows.shape[1], rows.ravel()
    return message


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("encoding", ["bgr8", "rgb8", "bgra8", "rgba8", "mono8", "8UC3", "8UC1"])
def test_encodings(encoding, padding):
    bgr = samples.picture()
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    alpha = np.full((*grey.shape, 1), 77, np.uint8)
    given, expected = {
        "bgr8": (bgr, bgr),
        "8UC3": (bgr, bgr),
        "rgb8": (bgr[..., ::-1], bgr),
        "bgra8": (np.dstack([bgr, alpha]), bgr),
        "rgba8": (np.dstack([bgr[..., ::-1], alpha]), bgr),
        "mono8": (grey, np.dstack([grey] * 3)),
        "8UC1": (grey, np.dstack([grey] * 3)),
    }[encoding]
    picture = read_image(raw(encoding, np.ascontiguousarray(given), padding))
    assert picture.flags.writeable and picture.flags.c_contiguous
    np.testing.assert_array_equal(picture, expected)


@pytest.mark.parametrize("big", [False, True])
def test_sixteen_bits(big):
    grey = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 20
    message = raw("mono16", grey.astype(">u2" if big else "<u2"), 3)
    message.is_bigendian = int(big)
    np.testing.assert_array_equal(read_image(message)[..., 1], grey // 256)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer(pattern):
    """A mosaic of one colour comes back as that colour, whichever pixel of the cell is which."""
    colour = {"b": 40, "g": 120, "r": 220}
    cell = np.array([[colour[pattern[0]], colour[pattern[1]]], [colour[c] for c in pattern[2:]]])
    mosaic = np.tile(cell, (20, 24)).astype(np.uint8)
    picture = read_image(raw(f"bayer_{pattern}8", mosaic, 4))
    np.testing.assert_array_equal(picture[4:-4, 4:-4], np.full((32, 40, 3), (40, 120, 220)))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"encoding": "yuv999"}, "'yuv999'; known are bgr8"),
        ({"encoding": ""}, "known are"),
        ({"step": 3 * 64 - 1}, "need 192"),
        ({"step": 0}, "need 192"),
        ({"step": 3 * 64 + 1}, "48 rows of step 193"),
        ({"height": 47}, "47 rows"),
        ({"height": 4_000_000, "width": 4_000_000}, "refused"),
        ({"width": 0, "step": 0}, "empty"),
        ({"data": np.zeros(0, np.uint8)}, "has 0 bytes"),
    ],
)
def test_images_that_lie(changes, reason):
    assert reason in refusal(read_image, "image", changes)


def png(picture: np.ndarray) -> bytes:
    return cv2.imencode(".png", picture)[1].tobytes()


def test_compressed_images():
    message = compressed_message(BAG_MESSAGES, 1, "c", png(samples.picture()), "png")
    np.testing.assert_array_equal(read_image(message), samples.picture())
    grey = cv2.imencode(".jpg", samples.picture()[..., 0])[1].tobytes()
    assert decode(grey).shape == (48, 64, 3)
    assert decode(samples.jpeg() + b"\0" * 3000).shape == (48, 64, 3)  # cameras pad


def test_rotation_noted_in_exif_is_not_applied():
    tiff = b"II*\0\x08\0\0\0" + struct.pack("<HHHIHHI", 1, 0x0112, 3, 1, 6, 0, 0)
    exif = b"Exif\0\0" + tiff
    jpeg = samples.jpeg()
    rolled = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
    assert cv2.imdecode(np.frombuffer(rolled, np.uint8), cv2.IMREAD_COLOR).shape[0] == 64
    np.testing.assert_array_equal(decode(rolled), decode(jpeg))


@pytest.mark.parametrize("part", [0.0, 0.01, 0.1, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("kind", ["jpeg", "png"])
def test_truncated_pictures_are_not_half_shown(kind, part):
    data = samples.jpeg() if kind == "jpeg" else png(samples.picture())
    with pytest.raises(InputError):
        decode(data[: int(part * len(data))])


def test_decompression_bombs_are_refused_before_they_are_unpacked():
    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    bomb = b"\x89PNG\r\n\x1a\n"
    for kind, content in ((b"IHDR", header), (b"IEND", b"")):
        checksum = struct.pack(">I", zlib.crc32(kind + content))
        bomb += struct.pack(">I", len(content)) + kind + content + checksum
    with pytest.raises(InputError, match="60000 x 60000"):
        decode(bomb)
    jpeg = bytearray(samples.jpeg())
    at = jpeg.index(b"\xff\xc0")
    jpeg[at + 5 : at + 9] = struct.pack(">HH", 65000, 65000)
    with pytest.raises(InputError, match="65000 x 65000"):
        decode(bytes(jpeg))


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=60), st.integers(0, 3000), st.sampled_from(["jpeg", "png"]))
def test_damaged_pictures_raise_input_errors_only(junk, at, kind):
    data = bytearray(samples.jpeg() if kind == "jpeg" else png(samples.picture()))
    at %= len(data)
    data[at : at + len(junk)] = junk
    try:
        assert decode(bytes(data)).ndim == 3
    except InputError as err:
        assert "\n" not in str(err)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"k": np.zeros(9)}, "not calibrated"),
        ({"k": np.full(9, NAN)}, "not finite"),
        ({"k": np.eye(3).ravel() * 2}, "no camera matrix"),
        ({"d": np.array([0.1, NAN])}, "not finite"),
        ({"d": np.zeros(3)}, "3 coefficients"),
        ({"d": np.zeros(100_000)}, "100000 coefficients"),
        ({"distortion_model": "equidistant"}, "'equidistant'"),
        ({"distortion_model": ""}, "''; known are"),
        ({"width": 0}, "0 x 48 pixels"),
        ({"width": 4_000_000_000}, "4000000000 x 48"),
    ],
)
def test_unusable_camera_info(changes, reason):
    assert reason in refusal(read_camera_info, "info", changes)


def test_camera_info_of_an_image_that_is_cut_out_and_binned():
    message = fresh("info")
    message.binning_x, message.binning_y = 2, 2
    message.roi.x_offset, message.roi.y_offset = 10, 8
    message.roi.width, message.roi.height = 40, 32
    info = read_camera_info(message)
    assert (info.width, info.height) == (20, 16)
    np.testing.assert_allclose(info.k, (40, 0, 10.75, 0, 40.5, 7.75, 0, 0, 1))
    np.testing.assert_allclose(read_camera_info(fresh("info")).k, samples.INFO.k)


@pytest.mark.parametrize("colour", [(255, 0, 0), (0, 255, 0), (0, 0, 1)])
def test_a_mask_of_any_colour_or_depth_says_where_it_is_not_zero(colour):
    inside = samples.picture()[..., 0] > 100
    expected = inside.astype(np.uint8)
    assert 0 < expected.sum() < expected.size
    coloured = expected[..., None] * np.array(colour, dtype=np.uint8)
    np.testing.assert_array_equal(read_mask(raw("rgb8", coloured)), expected)
    for encoding, number in (("mono8", np.uint8), ("mono16", "<u2"), ("16UC1", "<u2")):
        for value in (1, 255):
            labels = expected.astype(number) * np.dtype(number).type(value)
            np.testing.assert_array_equal(read_mask(raw(encoding, labels, padding=4)), expected)
    message = raw("mono16", expected.astype("<u2"))
    message.data = message.data[:-2]
    with pytest.raises(InputError, match=r"mask has .* bytes"):
        read_mask(message)


def test_a_depth_that_is_no_number_is_none_and_no_warning():
    """NaN as damaged data has it, beside the usual one."""
    numbers = np.array([[0x7F800001, 0x7FC00000, 0x7F800000, 0x3F800000]], "<u4")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        depth = read_depth(raw("32FC1", numbers.view("<f4")))
    np.testing.assert_array_equal(depth, [[np.nan, np.nan, np.nan, 1.0]])
