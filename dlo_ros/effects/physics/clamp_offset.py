# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A clamp holds the DLO at another place than commanded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, START, Command
from dlo_ros.effects.base import Effect, Scene, Start, quantity
from dlo_ros.effects.quantity import ALONG_AXES
from dlo_ros.effects.start import Block

IN_PLANE = (0, 2)  # axes of an offset of two numbers
AXES = (2, 3)
TOLERANCE = 0.005  # of the length, to which a clamp's place is measured


@dataclass(frozen=True)
class ClampOffset(Effect):
    """True minus commanded position of the DLO in its clamps, in the board frame.

    Geometry, no source: true position = commanded position + value [m]. Two numbers are x and z,
    three are x, y and z. It acts on `start` and `end` and on the control points of an end that are
    imposed one by one; directions stay. With 0 the command is true.
    """

    name: ClassVar[str] = "clamp_offset"
    title: ClassVar[str] = "place of a clamp"
    phrase: ClassVar[str] = "a clamp is in another place than the command says"
    remedy: ClassVar[str] = "Move the clamp back by as much, or correct its place in the command."
    group: ClassVar[str] = "clamps"
    in_setup: ClassVar[bool] = True

    start: tuple[float, ...] = quantity(
        0.0, "m", -1.0, 1.0, "at the start: x, z, or x, y, z", counts=AXES, tolerance=TOLERANCE,
        sides=ALONG_AXES,
    )  # fmt: skip
    end: tuple[float, ...] = quantity(
        0.0, "m", -1.0, 1.0, "at the end: x, z, or x, y, z", counts=AXES, tolerance=TOLERANCE,
        sides=ALONG_AXES,
    )  # fmt: skip

    def impose(self, command: Command) -> Command:
        """See the base class."""
        positions = command.positions.copy()
        last = command.control_points
        for offset, clamp, own in ((self.start, START, (1, 2)), (self.end, END, (last, last - 1))):
            axes = list(IN_PLANE) if len(offset) == len(IN_PLANE) else slice(None)
            names = (clamp, *(f"{CONTROL_POINT}{k}" for k in own))
            held = [k for k, name in enumerate(command.names) if name in names]
            moved = np.zeros(3)
            moved[axes] = offset
            positions[:, held] += moved
        return command.led_through(positions=positions)

    @classmethod
    def setup(cls, scene: Scene) -> Block:
        """See the base class; an end that is free has no offset."""
        return dict.fromkeys(scene.held, (0.0,) * AXES[scene.spatial])

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Nowhere: every set-up has some of it, and it is a cause that no recording can name.

        Of a DLO with one clamp a shifted camera sees the same, and of one with two it does where
        both are off alike.
        """
        return []
