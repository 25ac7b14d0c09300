# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The prediction of a simulation: shape, sensitivity, loads."""

from __future__ import annotations

from typing import NamedTuple

from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.spline import FloatArray


class Prediction(NamedTuple):
    """A simulated shape with its sensitivity.

    Args:
        stamp: simulated instant [ns].
        control_points: x, y, z [m], theta [rad] in the published basis, shape (n, 4).
        sensitivity: derivatives of x, y, z with respect to the logarithms of the P parameters
            asked for, shape (P, n, 3); None where none were.
        loading: true loads on the DLO and its grips, in the board's frame; None where they were not
            asked for.
    """

    stamp: int
    control_points: FloatArray
    sensitivity: FloatArray | None = None
    loading: Loading | None = None
