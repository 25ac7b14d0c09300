# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Positions and directions of the DLO's ends in space, from the imposed motion."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import CONTROL_POINT, END, START, Command, Motion
from dlo_ros.spline import FloatArray
from dlo_ros.vision.expected_shape import traced_backwards
from dlo_ros.vision.space.reprojection import ClampPose

Clamps = tuple[ClampPose | None, ClampPose | None]


def clamps_at(motion: Motion | None, stamp: int) -> Clamps:
    """The ends that a motion imposes at a stamp [ns]; None where an end is free.

    `start` and `end` give position and direction; `control_point_1` and `control_point_n` the
    position, with their neighbour the direction too.
    """
    command = motion.at(stamp) if motion is not None else None
    if command is None:
        return None, None
    n = command.control_points
    positions, rotations = command.sample(stamp)
    return (
        _clamp(command, positions, rotations, START, (1, 2)),
        _clamp(command, positions, rotations, END, (n, n - 1)),
    )


def _clamp(
    command: Command,
    positions: FloatArray,
    rotations: FloatArray,
    name: str,
    numbers: tuple[int, int],
) -> ClampPose | None:
    known = {given: k for k, given in enumerate(command.names)}
    if name in known:
        k = known[name]
        return ClampPose(positions[k], Rotation.from_quat(rotations[k]).as_matrix()[:, 0])
    outer, inner = (known.get(f"{CONTROL_POINT}{number}") for number in numbers)
    if outer is None:
        return None
    if inner is None:
        return ClampPose(positions[outer], None)
    towards = positions[inner] - positions[outer]
    if name == END:
        towards = -towards
    norm = float(np.linalg.norm(towards))
    return ClampPose(positions[outer], towards / norm if norm > 0.0 else None)


def from_start(
    points: FloatArray, start: FloatArray | None, end: FloatArray | None, diameter: float
) -> FloatArray:
    """Points of a shape from the DLO's start to its end [m], shape (m, 3).

    Args:
        points: the same in either order [m], shape (m, 3).
        start, end: about where the ends are [m], shape (3,); None: unknown. Where both are, the
            start is the end of the smaller x, or z where x agrees to a diameter.
        diameter: diameter of the DLO [m].
    """
    turned = traced_backwards(points[[0, -1]], (start, end), diameter)
    return points[::-1] if turned else points
