# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The maximum of a likelihood within bounds, by Fisher scoring."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dlo_ros.spline import FloatArray

CONVERGED = 1e-2
"""Expected gain in log likelihood at which a search ends."""
LONGEST_STEP = 3.0
"""Largest change of a number, such as the logarithm of a variance, in a step; an uncertainty as
large is added to the information, so that numbers of which nothing is known do not go astray."""
LEAST_DAMPING = 0.1
"""Marquardt's damping at first, with which no step leaps over the nearest optimum."""
NEARLY_LINEAR = 0.75
"""Actual over linearly expected gain of a step, from which the next one is twice as long: at the
optimum of a parabola it is a half, and three quarters half-way there."""


def scored(
    cost: Callable[[FloatArray], tuple[float, FloatArray, FloatArray]], x: FloatArray,
    bounds: FloatArray, iterations: int,
) -> FloatArray:  # fmt: skip
    """Fisher scoring within bounds, damped where a step would not lower the cost.

    The likelihood is flat along variances that are nearly zero, where a search along gradients
    takes hundreds of iterations (Gilmour, Thompson and Cullis, Average information REML, 1995).
    The expected information exceeds what parameters leave of it: steps that gain nearly all that
    their slope promises are lengthened.

    Args:
        cost: function that returns minus the log likelihood, its gradient, shape (m,), and the
            information, shape (m, m).
        x: where it begins, shape (m,).
        bounds: smallest and largest values, shape (m, 2).
        iterations: largest number of steps that are tried.

    Raises:
        numpy.linalg.LinAlgError: there is no likelihood where it begins.
    """
    lower, upper = bounds.T
    x = np.clip(x, lower, upper)
    value, slope, information = cost(x)
    damping, stretch = LEAST_DAMPING, 1.0
    for _ in range(iterations):
        held = ((x <= lower) & (slope > 0.0)) | ((x >= upper) & (slope < 0.0))
        k = np.flatnonzero(~held)
        lhs = information[np.ix_(k, k)]
        lhs = lhs + np.diag(damping * np.diag(lhs) + LONGEST_STEP**-2)
        step = np.zeros_like(x)
        wanted = -stretch * np.linalg.solve(lhs, slope[k])
        step[k] = np.clip(wanted, -LONGEST_STEP, LONGEST_STEP)
        trial = np.clip(x + step, lower, upper)
        gain = float(slope @ (x - trial))
        if 0.0 <= gain < CONVERGED:
            break
        if gain < 0.0:
            damping *= 10.0
            continue
        try:
            found = cost(trial)
        except np.linalg.LinAlgError:
            found = (np.inf, slope, information)
        if found[0] < value:
            stretch = 2.0 * stretch if value - found[0] > NEARLY_LINEAR * gain else 1.0
            x, (value, slope, information) = trial, found
            damping = max(0.1 * damping, LEAST_DAMPING)
        elif stretch > 1.0:
            stretch = 1.0
        else:
            damping *= 10.0
    return x
