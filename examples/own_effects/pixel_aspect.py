# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pixels that are not square: an effect of the measurement, of another package, complete."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dlo_ros.effects import Effect, quantity
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class PixelAspect(Effect):
    """What is measured along z is longer than it is, while x is right.

    What the camera makes of points is all that it says. That the DLO cannot be simulated in a batch
    of parameter sets then, that the effect is smooth and that it is looked for from a ratio of 1,
    follows by itself.
    """

    name: ClassVar[str] = "pixel_aspect"

    ratio: float = quantity(
        1.0, "", 0.5, 2.0, "measured over true size along z", role="ratio", tolerance=0.002
    )

    def measured(self, points: FloatArray) -> FloatArray:
        """Where the camera sees points."""
        return points * np.array([1.0, 1.0, self.ratio])

    def true(self, points: FloatArray) -> FloatArray:
        """The inverse."""
        return points / np.array([1.0, 1.0, self.ratio])
