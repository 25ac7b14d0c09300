# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The longest time steps whose own error does not matter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dlo_ros.spline import FloatArray

COARSEST = 1e-2
"""Tolerance of a simulation at which the search for steps that are short enough begins: one step
may then add 0.3 mm per metre of DLO."""
ROUNDS = 4
FACTOR = 10.0
"""Factor between two tolerances."""
STEP_SHARE = 0.01
"""Share of the residual that the error of the time steps may be."""


def sufficient_time_steps(
    residuals: Callable[[float], Sequence[FloatArray]], left: Sequence[FloatArray]
) -> float:
    """The largest tolerance whose time steps err by no more than `STEP_SHARE` of a residual.

    A model that misses the shapes by millimetres need not be integrated to micrometres.

    Args:
        residuals: residuals of all recordings at a tolerance, each of shape (F, ...).
        left: residuals of the model.

    Raises:
        SimulationError: as `residuals` does.
    """
    frames = sum(map(len, left))
    found, _ = longest_time_steps(
        lambda tolerance: np.concatenate([r.ravel() for r in residuals(tolerance)]),
        lambda a, b: float(np.linalg.norm(a - b) / np.sqrt(frames)),
        STEP_SHARE * typical_distance(left),
    )
    return found


def typical_distance(residuals: Sequence[FloatArray]) -> float:
    """Median distance of the shapes [m], of the recording in which it is least.

    Args:
        residuals: residuals of each recording, shape (F, ...).
    """
    squares = [np.median(np.sum(r.reshape(len(r), -1) ** 2, axis=1)) for r in residuals]
    return float(np.sqrt(min(squares)))


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
