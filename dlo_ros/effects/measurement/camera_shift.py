# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The camera stands beside where it is configured, or the board's origin was taken elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dlo_ros.effects.base import Effect, Scene, Start, quantity
from dlo_ros.effects.quantity import ALONG_AXES
from dlo_ros.spline import FloatArray

TOLERANCE = 0.005  # of the length, to which the board's origin is found in a picture


@dataclass(frozen=True)
class CameraShift(Effect):
    """Shift of the measured shapes: measured minus true position; y is across the board."""

    name: ClassVar[str] = "camera_shift"
    title: ClassVar[str] = "camera shift"
    phrase: ClassVar[str] = "the camera shows everything shifted"
    remedy: ClassVar[str] = "Calibrate the camera's pose against the board again."
    group: ClassVar[str] = "camera"
    in_setup: ClassVar[bool] = True

    x: float = quantity(
        0.0, "m", -1.0, 1.0, "along x, of the measured shapes", tolerance=TOLERANCE,
        sides=ALONG_AXES[:1],
    )  # fmt: skip
    z: float = quantity(
        0.0, "m", -1.0, 1.0, "along z, of the measured shapes", tolerance=TOLERANCE,
        sides=ALONG_AXES[2:],
    )  # fmt: skip
    y: float = quantity(
        0.0, "m", -1.0, 1.0, "along y, of the measured shapes", tolerance=TOLERANCE, spatial=True,
        sides=ALONG_AXES[1:2],
    )  # fmt: skip

    @property
    def _shift(self) -> FloatArray:
        return np.array([self.x, self.y, self.z])

    def measured(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return np.asarray(points + self._shift)

    def true(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return np.asarray(points - self._shift)

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Nowhere: every set-up has some of it, and it is a cause that no recording can name.

        A DLO whose clamps are all off alike looks the same.
        """
        return []
