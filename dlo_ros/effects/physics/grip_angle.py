# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A robot's hand holds the DLO in another direction than its frame says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from scipy.spatial.transform import Rotation

from dlo_ros.command import END, START, Command
from dlo_ros.effects.base import Effect, Scene, Start, quantity
from dlo_ros.effects.physics.clamp_angle import TOLERANCE
from dlo_ros.effects.start import Block

AXES = "yz"
NO_WORDS = (("", ""),)


@dataclass(frozen=True)
class GripAngle(Effect):
    """True minus stated direction of the DLO in the hands that hold it; it turns with them.

    Geometry, no source: true rotation = R exp(value), with the commanded rotation R of the clamp
    and a rotation vector about the clamp's own y and z axes [rad]. A constant turn about x, the
    DLO, changes nothing, since the DLO is free of twist in its first shape. The ends stay where
    they are commanded. It acts on `start` and `end`. With 0 the command is true. Where a clamp does
    not turn, or turns in the board's plane alone, this is a `clamp_angle`.
    """

    name: ClassVar[str] = "grip_angle"
    title: ClassVar[str] = "direction of a grip in the hand"
    phrase: ClassVar[str] = "a hand holds the DLO in another direction than its frame says"
    remedy: ClassVar[str] = (
        "Line the DLO up in the hand, or correct the hand's frame (command.start_offset, "
        "command.end_offset)."
    )
    group: ClassVar[str] = "clamps"
    in_setup: ClassVar[bool] = True

    start: tuple[float, ...] = quantity(
        0.0, "rad", -1.6, 1.6, "at the start: about y, z of the clamp", counts=(len(AXES),),
        tolerance=TOLERANCE, spatial=True, sides=NO_WORDS, axes=AXES,
    )  # fmt: skip
    end: tuple[float, ...] = quantity(
        0.0, "rad", -1.6, 1.6, "at the end: about y, z of the clamp", counts=(len(AXES),),
        tolerance=TOLERANCE, spatial=True, sides=NO_WORDS, axes=AXES,
    )  # fmt: skip

    def impose(self, command: Command) -> Command:
        """See the base class."""
        rotations = command.rotations.copy()
        for angle, clamp in ((self.start, START), (self.end, END)):
            if clamp in command.names:
                k = command.names.index(clamp)
                turned = Rotation.from_quat(rotations[:, k]) * Rotation.from_rotvec((0.0, *angle))
                rotations[:, k] = turned.as_quat()
        return command.led_through(rotations=rotations)

    @classmethod
    def setup(cls, scene: Scene) -> Block:
        """See the base class; in the plane it is what the clamps themselves have."""
        ends = scene.clamps if scene.in_hands and scene.spatial else ()
        return dict.fromkeys(ends, (0.0,) * len(AXES))

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Nowhere, as an offset in the hand: every robot has some of it."""
        return []
