# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Values that the grips impose on a rod in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.spatial_rod_kernels import DOF


@dataclass(frozen=True)
class SpatialBoundary:
    """Imposed values at one instant.

    Args:
        positions: [m], shape (3,), of imposed nodes by their index.
        directions: unit vector of growing u at start and end; None leaves it free.
        turns: rotation matrix of the clamp at start and end, whose y axis is the first director of
            a rod that is laid there; the start's, where both are clamped, and of the end's only the
            change counts. None: the directors follow the direction without spin.
    """

    positions: Mapping[int, FloatArray]
    directions: tuple[FloatArray | None, FloatArray | None] = (None, None)
    turns: tuple[FloatArray | None, FloatArray | None] = (None, None)

    def free(self, nodes: int) -> NDArray[np.bool_]:
        """Whether each degree of freedom is free, shape (4 (N + 1),)."""
        result = np.ones((nodes, DOF), dtype=np.bool_)
        result[list(self.positions), :3] = False
        result[-1, 3] = False
        if all(d is None for d in self.directions):
            result[0, 3] = False  # nothing holds the twist: keep the rod from spinning
        return result.ravel()

    def impose(self, x: FloatArray) -> None:
        """Write the imposed positions into nodes x, shape (N + 1, 3)."""
        for node, position in self.positions.items():
            x[node] = position
