# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The camera is turned about its axis against what is configured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.effects.base import Effect, quantity
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class CameraRotation(Effect):
    """Rotation of the measured shapes about the board's origin, positive from x towards -z."""

    name: ClassVar[str] = "camera_rotation"
    title: ClassVar[str] = "camera roll"
    phrase: ClassVar[str] = "the camera is turned against the board"
    in_setup: ClassVar[bool] = True

    angle: float = quantity(
        0.0, "rad", -1.6, 1.6, "of the measured shapes", tolerance=math.radians(0.5)
    )

    def measured(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return np.asarray(Rotation.from_rotvec([0.0, self.angle, 0.0]).apply(points))

    def true(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return np.asarray(Rotation.from_rotvec([0.0, -self.angle, 0.0]).apply(points))
