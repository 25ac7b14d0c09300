# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The camera measures sizes wrong, for example by a wrong distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Effect, quantity
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class CameraScale(Effect):
    """True size over measured size, about the board's origin."""

    name: ClassVar[str] = "camera_scale"
    title: ClassVar[str] = "camera scale"
    phrase: ClassVar[str] = "the camera shows everything too small or too large"
    remedy: ClassVar[str] = (
        "Calibrate the camera again, and measure the pattern that it is calibrated with."
    )
    group: ClassVar[str] = "camera"
    in_setup: ClassVar[bool] = True

    ratio: float = quantity(
        1.0, "", 0.5, 2.0, "true size over measured size", role="ratio", tolerance=0.005,
        sides=(("too small", "too large"),),
    )  # fmt: skip

    def measured(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return points / self.ratio

    def true(self, points: FloatArray) -> FloatArray:
        """See the base class."""
        return points * self.ratio
