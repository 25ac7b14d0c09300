# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back; everything malformed is refused with a reason."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
import recordings_samples as samples
from message_templates import TEMPLATES, fresh

from dlo_ros.errors import CommandError, InputError
from dlo_ros.recordings import (
    BAG_MESSAGES,
    float_message,
    points_message,
    read_command,
    read_observation,
    read_points,
    read_spline,
    spline_message,
    unwrap_in_time,
)

NAN = float("nan")


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
        ("points.1.transforms.0.rotation.w", 0.0, "the rotation of 'start' at point 1 has norm"),
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


def test_numbers_that_are_none_are_left_out_in_silence():
    """NaN as other byte orders make it warns where it is converted."""
    message = fresh("points")
    data = np.array(message.data, np.uint8)
    data[:4] = np.array([0x7F800001], "<u4").view(np.uint8)
    message.data = data
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        points = read_points(message, samples.SETTINGS)
    assert len(points.u) == len(samples.centreline(1).u) - 1


def test_points_that_are_too_exact_outweigh_none():
    """A standard deviation that nobody can measure counts as the least that somebody could."""
    message = fresh("points")
    table = np.array(message.data, np.uint8).view("<f4").reshape(-1, 5).copy()
    table[:2, 4] = 1e-30, 2e-6
    message.data = table.view(np.uint8).ravel()
    np.testing.assert_allclose(read_points(message, samples.SETTINGS).std[:2], [1e-6, 2e-6])


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
