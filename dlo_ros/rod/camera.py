# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How and when the camera measures true shapes, where effects of measurement say so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.effects import Effect, build
from dlo_ros.parameters import EFFECTS_PREFIX, Settings
from dlo_ros.rod.tangents import STEP, varied
from dlo_ros.spline import FloatArray


class Camera:
    """Maps between true and measured shapes; linear in the control points.

    Args:
        settings: whose effects count.
        parameters: by which sensitivities are wanted, see `tangents`.
    """

    def __init__(self, settings: Settings, parameters: Sequence[str] = ()) -> None:
        self._effects = build(settings.effects)
        self._pairs = [
            tuple(build(varied(settings, name, side * STEP).effects) for side in (1.0, -1.0))
            if name.startswith(EFFECTS_PREFIX)
            else None
            for name in parameters
        ]

    @property
    def later(self) -> int:
        """How much later than simulated a shape is seen [ns]."""
        return round(sum(e.later() for e in self._effects) * NANOSECONDS)

    def measured(self, shape: FloatArray) -> FloatArray:
        """Control points as measured, of true ones; shape (n, 4), theta as it is."""
        if not self._effects:
            return shape
        return np.column_stack([_measured(self._effects, shape[:, :3]), shape[:, 3]])

    def true(self, shape: FloatArray) -> FloatArray:
        """The inverse of `measured`."""
        points = shape[:, :3]
        for effect in reversed(self._effects):
            points = effect.true(points)
        return np.column_stack([points, shape[:, 3]]) if self._effects else shape

    def sensitivity(
        self, shape: FloatArray, velocity: FloatArray, change: FloatArray
    ) -> FloatArray:
        """Derivatives of measured control points.

        Args:
            shape, velocity: true control points and their velocities, shape (n, 4) and (n, 3).
            change: their derivatives by the parameters, shape (P, n, 3).

        Returns:
            Shape (P, n, 3).
        """
        if not self._effects:
            return change
        origin = _measured(self._effects, np.zeros((1, 3)))
        result = np.empty_like(change)
        for p, pair in enumerate(self._pairs):
            moved = change[p]
            if pair is not None:  # what is seen later has gone less far
                late = sum(e.later() for e in pair[0]) - sum(e.later() for e in pair[1])
                moved = moved - late / (2.0 * STEP) * velocity
            result[p] = _measured(self._effects, moved) - origin
            if pair is not None:
                above, below = (_measured(effects, shape[:, :3]) for effects in pair)
                result[p] += (above - below) / (2.0 * STEP)
        return result


def _measured(effects: Sequence[Effect], points: FloatArray) -> FloatArray:
    for effect in effects:
        points = effect.measured(points)
    return points
