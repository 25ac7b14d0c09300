# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulations of recordings with a model, with derivatives by its open parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.fitting.candidate_model import Model, prior
from dlo_ros.effects import effects, nonsmooth
from dlo_ros.errors import SimulationError
from dlo_ros.identification.batched_forecast import forecast_together
from dlo_ros.inference.forecast import Forecast, forecast
from dlo_ros.inference.joint import as_fine
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

BOUNDLESS = 1e100
"""Derivatives that say nothing, and of which squares no longer are numbers."""
SAME = 1e-6
"""Largest difference of shapes over the length, where one without derivatives does nothing."""
TINY = 1e-30
DIFFERENCE = 0.01
"""Step of a difference over the parameter's natural size."""


@dataclass(frozen=True)
class CandidateEvaluation:
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
        expensive_jacobian: whether derivatives have cost as much as several simulations.
        carried: whether they are carried on from those of other values, see `carried_on`.
    """

    model: Model
    residuals: tuple[FloatArray, ...]
    jacobians: tuple[FloatArray, ...] | None
    sum_of_squares: float
    cost: float
    predicted: tuple[FloatArray, ...]
    err: tuple[FloatArray, ...]
    expensive_jacobian: bool = False
    carried: bool = False

    @property
    def mean_err(self) -> float:
        """Mean over recordings of the time mean of eq. (10) [m]."""
        return float(np.mean([e.mean() for e in self.err]))

    @property
    def excess(self) -> float:
        """Mean square of the residuals where it is larger than the noise, else 1."""
        return max(1.0, self.sum_of_squares / sum(r.size for r in self.residuals))


def is_differentiable(model: Model) -> bool:
    """Whether a motion has useful derivatives with all effects of a model.

    Where an effect has none, the answer of the motion to changes as large as a step of a fit is
    used.
    """
    return all(effects()[name].differentiable for name in model.effects)


def differs_in_batch(names: Sequence[str]) -> bool:
    """Whether many values of these effects are simulated at once in the plane.

    Their differences are then cheaper than exact derivatives.
    """
    return all(effects()[name].varied_in_batch for name in names)


def evaluate(
    model: Model, recordings: Sequence[Recording], given: Settings, *, derivatives: bool = True,
    exact: bool = False,
) -> CandidateEvaluation:  # fmt: skip
    """Simulate recordings with a model and compare them with what was measured.

    Args:
        derivatives: whether derivatives are computed.
        exact: whether derivatives are the simulation's own where differences are cheaper.
            Differences pretend to determine what the data leave open.

    Raises:
        SimulationError: one of them cannot be simulated with this model.
    """
    residuals, jacobians, predicted, err = [], [], [], []
    expensive_jacobian = False
    for recording in recordings:
        found, jacobian = _held_against(model, recording, derivatives, exact)
        expensive_jacobian |= found.derivative is not None
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
    return CandidateEvaluation(
        model,
        tuple(residuals),
        tuple(jacobians) if derivatives else None,
        sum_of_squares,
        cost,
        tuple(predicted),
        tuple(err),
        expensive_jacobian,
    )


def carried_on(before: CandidateEvaluation, after: CandidateEvaluation) -> CandidateEvaluation:
    """An evaluation with another's derivatives, corrected by Broyden's update.

    Args:
        before: evaluation with derivatives.
        after: evaluation without derivatives.
    """
    assert before.jacobians is not None
    step = after.model.theta() - before.model.theta()
    along = step / before.model.natural() ** 2
    along = along / max(float(along @ step), TINY)
    jacobians = []
    for jacobian, here, there in zip(
        before.jacobians, before.residuals, after.residuals, strict=True
    ):
        missed = here - there - np.einsum("fpk,p->fk", jacobian, step)
        jacobians.append(jacobian + missed[:, None, :] * along[:, None])
    return replace(
        after,
        jacobians=tuple(jacobians),
        expensive_jacobian=before.expensive_jacobian,
        carried=True,
    )


def _judged(model: Model, residuals: Sequence[FloatArray], given: Settings) -> tuple[float, float]:
    """See `CandidateEvaluation.sum_of_squares` and `CandidateEvaluation.cost`."""
    centre, information = prior(model, given)
    squares, count = sum(float(np.sum(r**2)) for r in residuals), sum(r.size for r in residuals)
    cost = count * (1.0 + np.log(squares / count)) if squares > count else squares
    return squares, cost + float(information @ (model.theta() - centre) ** 2)


def _held_against(
    model: Model, recording: Recording, derivatives: bool, exact: bool
) -> tuple[Forecast, FloatArray | None]:
    """Residuals of a forecast, and its derivatives by the open parameters, shape (F, P, K)."""
    settings, spans = as_fine(model.settings, recording), recording.spans
    manipulation = recording.manipulation
    if not derivatives:
        return forecast(manipulation, settings, spans=spans), None
    if not is_differentiable(model):
        return _nonsmooth(model, recording, exact)
    if exact or not differs_in_batch(model.effects):
        return _exact(model, recording, settings)
    moved, steps = _moved(model)
    sets = [settings, *(as_fine(m.settings, recording) for m in moved)]
    here, *others = forecast_together(manipulation, sets, spans) or [None]
    if here is None or any(other is None for other in others):
        return _exact(model, recording, settings)
    there = [o.predicted for o in others if o is not None]
    return here, _differences(recording, here.predicted, there, steps)


def _nonsmooth(model: Model, recording: Recording, exact: bool) -> tuple[Forecast, FloatArray]:
    """Differences as derivatives of effects that have none, in the recordings in which they act."""

    def alone(one: Model) -> Forecast:
        settings = as_fine(one.settings, recording)
        return forecast(recording.manipulation, settings, spans=recording.spans)

    here, bare = alone(model), model
    for name in nonsmooth():
        bare = bare.without(name)
    found, jacobian = _held_against(bare, recording, bool(bare.free), exact)
    if np.abs(found.predicted - here.predicted).max() > SAME * model.settings.rod.length:
        moved, steps = _moved(model)
        there = [alone(m).predicted for m in moved]
        return here, _differences(recording, here.predicted, there, steps)
    result = np.zeros((len(here.predicted), len(model.free), len(recording.noise)))
    if jacobian is not None:
        result[:, [model.free.index(name) for name in bare.free]] = jacobian
    return here, result


def _differences(
    recording: Recording, here: FloatArray, there: Sequence[FloatArray], steps: FloatArray
) -> FloatArray:
    """Derivatives of a prediction (F, n, 4) from others, one for each parameter that has moved."""
    change = np.stack([t - here for t in there], axis=1)
    return recording.white(change[..., :3]) / steps[:, None]


def _exact(model: Model, recording: Recording, settings: Settings) -> tuple[Forecast, FloatArray]:
    """A forecast with the simulation's own sensitivities."""
    found = forecast(recording.manipulation, settings, parameters=model.free, spans=recording.spans)
    assert found.sensitivity is not None
    return found, recording.white(found.sensitivity) * model.chain()[:, None]


def _moved(model: Model) -> tuple[list[Model], FloatArray]:
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
