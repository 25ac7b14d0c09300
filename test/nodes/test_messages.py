# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back; everything malformed is refused with a reason."""

from __future__ import annotations

import copy
import math
import struct
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
import recordings_samples as samples
from hypothesis import given, settings
from hypothesis import strategies as st

from dlo_ros.errors import CommandError, InputError
from dlo_ros.recordings import (
    BAG_MESSAGES,
    camera_info_message,
    command_message,
    compressed_message,
    float_message,
    image_message,
    points_message,
    read_camera_info,
    read_command,
    read_image,
    read_observation,
    read_points,
    read_spline,
    spline_message,
    unwrap_in_time,
)
from dlo_ros.recordings.images import decode

NAN = float("nan")
TEMPLATES = {
    "command": command_message(BAG_MESSAGES, samples.command()),
    "spline": spline_message(BAG_MESSAGES, samples.START, "board", samples.control_points()),
    "points": points_message(BAG_MESSAGES, samples.START, "board", samples.centreline()),
    "image": image_message(BAG_MESSAGES, samples.START, "c", samples.picture()),
    "info": camera_info_message(BAG_MESSAGES, samples.START, samples.INFO),
}


def fresh(name: str):
    return copy.deepcopy(TEMPLATES[name])


def read_it(message):
    return read_command(message, samples.SETTINGS, 5)


def set_path(message, path: str, value) -> None:
    *parents, last = path.split(".")
    for part in parents:
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    if last.isdigit():
        message[int(last)] = value
    else:
        setattr(message, last, value)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("header.frame_id", "table", "frame_id is 'board'"),
        ("header.frame_id", "", "frame_id is 'board'"),
        ("joint_names", [], "names nothing"),
        ("joint_names", ["start", "gripper"], "'gripper'; known are start, end"),
        ("joint_names", ["start", "control_point_9"], "control_point_9"),
        ("joint_names", ["start", "control_point_0"], "control_point_0"),
        ("joint_names", ["start", "control_point_02"], "control_point_02"),
        ("joint_names", ["start", "start"], "both impose control point 1"),
        ("joint_names", ["start", "control_point_2"], "both impose control point 2"),
        ("joint_names", ["start", "control_point_7"], "without control_point_8"),
        ("joint_names", ["start"] * 100, "100 names"),
        ("joint_names", ["start", "control_point_3", "end"], "2 transforms for 3 names"),
        ("points", [], "no points"),
        ("points.1.transforms", [], "point 1 has 0 transforms for 2 names"),
        ("points.1.velocities", TEMPLATES["command"].points[1].velocities[:1], "1 velocities"),
        ("points.1.time_from_start.sec", 0, None),
        ("points.1.time_from_start.sec", -3, "must grow"),
        ("points.0.time_from_start.sec", 9, "must grow"),
        ("points.1.transforms.0.translation.x", NAN, "position that is not finite"),
        ("points.1.transforms.0.translation.x", math.inf, "m away"),
        ("points.1.transforms.0.translation.x", 250000.0, "positions are in metres"),
        ("points.1.transforms.0.rotation.w", NAN, "rotation that is not finite"),
        ("points.1.transforms.0.rotation.w", 0.0, "'start' is no unit quaternion"),
        ("points.1.velocities.1.linear.y", NAN, "velocity 1 of point 1"),
        ("points.1.velocities.0.angular.z", math.inf, "velocity 0 of point 1"),
    ],
)
def test_malformed_command(path, value, reason):
    message = fresh("command")
    set_path(message, path, value)
    if reason is None:
        read_it(message)
        return
    with pytest.raises(CommandError) as caught:
        read_it(message)
    assert reason in str(caught.value) and "\n" not in str(caught.value)


def test_equal_times_are_refused():
    message = fresh("command")
    message.points[1].time_from_start = message.points[0].time_from_start
    with pytest.raises(CommandError, match="must grow"):
        read_it(message)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("header.frame_id", "map", "frame_id is 'board'"),
        ("poses", [], "0 poses; rod.control_points is 8"),
        ("poses.3.position.z", NAN, "not finite"),
        ("poses.3.position.z", 1e7, "m away"),
        ("poses.3.orientation.w", math.inf, "not finite"),
        ("poses.0.orientation.w", 0.0, "no rotation about x"),
        ("poses.0.orientation.z", 0.7, "no rotation about x"),
    ],
)
def test_malformed_spline(path, value, reason):
    message = fresh("spline")
    set_path(message, path, value)
    with pytest.raises(InputError) as caught:
        read_spline(message, samples.SETTINGS)
    assert reason in str(caught.value)


def test_observed_shape_without_direction_is_refused():
    """An observer that has lost the DLO may send the same point again and again."""
    message = fresh("spline")
    assert read_observation(message, samples.SETTINGS).stamp == samples.START
    for k in range(4, 7):
        message.poses[k].position = message.poses[3].position
    with pytest.raises(InputError, match=r"coincide at u = 0\.24 m"):
        read_observation(message, samples.SETTINGS)


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_observed_shape_of_another_length_is_refused(factor):
    shape = samples.control_points()
    shape[:, :3] *= factor
    message = spline_message(BAG_MESSAGES, samples.START, "board", shape)
    with pytest.raises(InputError, match=r"m long; rod\.length is 0\.4 m"):
        read_observation(message, samples.SETTINGS)


