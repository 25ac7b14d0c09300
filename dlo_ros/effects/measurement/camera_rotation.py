# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The camera is turned against what is configured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.effects.base import Effect, Scene, Start, quantity
from dlo_ros.effects.quantity import ABOUT_AXES
from dlo_ros.effects.start import TURNS, Block, rotation_vector
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class CameraRotation(Effect):
    """Rotation of the measured shapes about the board's origin, positive from x towards -z.

    Three numbers are a rotation vector about the board's x, y and z.
    """

    name: ClassVar[str] = "camera_rotation"
    title: ClassVar[str] = "camera rotation"
    phrase: ClassVar[str] = "the camera is turned against the board"
    remedy: ClassVar[str] = "Calibrate the camera's pose against the board again."
    group: ClassVar[str] = "camera"
    in_setup: ClassVar[bool] = True

    angle: float | tuple[float, ...] = quantity(
        0.0, "rad", -1.6, 1.6, "of the measured shapes: about y, or about x, y, z", counts=TURNS,
        tolerance=math.radians(0.5), sides=ABOUT_AXES,
    )  # fmt: skip

    @cached_property
    def _turn(self) -> Rotation:
        return Rotation.from_rotvec(rotation_vector(self.angle))

    def measured(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return np.asarray(self._turn.apply(points))

    def true(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return np.asarray(self._turn.inv().apply(points))

    @classmethod
    def setup(cls, scene: Scene) -> Block:
        """See the base class."""
        return {"angle": (0.0,) * TURNS[1] if scene.spatial else 0.0}

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """See the base class; in space about all three axes."""
        return [Start(cls.name, cls.setup(scene), ("angle",), ("angle",))]
