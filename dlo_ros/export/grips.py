# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Grips: which ends a command holds, how, and where they are at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import CONTROL_POINT, END, START, Command
from dlo_ros.spline import FloatArray

Kind = Literal["clamp", "tip"]
"""`clamp`: position and direction are held; `tip`: the position alone."""
NORMAL = np.array([0.0, 1.0, 0.0])  # of the board, to which clamps' y axes are turned


@dataclass(frozen=True)
class Pose:
    """A position [m], shape (3,), and an orientation; x points along growing u."""

    position: FloatArray
    rotation: Rotation

    def __matmul__(self, other: Pose) -> Pose:
        """A pose given in this one."""
        moved = self.position + self.rotation.apply(other.position)
        return Pose(np.asarray(moved), self.rotation * other.rotation)

    def inverse(self) -> Pose:
        """The pose of the outer frame in this one."""
        back = self.rotation.inv()
        return Pose(np.asarray(-back.apply(self.position)), back)

    @property
    def quaternion(self) -> FloatArray:
        """Unit quaternion w x y z, w not negative, shape (4,)."""
        x, y, z, w = self.rotation.as_quat()
        result = np.array([w, x, y, z])
        return result if w >= 0.0 else -result


@dataclass(frozen=True)
class Grip:
    """One held end of the cable.

    Args:
        end: "start" or "end".
        kind: the degrees of freedom that are held, see `Kind`.
        commanded: pose of the grip when the motion begins.
        offset: pose of the cable's end in the grip: the set-up's error, and the roll with which the
            grip took the cable.
    """

    end: str
    kind: Kind
    commanded: Pose
    offset: Pose


def kind_of(command: Command, end: str) -> Kind | None:
    """Kind of grip with which a command holds an end; None: it is free."""
    last = command.control_points
    tip, second = (1, 2) if end == START else (last, last - 1)
    if end in command.names or {f"{CONTROL_POINT}{tip}", f"{CONTROL_POINT}{second}"} <= set(
        command.names
    ):
        return "clamp"
    return "tip" if f"{CONTROL_POINT}{tip}" in command.names else None


def pose_at(command: Command, end: str, stamp: int) -> Pose:
    """Pose at which a command holds an end at a stamp [ns]; it must hold it.

    Of an end that is imposed by two control points, x is the line from one to the other and y is as
    near the board's normal as it can be; of a tip alone the orientation is that of the board.
    """
    position, rotation = command.sample(stamp)
    if end in command.names:
        k = command.names.index(end)
        return Pose(position[k], Rotation.from_quat(rotation[k]))
    last = command.control_points
    tip, second, sign = (1, 2, 1.0) if end == START else (last, last - 1, -1.0)
    at = position[command.names.index(f"{CONTROL_POINT}{tip}")]
    if kind_of(command, end) == "tip":
        return Pose(at, Rotation.identity())
    along = sign * (position[command.names.index(f"{CONTROL_POINT}{second}")] - at)
    return Pose(at, frame(along))


def frame(along: FloatArray) -> Rotation:
    """An orientation with x along a direction and y as near the board's normal as it can be."""
    x = along / np.linalg.norm(along)
    y = NORMAL - (NORMAL @ x) * x
    if np.linalg.norm(y) < 1e-6:
        y = np.array([0.0, 0.0, 1.0]) - x[2] * x
    y /= np.linalg.norm(y)
    return Rotation.from_matrix(np.column_stack([x, y, np.cross(x, y)]))


def pinned(command: Command) -> tuple[str, ...]:
    """Names of the material points that a command holds between the ends."""
    last = command.control_points
    ends = {START, END, *(f"{CONTROL_POINT}{k}" for k in (1, 2, last - 1, last))}
    return tuple(name for name in command.names if name not in ends)
