# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Levenberg-Marquardt fits of the open parameters of a model to recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.diagnosis.fitting.plain_evaluation import PlainEvaluation, evaluate
from dlo_ros.diagnosis.fitting.plain_model import PlainModel, prior
from dlo_ros.errors import SimulationError
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

CONVERGED = 0.05
"""Gain of the cost in one iteration, per root of the number of measurements."""
CLEARLY_WRONG = 4.0
"""Excess over the noise from which a fit need not be driven to the last digit."""
COARSE = 0.01
"""Share of the squared residuals that an iteration must still gain there."""
TINY = 1e-200
MARQUARDT_DAMPING = 1e-4
"""Marquardt's damping of a fit at first."""
DAMPED, LEAST_DAMPING = 100.0, 1e-4
"""Factor by which the damping grows after a step that has failed, and its least value then."""
TRIES = 5
LARGEST_STEP = 2.0
"""Largest change of a parameter in one iteration, in natural units."""


@dataclass(frozen=True)
class Normal:
    """The normal equations of a linearised model, for any part of the measurements.

    Args:
        hessian: J^T J, shape (P, P).
        gradient: J^T r, shape (P,).
        sum_of_squares: r^T r.
    """

    hessian: FloatArray
    gradient: FloatArray
    sum_of_squares: float

    def __add__(self, other: Normal) -> Normal:
        return Normal(
            self.hessian + other.hessian,
            self.gradient + other.gradient,
            self.sum_of_squares + other.sum_of_squares,
        )

    def scaled(self, factor: float) -> Normal:
        """The normal equations with another weight."""
        return Normal(factor * self.hessian, factor * self.gradient, factor * self.sum_of_squares)

    def minimum(self) -> tuple[FloatArray, float]:
        """Step to the minimum of the linearised cost, and the cost there."""
        step = solve(self.hessian, self.gradient)
        return step, self.sum_of_squares - float(self.gradient @ step)


def solve(hessian: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of positive definite equations whose unknowns differ widely in size."""
    diagonal = np.diag(hessian)
    # An unknown of which nothing is known stays where it is.
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.maximum(diagonal, TINY)), 0.0)
    scaled = hessian * scale[:, None] * scale
    scaled += 1e-12 * np.eye(len(scaled))
    shape = (-1,) + (1,) * (right.ndim - 1)
    return np.asarray(scale.reshape(shape) * np.linalg.solve(scaled, scale.reshape(shape) * right))


def normal(residual: FloatArray, jacobian: FloatArray) -> Normal:
    """Normal equations of frames with residuals (F, K) and Jacobian (F, P, K)."""
    j = jacobian.transpose(0, 2, 1).reshape(-1, jacobian.shape[1])
    r = residual.ravel()
    return Normal(j.T @ j, j.T @ r, float(r @ r))


def known(model: PlainModel, given: Settings) -> Normal:
    """The prior as normal equations."""
    centre, information = prior(model, given)
    off = centre - model.theta()
    return Normal(np.diag(information), information * off, float(information @ off**2))


def total(
    at: PlainEvaluation, given: Settings, masks: Sequence[np.ndarray] | None = None
) -> Normal:
    """Normal equations of all measurements and the prior, the noise as large as the residuals.

    Args:
        masks: frames of each recording that count, shape (F,); default: all.
    """
    assert at.jacobians is not None
    result = known(at.model, given)
    for k, (residual, jacobian) in enumerate(zip(at.residuals, at.jacobians, strict=True)):
        keep = slice(None) if masks is None else masks[k][-len(residual) :]
        result = result + normal(residual[keep], jacobian[keep]).scaled(1.0 / at.excess)
    return result


def bounded(model: PlainModel, hessian: FloatArray, gradient: FloatArray) -> FloatArray:
    """A step within the ranges; a parameter that meets its border stays there."""
    theta = model.theta()
    step = np.zeros(len(theta))
    held = np.zeros(len(theta), dtype=np.bool_)
    for _ in range(len(theta)):
        free = ~held
        right = gradient[free] - hessian[np.ix_(free, held)] @ step[held]
        step[free] = solve(hessian[np.ix_(free, free)], right)
        step *= min(1.0, LARGEST_STEP / float(np.abs(step / model.natural()).max() or 1.0))
        within = model.at(theta + step).theta() - theta
        met = free & (np.abs(within - step) > 1e-9 * (1.0 + np.abs(step)))
        if not met.any():
            break
        step[met] = within[met]
        held |= met
    return step


def fit(
    start: PlainEvaluation, recordings: Sequence[Recording], given: Settings,
    iterations: int, *, damping: float = MARQUARDT_DAMPING,
) -> PlainEvaluation:  # fmt: skip
    """Levenberg-Marquardt iteration that begins with an evaluation with derivatives.

    A step that cannot be simulated or increases the cost is shortened; a parameter beyond its range
    stays at the border.

    Args:
        damping: Marquardt's, at first; it keeps a fit from going far along what the data leave
            open, and makes it slow along narrow valleys.
    """
    best = start
    for _ in range(iterations):
        after, damping = _improved(best, recordings, given, damping)
        done = after is None or best.cost - after.cost < _enough(best)
        best = after or best
        if done:
            break
    return best


def _enough(at: PlainEvaluation) -> float:
    """Gain of the cost below which a fit has converged."""
    count = sum(r.size for r in at.residuals)
    coarse = COARSE * count if at.excess > CLEARLY_WRONG else 0.0
    return float(CONVERGED * np.sqrt(count)) + coarse


def _improved(
    best: PlainEvaluation, recordings: Sequence[Recording], given: Settings, damping: float
) -> tuple[PlainEvaluation | None, float]:
    """One iteration: the better evaluation, None where there is none, and the next damping."""
    equations, enough = total(best, given), _enough(best)
    for k in range(TRIES):
        lhs = equations.hessian + damping * np.diag(np.diag(equations.hessian))
        step = bounded(best.model, lhs, equations.gradient)
        if step @ (2.0 * equations.gradient - equations.hessian @ step) < enough:
            break
        trial = best.model.at(best.model.theta() + step)
        try:
            after = evaluate(trial, recordings, given)
        except SimulationError:
            damping = max(DAMPED * damping, LEAST_DAMPING)
            continue
        gain = best.cost - after.cost
        if gain > 0.0:
            return after, 0.1 * damping
        if k and -gain < enough:
            break
        damping = max(DAMPED * damping, LEAST_DAMPING)
    return None, damping


def attempt(
    model: PlainModel, recordings: Sequence[Recording], given: Settings, iterations: int
) -> PlainEvaluation | None:
    """A fit that begins with a model; None where that cannot be simulated."""
    try:
        at = evaluate(model, recordings, given)
    except SimulationError:
        return None
    return fit(at, recordings, given, iterations)
