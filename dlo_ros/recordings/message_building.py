# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Messages from the package's data, for a bag or for rclpy alike.

A `MessageFactory` makes the message objects; `BagMessages` makes those that a bag is written from.
Numbers that are not finite are refused here, so that they leave neither a node nor a tool.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import InputError
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import TYPESTORE
from dlo_ros.spline import FloatArray

FLOAT32 = 7
LAST_SECOND = 2**31 - 1
AVERAGE, MAXIMUM, STANDARD_DEVIATION = 1, 3, 4
"""Kinds of numbers in statistics_msgs/StatisticDataType."""

POINT_FIELDS = ("x", "y", "z", "u", "std")
STD_ALONG = "std_along"


class MessageFactory(Protocol):
    """Makes message objects of one middleware."""

    def make(self, kind: str, /, **fields: Any) -> Any:
        """A message of a type such as `geometry_msgs/msg/Point`, every field given."""

    def octets(self, data: bytes) -> Any:
        """The value of a uint8[] field."""

    def doubles(self, values: Iterable[float]) -> Any:
        """The value of a float64[] field."""


class BagMessages:
    """Messages of rosbags' Jazzy types."""

    def make(self, kind: str, /, **fields: Any) -> Any:
        """A message of a type such as `geometry_msgs/msg/Point`, every field given."""
        return TYPESTORE.types[kind](**fields)

    def octets(self, data: bytes) -> Any:
        """The value of a uint8[] field."""
        return np.frombuffer(data, dtype=np.uint8)

    def doubles(self, values: Iterable[float]) -> Any:
        """The value of a float64[] field."""
        return np.array(list(values), dtype=np.float64)


BAG_MESSAGES = BagMessages()


def header(factory: MessageFactory, stamp: int, frame_id: str) -> Any:
    """A std_msgs/Header at a stamp [ns].

    Raises:
        InputError: ROS cannot say this time; its seconds have 32 bits.
    """
    seconds, nanoseconds = divmod(int(stamp), NANOSECONDS)
    if not 0 <= seconds <= LAST_SECOND:
        raise InputError(f"{seconds} s is no time that a ROS message can carry")
    time = factory.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return factory.make("std_msgs/msg/Header", stamp=time, frame_id=frame_id)


def _vector(factory: MessageFactory, kind: str, xyz: Sequence[float] | FloatArray) -> Any:
    x, y, z = (float(v) for v in xyz)
    return factory.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _quaternion(factory: MessageFactory, xyzw: Sequence[float] | FloatArray) -> Any:
    x, y, z, w = (float(v) for v in xyzw)
    return factory.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def spline_message(
    factory: MessageFactory, stamp: int, frame_id: str, control_points: FloatArray
) -> Any:
    """geometry_msgs/PoseArray of control points x, y, z [m] (and theta [rad]), shape (n, 3 or 4).

    Raises:
        InputError: a number that is not finite, or another shape.
    """
    values = np.asarray(control_points, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] not in (3, 4) or not np.all(np.isfinite(values)):
        raise InputError(f"a spline of shape {values.shape} is not finite or no (n, 4) array")
    theta = values[:, 3] if values.shape[1] == 4 else np.zeros(len(values))
    poses = [
        factory.make(
            "geometry_msgs/msg/Pose",
            position=_vector(factory, "Point", row[:3]),
            orientation=_quaternion(factory, (math.sin(t / 2.0), 0.0, 0.0, math.cos(t / 2.0))),
        )
        for row, t in zip(values, theta, strict=True)
    ]
    return factory.make(
        "geometry_msgs/msg/PoseArray", header=header(factory, stamp, frame_id), poses=poses
    )


def points_message(
    factory: MessageFactory, stamp: int, frame_id: str, points: CentrelinePoints
) -> Any:
    """sensor_msgs/PointCloud2 with the fields x, y, z, u, std of measured points.

    Where u is uncertain there is one more, std_along.

    Raises:
        InputError: a number that is not finite.
    """
    columns, names = [points.positions, points.u, points.std], list(POINT_FIELDS)
    if points.std_along is not None:
        columns.append(points.std_along)
        names.append(STD_ALONG)
    return cloud_message(factory, stamp, frame_id, names, np.column_stack(columns))


