# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A robot's hand holds the DLO at another place than its frame says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, START, Command
from dlo_ros.effects.base import Effect, Scene, Start, quantity
from dlo_ros.effects.start import Block
from dlo_ros.spline import FloatArray

AXES = (2, 3)
NORMAL = (0.0, 1.0, 0.0)  # of the board's plane
ALONG_DLO = (("towards the end", "towards the start"), ("", ""), ("", ""))
"""Words for the clamp's x axis, which points along growing u; nobody has words for the others."""
TOLERANCE = 0.005  # of the length, to which a grip's place in the hand is measured
TURN = 0.1  # [rad] of a clamp between two points, whose arc and chord differ by 1.3e-3 of an offset


@dataclass(frozen=True)
class GripOffset(Effect):
    """True minus stated place of the DLO in the hands that hold it; it turns with them.

    Geometry, no source: true position = commanded position + R d [m], with the commanded rotation R
    of the clamp. Three numbers are d in the clamp's own x, y and z axes; two are along the DLO and
    across it in the board's plane, which are x and z of a clamp whose y axis is the board's. It
    acts on `start` and `end`; directions stay. With 0 the command is true. Where a clamp does not
    turn this is a `clamp_offset`.
    """

    name: ClassVar[str] = "grip_offset"
    title: ClassVar[str] = "place of a grip in the hand"
    phrase: ClassVar[str] = "a hand holds the DLO at another place than its frame says"
    remedy: ClassVar[str] = (
        "Grip the DLO at the stated place, or correct the hand's frame (command.start_offset, "
        "command.end_offset)."
    )
    group: ClassVar[str] = "clamps"
    in_setup: ClassVar[bool] = True
    of_commanded_frames: ClassVar[bool] = True

    start: tuple[float, ...] = quantity(
        0.0, "m", -1.0, 1.0, "at the start: x, z, or x, y, z of the clamp", counts=AXES,
        tolerance=TOLERANCE, sides=ALONG_DLO,
    )  # fmt: skip
    end: tuple[float, ...] = quantity(
        0.0, "m", -1.0, 1.0, "at the end: x, z, or x, y, z of the clamp", counts=AXES,
        tolerance=TOLERANCE, sides=ALONG_DLO,
    )  # fmt: skip

    def impose(self, command: Command) -> Command:
        """See the base class."""
        command = command.turning_at_most(TURN)
        positions, velocities = command.positions.copy(), command.velocities.copy()
        for offset, clamp in ((self.start, START), (self.end, END)):
            if clamp not in command.names:
                continue
            k = command.names.index(clamp)
            arm = _in_board(offset, command.rotations[:, k])
            positions[:, k] += arm
            velocities[:, k] += _slower(arm, command.times)
        return replace(command, positions=positions, velocities=velocities)

    @classmethod
    def setup(cls, scene: Scene) -> Block:
        """See the base class; of a command that is no robot's the clamps themselves are stated."""
        ends = scene.clamps if scene.in_hands else ()
        return dict.fromkeys(ends, (0.0,) * AXES[scene.spatial])

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Nowhere, as an offset of a clamp: every robot has some of it."""
        return []


def _in_board(offset: tuple[float, ...], rotations: FloatArray) -> FloatArray:
    """The offset in the board's frame.

    Args:
        offset: two or three numbers [m].
        rotations: the clamp's quaternions x y z w, shape (T, 4).

    Returns:
        [m], shape (T, 3).
    """
    axes = Rotation.from_quat(rotations).as_matrix()  # (T, 3, 3)
    if len(offset) == AXES[0]:
        along = axes[:, :, 0]
        return np.asarray(offset[0] * along + offset[1] * np.cross(along, NORMAL))
    return np.asarray(axes @ np.array(offset))


def _slower(places: FloatArray, times: FloatArray) -> FloatArray:
    """Velocity at each point, of the two intervals beside it that in which less moves.

    A commanded turn begins and ends at once, and where nothing turns nothing may move.

    Args:
        places: [m], shape (T, 3).
        times: [s], shape (T,).

    Returns:
        [m/s], shape (T, 3).
    """
    if len(times) == 1:
        return np.zeros_like(places)
    speeds = np.diff(places, axis=0) / np.diff(times)[:, None]
    before, after = np.vstack([speeds[:1], speeds]), np.vstack([speeds, speeds[-1:]])
    slower = np.linalg.norm(after, axis=1) < np.linalg.norm(before, axis=1)
    return np.where(slower[:, None], after, before)
