# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The longest time steps whose own error does not matter."""

from __future__ import annotations

from collections.abc import Callable

from dlo_ros.spline import FloatArray

COARSEST = 1e-2
"""Tolerance of a simulation at which the search for steps that are short enough begins: one step
may then add 0.3 mm per metre of DLO."""
ROUNDS = 4
FACTOR = 10.0
"""Factor between two tolerances."""


def longest_time_steps(
    predict: Callable[[float], FloatArray],
    distance: Callable[[FloatArray, FloatArray], float],
    allowed: float,
) -> tuple[float, float]:
    """The largest tolerance whose time steps err by no more than is allowed.

    Args:
        predict: predicted shapes at a tolerance, an array.
        distance: distance between two of them.
        allowed: distance that the time steps may cause.

    Returns:
        That tolerance, or the smallest that was tried, and the distance that it causes.

    Raises:
        SimulationError: as `predict` does.
    """
    tolerance, error = COARSEST, float("inf")
    before = predict(tolerance)
    for _ in range(ROUNDS):
        after = predict(tolerance / FACTOR)
        error = distance(after, before)
        if error < allowed:
            break
        # The error of the finer steps, if errors are proportional to the tolerance.
        tolerance, before, error = tolerance / FACTOR, after, error / (FACTOR - 1.0)
        if error < allowed:
            break
    return tolerance, error