def observation_messages(frame_id: str, observation: Observation) -> list[tuple[str, Any]]:
    """Messages of a bag, with their topics, of an observed spline; its points go first.

    Raises:
        InputError: a number is not finite.
    """
    stamp, result = observation.stamp, []
    if observation.points is not None:
        cloud = points_message(BAG_MESSAGES, stamp, frame_id, observation.points)
        result.append((topics.OBSERVED_POINTS, cloud))
    spline = spline_message(BAG_MESSAGES, stamp, frame_id, observation.control_points)
    return [*result, (topics.OBSERVED, spline)]


def cloud_message(
    factory: MessageFactory, stamp: int, frame_id: str, names: Sequence[str], table: FloatArray
) -> Any:
    """sensor_msgs/PointCloud2 of float fields.

    Args:
        factory: function that makes the message.
        stamp: [ns].
        frame_id: frame of the points.
        names: names of the fields.
        table: values of the fields, shape (points, names).

    Raises:
        InputError: a number that is not finite.
    """
    values = np.asarray(table).astype("<f4")
    if not np.all(np.isfinite(values)):
        raise InputError("a measured point is not finite")
    fields = [
        factory.make(
            "sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=FLOAT32, count=1
        )
        for i, name in enumerate(names)
    ]
    return factory.make(
        "sensor_msgs/msg/PointCloud2",
        header=header(factory, stamp, frame_id),
        height=1,
        width=len(values),
        fields=fields,
        is_bigendian=False,
        point_step=4 * len(fields),
        row_step=4 * len(fields) * len(values),
        data=factory.octets(values.tobytes()),
        is_dense=True,
    )


def float_message(factory: MessageFactory, value: float) -> Any:
    """std_msgs/Float64.

    Raises:
        InputError: the number is not finite.
    """
    if not math.isfinite(value):
        raise InputError(f"{value} is not finite")
    return factory.make("std_msgs/msg/Float64", data=float(value))


def wrench_message(
    factory: MessageFactory, stamp: int, frame_id: str, force: FloatArray, torque: FloatArray
) -> Any:
    """geometry_msgs/WrenchStamped of a force [N] and a torque [N m], shape (3,) each.

    Raises:
        InputError: a number is not finite.
    """
    if not (np.all(np.isfinite(force)) and np.all(np.isfinite(torque))):
        raise InputError("a force or a torque is not finite")
    wrench = factory.make(
        "geometry_msgs/msg/Wrench",
        force=_vector(factory, "Vector3", force),
        torque=_vector(factory, "Vector3", torque),
    )
    return factory.make(
        "geometry_msgs/msg/WrenchStamped", header=header(factory, stamp, frame_id), wrench=wrench
    )


def load_messages(
    factory: MessageFactory,
    stamp: int,
    frame_id: str,
    *,
    tension: float,
    bend_radius: float,
    wrenches: Sequence[tuple[FloatArray, FloatArray] | None],
) -> dict[str, Any]:
    """Loads of a DLO and its grips as messages by topic.

    Args:
        tension: largest [N].
        bend_radius: smallest [m].
        wrenches: force [N] and torque [N m] of the grips at start and end; None: that end is free.

    Raises:
        InputError: a number is not finite.
    """
    result = {
        topics.TENSION: float_message(factory, tension),
        topics.MIN_BEND_RADIUS: float_message(factory, bend_radius),
    }
    for topic, wrench in zip((topics.FORCE_START, topics.FORCE_END), wrenches, strict=True):
        if wrench is not None:
            result[topic] = wrench_message(factory, stamp, frame_id, *wrench)
    return result


