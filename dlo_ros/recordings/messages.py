# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Conversion of messages to the package's dataclasses.

Messages are read by attribute alone, so those of a bag (rosbags) and those of rclpy serve alike.
Nothing in a message is trusted: a malformed one raises an error that says what is wrong and where.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from dlo_ros.command import NANOSECONDS, Command, check_names
from dlo_ros.errors import CommandError, InputError
from dlo_ros.observation import CentrelinePoints, Observation, PointList
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

MAX_TRANSFORMS = 2_000_000
"""Longer commands are refused: two clamps at 100 Hz for almost three hours."""

MAX_POINTS = 1_000_000
"""Larger clouds are refused; a centreline has some thousand points."""

MAX_POINT_STEP = 4096
"""Bytes of a point; the five numbers that are read need forty at most."""

LEAST_STD = 1e-6
"""Standard deviation [m] that measured points have at least: nobody measures better, and a mistaken
one would outweigh all others."""

MAX_DISTANCE = 1e4
"""Positions further than this [m] from the origin are garbage, not a DLO on a board."""

FLOAT_TYPES = {7: "f4", 8: "f8"}
"""sensor_msgs/PointField datatypes FLOAT32 and FLOAT64."""


MOST_STRETCH = 3.0
"""An observed shape so many times longer or shorter than the DLO shows something else."""

LEAST_SPEED = 1e-3
"""Least |dr/du| of an observed shape; that of a DLO is close to 1."""


