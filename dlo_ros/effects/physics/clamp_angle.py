# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A clamp holds the DLO in another direction than commanded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from scipy.spatial.transform import Rotation

from dlo_ros.command import CONTROL_POINT, END, START, Command
from dlo_ros.effects.base import Effect, Scene, Start, quantity
from dlo_ros.effects.quantity import ABOUT_AXES
from dlo_ros.effects.start import TURNS, Block, at_clamps, rotation_vector, turned

TOLERANCE = math.radians(3.0)  # [rad] to which a clamp is lined up by eye


@dataclass(frozen=True)
class ClampAngle(Effect):
    """True minus commanded direction of the DLO in its clamps, positive from x towards -z.

    Geometry, no source: true angle = commanded angle + value [rad]. Three numbers are a rotation
    vector about the board's x, y and z. The ends stay where they are commanded. It acts on `start`
    and `end`, and on second control points that give a direction; an end whose direction is free
    has no clamp. With 0 the command is true.
    """

    name: ClassVar[str] = "clamp_angle"
    title: ClassVar[str] = "direction of a clamp"
    phrase: ClassVar[str] = "a clamp points in another direction than the command says"
    remedy: ClassVar[str] = (
        "Turn the clamp back by as much, or correct its direction in the command."
    )
    group: ClassVar[str] = "clamps"
    in_setup: ClassVar[bool] = True

    start: float | tuple[float, ...] = quantity(
        0.0, "rad", -1.6, 1.6, "at the start: about y, or about x, y, z", counts=TURNS,
        tolerance=TOLERANCE, sides=ABOUT_AXES,
    )  # fmt: skip
    end: float | tuple[float, ...] = quantity(
        0.0, "rad", -1.6, 1.6, "at the end: about y, or about x, y, z", counts=TURNS,
        tolerance=TOLERANCE, sides=ABOUT_AXES,
    )  # fmt: skip

    def impose(self, command: Command) -> Command:
        """See the base class."""
        positions, rotations = command.positions.copy(), command.rotations.copy()
        last = command.control_points
        ends = (
            (self.start, START, f"{CONTROL_POINT}1", f"{CONTROL_POINT}2"),
            (self.end, END, f"{CONTROL_POINT}{last}", f"{CONTROL_POINT}{last - 1}"),
        )
        for angle, clamp, tip, second in ends:
            if clamp not in command.names and second not in command.names:
                continue
            turn = Rotation.from_rotvec(rotation_vector(angle))
            for k, name in enumerate(command.names):
                if name == clamp:
                    rotations[:, k] = turned(turn, rotations[:, k])
                elif name == second:
                    outer = positions[:, command.names.index(tip)]
                    positions[:, k] = outer + turn.apply(positions[:, k] - outer)
        return command.led_through(positions=positions, rotations=rotations)

    @classmethod
    def setup(cls, scene: Scene) -> Block:
        """See the base class; an end that is free has no clamp."""
        return dict.fromkeys(scene.clamps, (0.0,) * TURNS[1] if scene.spatial else 0.0)

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Each clamp alone, and both."""
        return at_clamps(cls.name, scene, (0.0,) * TURNS[1] if scene.spatial else 0.0)