def metric_message(
    factory: MessageFactory,
    source: str,
    name: str,
    unit: str,
    stamp: int,
    *,
    average: float,
    std: float | None = None,
    maximum: float | None = None,
) -> Any:
    """statistics_msgs/MetricsMessage of a quantity that belongs to one instant.

    Args:
        factory: function that makes the message.
        source: name of the node that has measured it.
        name: name of the quantity, such as `young_modulus`.
        unit: SI unit of its numbers.
        stamp: start and end of the window [ns].
        average: value of the quantity.
        std: standard deviation of the quantity; None where it is unknown or unbounded, and left
            out.
        maximum: largest value of the quantity; None where it has none, and left out.

    Raises:
        InputError: a number is not finite.
    """
    numbers = ((AVERAGE, average), (STANDARD_DEVIATION, std), (MAXIMUM, maximum))
    given = [(kind, number) for kind, number in numbers if number is not None]
    for _, number in given:
        if not math.isfinite(number):
            raise InputError(f"{number} is not finite")
    time = header(factory, stamp, "").stamp
    points = [
        factory.make("statistics_msgs/msg/StatisticDataPoint", data_type=kind, data=float(number))
        for kind, number in given
    ]
    return factory.make(
        "statistics_msgs/msg/MetricsMessage",
        measurement_source_name=source,
        metrics_source=name,
        unit=unit,
        window_start=time,
        window_stop=time,
        statistics=points,
    )


def transform_message(
    factory: MessageFactory,
    stamp: int,
    parent: str,
    child: str,
    translation: Sequence[float],
    rotation: Sequence[float],
) -> Any:
    """tf2_msgs/TFMessage of one transform: the pose of a frame in its parent.

    Args:
        factory: function that makes the message.
        stamp: [ns].
        parent: frame in which the pose is given.
        child: frame whose pose it is.
        translation: origin of the child, x y z [m].
        rotation: quaternion x y z w, normalised here.

    Raises:
        InputError: a number that is not finite, or a frame that has no name or is its own parent.
    """
    numbers = np.array([*translation, *rotation], dtype=np.float64)
    norm = float(np.linalg.norm(numbers[3:]))
    if not np.all(np.isfinite(numbers)) or norm == 0.0:
        raise InputError(f"the pose {numbers.tolist()} of {child} is none")
    if not parent or not child or parent == child:
        raise InputError(f"a transform needs two frames; these are '{parent}' and '{child}'")
    transform = factory.make(
        "geometry_msgs/msg/Transform",
        translation=_vector(factory, "Vector3", numbers[:3]),
        rotation=_quaternion(factory, numbers[3:] / norm),
    )
    stamped = factory.make(
        "geometry_msgs/msg/TransformStamped",
        header=header(factory, stamp, parent),
        child_frame_id=child,
        transform=transform,
    )
    return factory.make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def command_message(factory: MessageFactory, command: Command) -> Any:
    """trajectory_msgs/MultiDOFJointTrajectory of an imposed motion."""
    zero = _vector(factory, "Vector3", (0.0, 0.0, 0.0))
    points = []
    for i, time in enumerate(command.times):
        nanoseconds = round(float(time) * NANOSECONDS)
        transforms = [
            factory.make(
                "geometry_msgs/msg/Transform",
                translation=_vector(factory, "Vector3", command.positions[i, k]),
                rotation=_quaternion(factory, command.rotations[i, k]),
            )
            for k in range(len(command.names))
        ]
        twists = []
        if np.all(np.isfinite(command.velocities[i])):
            twists = [
                factory.make(
                    "geometry_msgs/msg/Twist",
                    linear=_vector(factory, "Vector3", velocity),
                    angular=zero,
                )
                for velocity in command.velocities[i]
            ]
        points.append(
            factory.make(
                "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
                transforms=transforms,
                velocities=twists,
                accelerations=[],
                time_from_start=factory.make(
                    "builtin_interfaces/msg/Duration",
                    sec=nanoseconds // NANOSECONDS,
                    nanosec=nanoseconds % NANOSECONDS,
                ),
            )
        )
    return factory.make(
        "trajectory_msgs/msg/MultiDOFJointTrajectory",
        header=header(factory, command.stamp, command.frame_id),
        joint_names=list(command.names),
        points=points,
    )
