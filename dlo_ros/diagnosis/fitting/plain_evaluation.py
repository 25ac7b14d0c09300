# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulations of recordings with the plain model, with derivatives by its open parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.diagnosis.fitting.plain_model import PlainModel, prior
from dlo_ros.effects import effects
from dlo_ros.errors import SimulationError
from dlo_ros.identification.batched_forecast import forecast_varied
from dlo_ros.inference.forecast import Forecast, forecast
from dlo_ros.inference.joint import as_fine
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

BOUNDLESS = 1e100
"""Derivatives that say nothing, and of which squares no longer are numbers."""
DIFFERENCE = 0.01
"""Step of a difference over the parameter's natural size."""


@dataclass(frozen=True)
class PlainEvaluation:
    """A model's residuals against recordings, and their derivatives.

    Args:
        model: model with its values.
        residuals: residuals of each recording in units of the noise, shape (F, K).
        jacobians: derivatives of the prediction by the open parameters as the fit sees them, per
            recording, shape (F, P, K); None where not asked for.
        sum_of_squares: sum of squared residuals.
        cost: minus twice the log likelihood, plus the prior's term. The noise variance is the one
            left over, but not below the measured one: a model that misses much must not gain by
            leaving known values.
        predicted: control points per recording, shape (F, n, 4).
        err: eq. (10) per recording and frame [m].
    """

    model: PlainModel
    residuals: tuple[FloatArray, ...]
    jacobians: tuple[FloatArray, ...] | None
    sum_of_squares: float
    cost: float
    predicted: tuple[FloatArray, ...]
    err: tuple[FloatArray, ...]

    @property
    def mean_err(self) -> float:
        """Mean over recordings of the time mean of eq. (10) [m]."""
        return float(np.mean([e.mean() for e in self.err]))

    @property
    def excess(self) -> float:
        """Mean square of the residuals where it is larger than the noise, else 1."""
        return max(1.0, self.sum_of_squares / sum(r.size for r in self.residuals))


def evaluate(
    model: PlainModel, recordings: Sequence[Recording], given: Settings, *, derivatives: bool = True
) -> PlainEvaluation:
    """Simulate recordings with a model and compare them with what was measured.

    Args:
        derivatives: whether derivatives are computed.

    Raises:
        SimulationError: one of them cannot be simulated with this model.
    """
    residuals, jacobians, predicted, err = [], [], [], []
    for recording in recordings:
        found, jacobian = _held_against(model, recording, derivatives)
        residuals.append(recording.residual(found.predicted))
        predicted.append(found.predicted)
        err.append(found.err)
        if jacobian is not None:
            jacobians.append(jacobian)
    sum_of_squares, cost = _judged(model, residuals, given)
    if not np.isfinite(cost):
        raise SimulationError("the simulation gives no finite shapes")
    if not all(np.abs(j).max(initial=0.0) < BOUNDLESS for j in jacobians):
        raise SimulationError("the simulation gives no finite derivatives")
    return PlainEvaluation(
        model,
        tuple(residuals),
        tuple(jacobians) if derivatives else None,
        sum_of_squares,
        cost,
        tuple(predicted),
        tuple(err),
    )


def _judged(
    model: PlainModel, residuals: Sequence[FloatArray], given: Settings
) -> tuple[float, float]:
    """See `PlainEvaluation.sum_of_squares` and `PlainEvaluation.cost`."""
    centre, information = prior(model, given)
    squares, count = sum(float(np.sum(r**2)) for r in residuals), sum(r.size for r in residuals)
    cost = count * (1.0 + np.log(squares / count)) if squares > count else squares
    return squares, cost + float(information @ (model.theta() - centre) ** 2)


def _held_against(
    model: PlainModel, recording: Recording, derivatives: bool
) -> tuple[Forecast, FloatArray | None]:
    """A forecast, and its derivatives by the open parameters, shape (F, P, K)."""
    settings = as_fine(model.settings, recording)
    if not derivatives:
        return forecast(recording.manipulation, settings, spans=recording.spans), None
    if not all(effects()[name].differentiable for name in model.settings.effects):
        return _differenced(model, recording)
    found = forecast_varied(recording.manipulation, settings, spans=recording.spans)
    assert found.sensitivity is not None
    pick = [MATERIAL.index(name) for name in model.free]
    return found, recording.white(found.sensitivity[:, pick])


def _differenced(model: PlainModel, recording: Recording) -> tuple[Forecast, FloatArray]:
    """Differences as derivatives where effects have none: the answer to steps as of a fit."""

    def alone(one: PlainModel) -> Forecast:
        settings = as_fine(one.settings, recording)
        return forecast(recording.manipulation, settings, spans=recording.spans)

    here = alone(model)
    moved, steps = _moved(model)
    change = np.stack([alone(m).predicted - here.predicted for m in moved], axis=1)
    return here, np.asarray(recording.white(change[..., :3]) / steps[:, None])


def _moved(model: PlainModel) -> tuple[list[PlainModel], FloatArray]:
    """The model with each open parameter changed within its range, and the steps, shape (P,)."""
    theta, models = model.theta(), []
    steps = DIFFERENCE * np.minimum(model.natural(), 1.0)
    for k in range(len(theta)):
        for sign in (1.0, -1.0):
            other = theta.copy()
            other[k] += sign * steps[k]
            moved = model.at(other)
            if moved.theta()[k] != theta[k]:
                break
        models.append(moved)
        steps[k] *= sign
    return models, steps
