"""Simulates recordings with a model and fits its open parameters (Levenberg-Marquardt)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.diagnosis.measured import Recording
from dlo_ros.diagnosis.model import Model, prior
from dlo_ros.errors import SimulationError
from dlo_ros.identification.forecast import forecast, whitening
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

CONVERGED = 0.05
"""Gain of the cost in one iteration, per root of the number of measurements."""
CLEARLY_WRONG = 4.0
"""Excess over the noise from which a fit need not be driven to the last digit."""
COARSE = 0.01
"""Share of the squared residuals that an iteration must still gain there."""
LARGEST_STEP = 2.0
"""Of a parameter in one iteration, in natural units."""


@dataclass(frozen=True)
class Evaluation:
    """A model held against recordings.

    Args:
        model: with its values.
        residuals: per recording in units of the noise, shape (F, K).
        jacobians: derivatives of the prediction by the open parameters as the fit sees them, per
            recording, shape (F, P, K); None where not asked for.
        power: sum of squared residuals.
        cost: minus twice the log likelihood, the noise as large as what is left over but no smaller
            than measured, and what the prior adds: a model that misses much must not pay for it
            with what is known.
        predicted: control points per recording, shape (F, n, 4).
        err: eq. (10) per recording and frame [m].
    """

    model: Model
    residuals: tuple[FloatArray, ...]
    jacobians: tuple[FloatArray, ...] | None
    power: float
    cost: float
    predicted: tuple[FloatArray, ...]
    err: tuple[FloatArray, ...]

    @property
    def excess(self) -> float:
        """Mean square of the residuals where it is larger than the noise, else 1."""
        return max(1.0, self.power / sum(r.size for r in self.residuals))


def evaluate(
    model: Model, recordings: Sequence[Recording], given: Settings, *, derivatives: bool = True
) -> Evaluation:
    """Simulate recordings.

    Raises:
        SimulationError: one of them cannot be simulated with this model.
    """
    residuals, jacobians, predicted, err = [], [], [], []
    for recording in recordings:
        found = forecast(
            recording.manipulation,
            model.settings,
            parameters=model.free if derivatives else (),
            spans=recording.spans,
        )
        residuals.append(recording.residual(found.predicted))
        predicted.append(found.predicted)
        err.append(found.err)
        if found.derivative is not None:
            rod = model.settings.rod
            back = np.linalg.inv(whitening(rod.control_points, rod.length))
            change = recording.white(back @ found.derivative)
            jacobians.append(change * model.chain()[:, None])
    centre, information = prior(model, given)
    power, count = sum(float(np.sum(r**2)) for r in residuals), sum(r.size for r in residuals)
    cost = count * (1.0 + np.log(power / count)) if power > count else power
    cost += float(information @ (model.theta() - centre) ** 2)
    if not np.isfinite(cost):
        raise SimulationError("the simulation gives no finite shapes")
    return Evaluation(
        model,
        tuple(residuals),
        tuple(jacobians) if derivatives else None,
        power,
        cost,
        tuple(predicted),
        tuple(err),
    )


@dataclass(frozen=True)
class Normal:
    """The normal equations of a linearised model, of any part of the measurements.

    Args:
        hessian: J^T J, shape (P, P).
        gradient: J^T r, shape (P,).
        power: r^T r.
    """

    hessian: FloatArray
    gradient: FloatArray
    power: float

    def __add__(self, other: Normal) -> Normal:
        return Normal(
            self.hessian + other.hessian, self.gradient + other.gradient, self.power + other.power
        )

    def scaled(self, factor: float) -> Normal:
        """With another weight."""
        return Normal(factor * self.hessian, factor * self.gradient, factor * self.power)

    def minimum(self) -> tuple[FloatArray, float]:
        """Where the linearised cost is smallest, from here, and its value there."""
        step = solve(self.hessian, self.gradient)
        return step, self.power - float(self.gradient @ step)


def solve(hessian: FloatArray, right: FloatArray) -> FloatArray:
    """Solve positive definite equations whose unknowns differ widely in size."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    scaled = hessian * scale[:, None] * scale
    scaled += 1e-12 * np.eye(len(scaled))
    shape = (-1,) + (1,) * (right.ndim - 1)
    return np.asarray(scale.reshape(shape) * np.linalg.solve(scaled, scale.reshape(shape) * right))


def normal(residual: FloatArray, jacobian: FloatArray) -> Normal:
    """Normal equations of frames: residual (F, K), jacobian (F, P, K)."""
    j = jacobian.transpose(0, 2, 1).reshape(-1, jacobian.shape[1])
    r = residual.ravel()
    return Normal(j.T @ j, j.T @ r, float(r @ r))


def known(model: Model, given: Settings) -> Normal:
    """What is known beforehand, as normal equations."""
    centre, information = prior(model, given)
    off = centre - model.theta()
    return Normal(np.diag(information), information * off, float(information @ off**2))


def total(at: Evaluation, given: Settings) -> Normal:
    """Normal equations of everything, the noise as large as what is left over."""
    assert at.jacobians is not None
    result = known(at.model, given)
    for residual, jacobian in zip(at.residuals, at.jacobians, strict=True):
        result = result + normal(residual, jacobian).scaled(1.0 / at.excess)
    return result


def fit(
    start: Evaluation, recordings: Sequence[Recording], given: Settings, iterations: int
) -> Evaluation:
    """Levenberg-Marquardt from an evaluation with derivatives.

    A step that cannot be simulated or makes things worse is shortened; what leaves its range stays
    at the border.
    """
    best, damping = start, 1e-4
    count = sum(r.size for r in start.residuals)
    for _ in range(iterations):
        equations = total(best, given)
        enough = CONVERGED * np.sqrt(count)
        if best.excess > CLEARLY_WRONG:
            enough += COARSE * count
        gain = 0.0
        for _ in range(5):
            lhs = equations.hessian + damping * np.diag(np.diag(equations.hessian))
            step = solve(lhs, equations.gradient)
            step *= min(1.0, LARGEST_STEP / float(np.abs(step / best.model.natural()).max()))
            trial = best.model.at(best.model.theta() + step)
            try:
                after = evaluate(trial, recordings, given)
            except SimulationError:
                damping = max(30.0 * damping, 1e-2)
                continue
            gain = best.cost - after.cost
            if gain > 0.0:
                break
            if -gain < enough:
                return best
            damping = max(30.0 * damping, 1e-2)
        if gain <= 0.0:
            return best
        best, damping = after, 0.1 * damping
        if gain < enough:
            return best
    return best