def test_twist_travels_modulo_a_turn_and_comes_back_unwrapped():
    shape = samples.control_points()
    shape[:, 3] += 4 * math.pi
    message = spline_message(BAG_MESSAGES, samples.START, "board", shape)
    read = read_spline(message, samples.SETTINGS)
    # Along u it is continuous; the full turns of the whole are known from the time before only.
    np.testing.assert_allclose(np.diff(read[:, 3]), np.diff(shape[:, 3]), atol=1e-12)
    np.testing.assert_allclose(
        unwrap_in_time(read[:, 3], shape[:, 3] + 1.0), shape[:, 3], atol=1e-12
    )


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("header.frame_id", "map", "frame_id is 'board'"),
        ("fields.4.name", "sigma", "lacks the float field std"),
        ("fields.2.datatype", 2, "lacks the float field z"),
        ("fields.2.offset", 18, "lacks the float field z"),
        ("width", 6, "need 120"),
        ("height", 2, "need 200"),
        ("width", 4_000_000_000, "at most"),
        ("point_step", 3, "lacks the float field x"),
        ("data", np.zeros(0, np.uint8), "need 100"),
        ("data", np.full(100, 255, np.uint8), "no usable point"),
        ("data", np.zeros(100, np.uint8), "std positive"),
    ],
)
def test_malformed_points(path, value, reason):
    message = fresh("points")
    set_path(message, path, value)
    with pytest.raises(InputError) as caught:
        read_points(message, samples.SETTINGS)
    assert reason in str(caught.value)


def test_points_of_another_layout():
    """Big-endian doubles in rows with padding, fields in another order, one point not finite."""
    truth = samples.centreline(1)
    kind = np.dtype(
        {
            "names": ["std", "u", "z", "y", "x"],
            "formats": [">f8"] * 5,
            "offsets": [0, 8, 16, 24, 33],
            "itemsize": 45,
        }
    )
    cloud = np.zeros(6, kind)
    for k, name in enumerate("xyz"):
        cloud[name][:5] = truth.positions[:, k]
    cloud["u"][:5], cloud["std"][:5] = truth.u, truth.std
    cloud["x"][5] = NAN
    rows = np.zeros((2, 3 * 45 + 7), np.uint8)
    rows[:, : 3 * 45] = cloud.view(np.uint8).reshape(2, 3 * 45)
    message = fresh("points")
    message.is_bigendian = True
    message.height, message.width, message.point_step, message.row_step = 2, 3, 45, 3 * 45 + 7
    message.fields = [
        BAG_MESSAGES.make(
            "sensor_msgs/msg/PointField", name=n, offset=kind.fields[n][1], datatype=8, count=1
        )
        for n in kind.names
    ]
    message.data = rows.ravel()
    points = read_points(message, samples.SETTINGS)
    np.testing.assert_allclose(points.positions, truth.positions)
    np.testing.assert_allclose(points.std, truth.std)


def test_how_well_u_is_known_comes_with_the_points_where_it_is_uncertain():
    truth = samples.centreline()
    assert read_points(fresh("points"), samples.SETTINGS).std_along is None
    stated = replace(truth, std_along=np.array([1e-4, 2e-4, 4e-4, 8e-4, 0.0]))
    message = points_message(BAG_MESSAGES, samples.START, "board", stated)
    assert [f.name for f in message.fields] == ["x", "y", "z", "u", "std", "std_along"]
    points = read_points(message, samples.SETTINGS)
    assert len(points.u) == 4  # none is known exactly
    np.testing.assert_allclose(points.std_along, stated.std_along[:4], rtol=1e-6)
    np.testing.assert_allclose(points.std, truth.std[:4], rtol=1e-6)
    with pytest.raises(InputError, match="not finite"):
        unknown = replace(truth, std_along=np.full(5, math.inf))
        points_message(BAG_MESSAGES, samples.START, "board", unknown)


def test_nothing_that_is_not_finite_is_built():
    shape = samples.control_points()
    shape[2, 1] = NAN
    with pytest.raises(InputError):
        spline_message(BAG_MESSAGES, 1, "board", shape)
    with pytest.raises(InputError):
        float_message(BAG_MESSAGES, math.inf)


# --- images ---------------------------------------------------------------------------------


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
    message = fresh("image")
    for key, value in changes.items():
        setattr(message, key, value)
    with pytest.raises(InputError) as caught:
        read_image(message)
    assert reason in str(caught.value)


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
    message = fresh("info")
    for key, value in changes.items():
        setattr(message, key, value)
    with pytest.raises(InputError) as caught:
        read_camera_info(message)
    assert reason in str(caught.value)


def test_camera_info_of_an_image_that_is_cut_out_and_binned():
    message = fresh("info")
    message.binning_x, message.binning_y = 2, 2
    message.roi.x_offset, message.roi.y_offset = 10, 8
    message.roi.width, message.roi.height = 40, 32
    info = read_camera_info(message)
    assert (info.width, info.height) == (20, 16)
    np.testing.assert_allclose(info.k, (40, 0, 10.75, 0, 40.5, 7.75, 0, 0, 1))
    np.testing.assert_allclose(read_camera_info(fresh("info")).k, samples.INFO.k)
