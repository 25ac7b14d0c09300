# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Maps from true shapes to measured ones, by the effects of measurement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.effects import Effect, build
from dlo_ros.effects.base import MEASUREMENT
from dlo_ros.rod.parameter_names import acts_on
from dlo_ros.rod.sensitivity_parameters import STEP, variation_of, varied
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray


class MeasurementMap:
    """Maps between true and measured shapes; affine in the control points.

    Args:
        settings: settings whose effects on the measurement count.
        parameters: parameters whose sensitivities are wanted, see `sensitivity_parameters`.

    Attributes:
        later: delay of the measurement after the simulated instant [ns].
        later_rate: derivatives of that delay by the parameters [s], shape (P,).
    """

    def __init__(self, settings: RodSettings, parameters: Sequence[str] = ()) -> None:
        self._effects = build(settings.effects)
        self._map, self._shift = _affine(self._effects)
        self.later = round(sum(e.later() for e in self._effects) * NANOSECONDS)
        count = len(parameters)
        self._map_rate, self._shift_rate = np.zeros((count, 3, 3)), np.zeros((count, 3))
        self.later_rate = np.zeros(count)
        self._measuring = [p for p, name in enumerate(parameters) if acts_on(name, MEASUREMENT)]
        for p in self._measuring:
            name = parameters[p]
            amounts = variation_of(settings, name).amounts(STEP)
            above, below = (build(varied(settings, name, d).effects) for d in amounts)
            (high, far), (low, near) = _affine(above), _affine(below)
            width = amounts[0] - amounts[1]
            self._map_rate[p] = (high - low) / width
            self._shift_rate[p] = (far - near) / width
            late = sum(e.later() for e in above) - sum(e.later() for e in below)
            self.later_rate[p] = late / width

    def measured(self, shape: FloatArray) -> FloatArray:
        """Control points as measured, of true ones; shape (..., n, 4), theta as it is."""
        if not self._effects:
            return shape
        seen = shape[..., :3] @ self._map.T + self._shift
        return np.concatenate([seen, shape[..., 3:]], axis=-1)

    def true(self, shape: FloatArray) -> FloatArray:
        """The inverse of `measured`, theta or not; shape (..., n, 3 or more)."""
        if not self._effects:
            return shape
        points = shape[..., :3].reshape(-1, 3)
        for effect in reversed(self._effects):
            points = effect.true(points)
        return np.concatenate([points.reshape(*shape.shape[:-1], 3), shape[..., 3:]], axis=-1)

    def sensitivity(
        self, shape: FloatArray, velocity: FloatArray, change: FloatArray
    ) -> FloatArray:
        """Derivatives of measured control points.

        Args:
            shape, velocity: true control points and their velocities, shapes (..., n, 4) and (...,
                n, 3).
            change: derivatives of the control points by the parameters, shape (..., P, n, 3).

        Returns:
            Shape (..., P, n, 3).
        """
        if not self._effects:
            return change
        result = (change.reshape(-1, 3) @ self._map.T).reshape(change.shape)
        for p in self._measuring:
            # A shape that is seen later has moved less far.
            result[..., p, :, :] -= self.later_rate[p] * velocity @ self._map.T
            result[..., p, :, :] += shape[..., :3] @ self._map_rate[p].T + self._shift_rate[p]
        return result


def _affine(effects: Sequence[Effect]) -> tuple[FloatArray, FloatArray]:
    """Matrix (3, 3) and shift (3,) of the measurement of points."""
    seen = _measured(effects, np.vstack([np.zeros(3), np.eye(3)]))
    return (seen[1:] - seen[0]).T, seen[0]


def _measured(effects: Sequence[Effect], points: FloatArray) -> FloatArray:
    for effect in effects:
        points = effect.measured(points)
    return points
