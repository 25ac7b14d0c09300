# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What a simulation gives out."""

from __future__ import annotations

from dataclasses import dataclass

from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class Prediction:
    """A simulated shape.

    Args:
        stamp: simulated instant [ns].
        control_points: x, y, z [m], theta [rad] in the published basis, shape (n, 4).
        sensitivity: derivatives of x, y, z with respect to the logarithms of the P parameters
            asked for, shape (P, n, 3); None where none were.
        loading: what the DLO and its grips bear, in the board's frame, as they truly are; None
            where that was not asked for.
    """

    stamp: int
    control_points: FloatArray
    sensitivity: FloatArray | None = None
    loading: Loading | None = None
