# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What a camera saw of the DLO at one instant (no ROS here)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlo_ros.errors import InputError
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class CentrelinePoints:
    """Measured points of the centreline.

    Args:
        positions: [m] in the board frame, shape (m, 3).
        u: material coordinates [m], shape (m,).
        std: standard deviation across the DLO [m], shape (m,).
        std_along: standard deviation of u [m], shape (m,); None where no free end makes it
            uncertain.
    """

    positions: FloatArray
    u: FloatArray
    std: FloatArray
    std_along: FloatArray | None = None


@dataclass(frozen=True)
class Observation:
    """An observed spline.

    Args:
        stamp: of the image [ns].
        control_points: x, y, z [m] and theta [rad] of the published basis, shape (n, 4).
        points: the measured points behind the spline, where they are known.

    Raises:
        InputError: wrong shape or a number that is not finite.
    """

    stamp: int
    control_points: FloatArray
    points: CentrelinePoints | None = None

    def __post_init__(self) -> None:
        shape = self.control_points.shape
        if len(shape) != 2 or shape[1] != 4:
            raise InputError(f"an observed spline has shape {shape}; (n, 4) is needed")
        if not np.all(np.isfinite(self.control_points)):
            raise InputError("an observed spline holds NaN or infinite control points")