def stamp_of(message: Any) -> int:
    """Stamp of a message's header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def array(values: Any, what: str, size: int | None = None) -> FloatArray:
    """Finite numbers as a new array.

    Raises:
        InputError: not `size` numbers, or one that is not finite.
    """
    result = np.array(values, dtype=np.float64).ravel()
    if size is not None and result.size != size:
        raise InputError(f"{what} has {result.size} numbers; {size} are needed")
    if not np.all(np.isfinite(result)):
        raise InputError(f"{what} holds a number that is not finite (NaN or infinite)")
    return result


def read_command(message: Any, settings: Settings, received: int) -> Command:
    """The motion that a trajectory_msgs/MultiDOFJointTrajectory imposes.

    Args:
        received: moment of receipt [ns]; the start of the trajectory where its stamp is zero.

    Raises:
        CommandError: it is malformed, and refused whole.
    """
    n = settings.rod.control_points
    frame, names = str(message.header.frame_id), tuple(str(name) for name in message.joint_names)
    if frame != settings.frame_id:
        raise CommandError(
            f"dlo/command is in frame '{frame[:60]}'; frame_id is '{settings.frame_id}'"
        )
    if len(names) > n:
        raise CommandError(f"dlo/command has {len(names)} names; the DLO has {n} control points")
    check_names(names, n)
    count, points = len(names), message.points
    if len(points) * count > MAX_TRANSFORMS:
        raise CommandError(
            f"dlo/command has {len(points)} points of {count} names; "
            f"at most {MAX_TRANSFORMS} transforms are taken"
        )
    times = np.empty(len(points))
    positions = np.empty((len(points), count, 3))
    rotations = np.empty((len(points), count, 4))
    velocities = np.full((len(points), count, 3), np.nan)
    for i, point in enumerate(points):
        after = point.time_from_start
        times[i] = after.sec + after.nanosec / NANOSECONDS
        transforms, twists = point.transforms, point.velocities
        if len(transforms) != count:
            raise CommandError(
                f"dlo/command: point {i} has {len(transforms)} transforms for {count} names"
            )
        if len(twists) not in (0, count):
            raise CommandError(
                f"dlo/command: point {i} has {len(twists)} velocities for {count} names; "
                "give one each, or none"
            )
        for k, transform in enumerate(transforms):
            p, r = transform.translation, transform.rotation
            positions[i, k] = p.x, p.y, p.z
            rotations[i, k] = r.x, r.y, r.z, r.w
        for k, twist in enumerate(twists):
            v, w = twist.linear, twist.angular
            velocities[i, k] = v.x, v.y, v.z
            if not math.isfinite(v.x + v.y + v.z + w.x + w.y + w.z):
                raise CommandError(f"dlo/command: velocity {k} of point {i} is not finite")
    if not np.all(np.isfinite(rotations)):
        raise CommandError("dlo/command has a rotation that is not finite (NaN or infinite)")
    # NaN is left to Command, whose message names it.
    if np.any(np.abs(positions) > MAX_DISTANCE):
        raise CommandError(
            f"dlo/command has a position more than {MAX_DISTANCE:g} m away; positions are in metres"
        )
    return Command(
        stamp=stamp_of(message) or received,
        names=names,
        times=times,
        positions=positions,
        rotations=rotations,
        velocities=velocities,
        control_points=n,
        frame_id=frame,
    )


def read_spline(message: Any, settings: Settings, what: str = "dlo/observed") -> FloatArray:
    """Control points x, y, z [m] and theta [rad] of a geometry_msgs/PoseArray, shape (n, 4).

    Theta is unwrapped along u.

    Raises:
        InputError: wrong frame, wrong number of poses, not finite, or no twist quaternion.
    """
    n, frame = settings.rod.control_points, str(message.header.frame_id)
    if frame != settings.frame_id:
        raise InputError(f"{what} is in frame '{frame[:60]}'; frame_id is '{settings.frame_id}'")
    poses = message.poses
    if len(poses) != n:
        raise InputError(f"{what} has {len(poses)} poses; rod.control_points is {n}")
    values = np.empty((n, 7))
    for i, pose in enumerate(poses):
        p, r = pose.position, pose.orientation
        values[i] = p.x, p.y, p.z, r.x, r.y, r.z, r.w
    if not np.all(np.isfinite(values)):
        raise InputError(f"{what} holds a number that is not finite (NaN or infinite)")
    if np.any(np.abs(values[:, :3]) > MAX_DISTANCE):
        raise InputError(f"{what} has a control point more than {MAX_DISTANCE:g} m away")
    x, y, z, w = values[:, 3:].T
    if np.any(np.abs(np.hypot(x, w) - 1.0) > 0.1) or np.any(np.hypot(y, z) > 0.1):
        raise InputError(f"{what} has an orientation that is no rotation about x by the twist")
    theta = np.unwrap(2.0 * np.arctan2(x, w))
    return np.column_stack([values[:, :3], theta])


def unwrap_in_time(theta: FloatArray, previous: FloatArray) -> FloatArray:
    """The twist angles [rad] that differ from theta by full turns and lie closest to `previous`."""
    turns = np.round((previous - theta) / (2.0 * np.pi))
    return np.asarray(theta + 2.0 * np.pi * turns)


def read_points(message: Any, settings: Settings) -> CentrelinePoints:
    """Measured points of a sensor_msgs/PointCloud2 with fields x, y, z, u, std (and std_along).

    Points that are not finite are left out, as `is_dense` false announces them; a std below
    `LEAST_STD` is taken as that.

    Raises:
        InputError: wrong frame, fields missing, sizes that contradict each other, no usable point.
    """
    what = "dlo/observed_points"
    frame = str(message.header.frame_id)
    if frame != settings.frame_id:
        raise InputError(f"{what} is in frame '{frame[:60]}'; frame_id is '{settings.frame_id}'")
    names, table = cloud_table(message, what, ("x", "y", "z", "u", "std"), ("std_along",))
    table = table[np.all(np.isfinite(table), axis=1)]
    length = settings.rod.length
    # u is a float32, so that the DLO's end may lie beyond it by rounding.
    inside = (table[:, 3] >= -1e-6 * length) & (table[:, 3] <= length * (1.0 + 1e-6))
    near = np.all(np.abs(table[:, :3]) <= MAX_DISTANCE, axis=1)
    table = table[inside & near & np.all(table[:, 4:] > 0.0, axis=1)]
    if not len(table):
        raise InputError(
            f"{what} has no usable point: finite, u within 0 to {length:g} m, std positive"
        )
    return CentrelinePoints(
        positions=table[:, :3].copy(),
        u=np.clip(table[:, 3], 0.0, length),
        std=np.maximum(table[:, 4], LEAST_STD),
        std_along=table[:, 5].copy() if "std_along" in names else None,
    )


def read_point_list(message: Any) -> PointList:
    """Points of another tracker, of a sensor_msgs/PointCloud2 with x, y, z (and u, std).

    They are in the message's own frame. Points that are not finite are left out.

    Raises:
        InputError: fields missing, sizes that contradict each other, no usable point.
    """
    what = "dlo/points"
    names, table = cloud_table(message, what, ("x", "y", "z"), ("u", "std"))
    usable = np.all(np.isfinite(table), axis=1)
    usable &= np.all(np.abs(table[:, :3]) <= MAX_DISTANCE, axis=1)
    columns = {name: table[:, k] for k, name in enumerate(names)}
    if "std" in columns:
        usable &= columns["std"] > 0.0
    if not usable.any():
        raise InputError(
            f"{what} has no usable point: finite, in metres, std positive where it is given"
        )
    optional = {name: columns[name][usable].copy() for name in ("u", "std") if name in columns}
    return PointList(
        stamp_of(message), table[usable, :3].copy(), optional.get("u"), optional.get("std")
    )


def cloud_table(
    message: Any, what: str, needed: tuple[str, ...], optional: tuple[str, ...]
) -> tuple[tuple[str, ...], FloatArray]:
    """Float fields of a sensor_msgs/PointCloud2.

    Args:
        message: the cloud.
        what: name of the topic, for error messages.
        needed, optional: names of fields.

    Returns:
        The needed fields' names and those of the optional ones that it has, and their numbers,
        shape (points, names).

    Raises:
        InputError: a needed field is missing, or sizes contradict each other.
    """
    width, height = int(message.width), int(message.height)
    step, row_step = int(message.point_step), int(message.row_step)
    if width * height > MAX_POINTS:
        raise InputError(f"{what} has {width * height} points; at most {MAX_POINTS} are taken")
    if not 0 < step <= MAX_POINT_STEP:
        raise InputError(f"{what} has point_step {step}; at most {MAX_POINT_STEP} bytes are taken")
    order = ">" if message.is_bigendian else "<"
    offsets: dict[str, tuple[int, str]] = {}
    for field in message.fields[:64]:
        code = FLOAT_TYPES.get(int(field.datatype))
        if code is not None and 0 <= int(field.offset) <= step - int(code[1]):
            offsets.setdefault(str(field.name), (int(field.offset), order + code))
    missing = [name for name in needed if name not in offsets]
    if missing:
        raise InputError(
            f"{what} lacks the float field {missing[0]}; {', '.join(needed[:-1])} and {needed[-1]} "
            "are needed"
        )
    names = needed + tuple(name for name in optional if name in offsets)
    data = np.frombuffer(message.data, dtype=np.uint8)
    if height > 1 and row_step < width * step:
        raise InputError(f"{what} has row_step {row_step}; {width} points of {step} need more")
    rows = width * step if height <= 1 else row_step
    if data.size < rows * height:
        raise InputError(
            f"{what} has {data.size} bytes; {width} x {height} points need {rows * height}"
        )
    kind = np.dtype(
        {
            "names": names,
            "formats": [offsets[name][1] for name in names],
            "offsets": [offsets[name][0] for name in names],
            "itemsize": step,
        }
    )
    block = data[: rows * height].reshape(height, rows)[:, : width * step]
    cloud = np.ascontiguousarray(block).reshape(-1).view(kind)
    with np.errstate(invalid="ignore"):  # some NaN signal, and no NaN is used
        return names, np.column_stack([cloud[name].astype(np.float64) for name in names])


def read_observation(message: Any, settings: Settings, points: Any | None = None) -> Observation:
    """An observed spline, with the points behind it where there is a cloud.

    Raises:
        InputError: one of the messages is malformed, or the shape is that of no such DLO: much too
            long or short, or with a place that has no direction.
    """
    control_points = read_spline(message, settings)
    u, tangents = _tangents(settings.rod.control_points, settings.rod.length)
    speed = np.linalg.norm(tangents @ control_points[:, :3], axis=1)
    if speed.min() < LEAST_SPEED:
        raise InputError(
            f"dlo/observed has control points that coincide at u = {u[speed.argmin()]:.3g} m; "
            "it has no direction there"
        )
    stretch = float(speed.mean())
    if not 1.0 / MOST_STRETCH < stretch < MOST_STRETCH:
        length = settings.rod.length
        raise InputError(
            f"dlo/observed is {stretch * length:.3g} m long; rod.length is {length:g} m"
        )
    return Observation(
        stamp=stamp_of(message),
        control_points=control_points,
        points=None if points is None else read_points(points, settings),
    )


@lru_cache(maxsize=8)
def _tangents(control_points: int, length: float) -> tuple[FloatArray, FloatArray]:
    """Places along the DLO [m], shape (m,), and the matrix that gives dr/du there."""
    basis = SplineBasis(control_points, length)
    u = np.linspace(0.0, length, 4 * basis.spans + 1)
    return u, basis.matrix(u, 1)
