# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The board does not hang plumb: gravity is turned in its plane, in space also out of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.effects.base import Body, Effect, quantity
from dlo_ros.effects.quantity import ALONG_AXES, NORMAL, TURNED
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class GravityTilt(Effect):
    """Rotation of gravity about +y, the board's normal, positive from x towards -z.

    Geometry, no source: g (-sin angle, 0, -cos angle) [m/s^2] for the configured (0, 0, -g). In
    space also about +x, positive from y towards z: the board leans over. Both together are one
    rotation about the axis (across, angle, 0) [rad], by its length. A small tilt is a
    `constant_force` along -x of weight per length times angle. The words for its sides tell how the
    board is turned, for whoever hangs it plumb.
    """

    name: ClassVar[str] = "gravity_tilt"
    title: ClassVar[str] = "tilt of the board"
    phrase: ClassVar[str] = "the board does not hang plumb"
    remedy: ClassVar[str] = (
        "Turn the board back by as much with a level, or correct gravity in the parameter file."
    )
    group: ClassVar[str] = "surroundings"
    twins: ClassVar[frozenset[str]] = frozenset({"constant_force"})
    in_setup: ClassVar[bool] = True

    angle: float = quantity(
        0.0, "rad", -3.2, 3.2,
        "rotation of gravity in the board's plane: the board itself is turned the other way",
        tolerance=math.radians(1.0), sides=(TURNED[::-1],),
    )  # fmt: skip

    across: float = quantity(
        0.0, "rad", -3.2, 3.2, "rotation of gravity out of that plane",
        tolerance=math.radians(1.0), spatial=True, sides=ALONG_AXES[NORMAL : NORMAL + 1],
    )  # fmt: skip

    @cached_property
    def _turn(self) -> FloatArray:
        """Rotation matrix, for all the bodies that a model varies in other numbers."""
        matrix = Rotation.from_rotvec([self.across, self.angle, 0.0]).as_matrix()
        return np.asarray(matrix)

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        if self.across:
            body.gravity[:] = self._turn @ body.gravity
            return
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y, z = body.gravity
        body.gravity[:] = [c * x + s * z, y, c * z - s * x]
