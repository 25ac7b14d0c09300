# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A model held against recordings whose errors are correlated; `joint_fit` fits it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import SimulationError
from dlo_ros.inference.forecast import Forecast, forecast
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parallel import Threads
from dlo_ros.inference.parameter import ParametricModel, acts_in, number_of
from dlo_ros.inference.slide import slid
from dlo_ros.inference.spectrum import Spectrum, of_residuals, spectra
from dlo_ros.inference.variances import (
    ITERATIONS,
    Posterior,
    Variances,
    fit_variances,
    posterior,
)
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

VARIANCE_ITERATIONS = 8
"""Iterations of the error variances for one prediction."""
LEAST_ITERATIONS = 3
"""Iterations of the noise in a linear fit."""

DIFFERENCE = 0.05
"""Step of a difference, in tolerances: large enough to be seen where impacts multiply it."""

BOUNDLESS = "derivatives of the simulation grow beyond all bounds"

Field = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Simulated:
    """A model's simulation of recordings.

    Args:
        model: model with its values.
        fields: residual coefficients [m], shape (F, K), and their derivatives, shape (F, P, K), of
            each recording.
        err: eq. (10) per recording and frame [m]; of measured points without the slide of u, see
            `slide`.
        predicted: control points per recording [m], shape (F, n, 4).
        motions: power of each recording's motion, see `motion_power`.
    """

    model: ParametricModel
    fields: tuple[Field, ...]
    err: tuple[FloatArray, ...]
    predicted: tuple[FloatArray, ...]
    motions: tuple[FloatArray, ...]

    @property
    def mean_err(self) -> float:
        """Mean over recordings of the time mean of eq. (10) [m]."""
        return float(np.mean([e.mean() for e in self.err]))

    def of(self, chosen: Sequence[int]) -> Simulated:
        """The simulation of some of the recordings."""
        fields, err = (self.fields[k] for k in chosen), (self.err[k] for k in chosen)
        predicted, motions = (self.predicted[k] for k in chosen), (self.motions[k] for k in chosen)
        return Simulated(self.model, tuple(fields), tuple(err), tuple(predicted), tuple(motions))


@dataclass(frozen=True)
class Evaluation(Simulated):
    """A model held against recordings.

    Args:
        spectra: normal equations of each recording, but for means over time, see `spectrum`.
        variances: variances of the errors of each recording.
        posterior: linearised at the model's values; its evidence and the variances are those of
            these values, not of others to which only the linearised model may come.
        derived: whether the derivatives are those at the model's values, not at others nearby.
    """

    spectra: tuple[Spectrum, ...]
    variances: tuple[Variances, ...]
    posterior: Posterior
    derived: bool = True

    @cached_property
    def promised(self) -> float:
        """Log evidence of the linearised model, whose optimum no simulation may reach."""
        model = self.model
        return linear_posterior(self, self.spectra, model.offset(), model.precision()).evidence


def simulate(
    model: ParametricModel, recordings: Sequence[Recording], names: Sequence[str] | None = None
) -> Simulated:
    """Simulate recordings.

    Args:
        names: parameters of which derivatives are wanted; default: all of the model.

    Raises:
        SimulationError: one of them cannot be simulated.
    """
    fields = []
    wanted = model.names if names is None else tuple(names)
    chain = dict(zip(model.names, model.chain(), strict=True))
    scale = np.array([chain[name] for name in wanted])

    def forecast_of(recording: Recording) -> Forecast:
        acting = [number_of(name) for name in wanted if acts_in(name, recording.name)]
        return forecast(
            recording.manipulation, as_fine(model.settings, recording), parameters=acting,
            spans=recording.spans,
        )  # fmt: skip

    forecasts = Threads().map(forecast_of, recordings)
    for recording, found in zip(recordings, forecasts, strict=True):
        acting = np.array([acts_in(name, recording.name) for name in wanted], dtype=bool)
        residual, slopes = field(recording, found.predicted, found.sensitivity, scale[acting])
        jacobian = np.zeros((len(residual), len(wanted), residual.shape[1]))
        jacobian[:, acting] = slopes
        steep = _boundless(jacobian, model, wanted)
        if steep.any():
            of_them = [name for name, there in zip(wanted, steep, strict=True) if there]
            jacobian[:, steep] = differences(model, recording, of_them, residual)
        fields.append((residual, jacobian))
    predicted = tuple(f.predicted for f in forecasts)
    err = tuple(
        f.err if r.beyond is None else slid(r, f.predicted, model.settings.rod.length).err
        for r, f in zip(recordings, forecasts, strict=True)
    )
    motions = tuple(r.motion for r in recordings)
    return Simulated(model, tuple(fields), err, predicted, motions)


def _boundless(
    jacobian: FloatArray, model: ParametricModel, names: Sequence[str]
) -> NDArray[np.bool_]:
    """Which derivatives say nothing even of the step of a difference, shape (P,).

    It would move the DLO by more than its length. Near a snap they are large, and right; through
    impacts they grow beyond what any step could do, and where several of them have, the others may
    have grown by as much. They say something where they would be within the length all the same.
    That by the moment of a sudden slip is as large by itself.
    """
    steps = np.array([model.parameters[model.index(name)].step for name in names])
    with np.errstate(over="ignore"):  # they may grow beyond all numbers, too
        moves = np.linalg.norm(jacobian, axis=2) * steps
    most = np.nan_to_num(moves, nan=np.inf).max(axis=0, initial=0.0)
    most *= DIFFERENCE / model.settings.rod.length
    beyond = most > 1.0
    return np.asarray(beyond if np.sum(beyond) < 2 else most * most.max() > 1.0)


def differences(
    model: ParametricModel, recording: Recording, names: Sequence[str], residual: FloatArray
) -> FloatArray:
    """Derivatives as differences over steps that can be seen, shape (F, P, K).

    They are zero by a parameter with which nothing can be simulated on either side.

    Args:
        names: P parameters of the model.
        residual: residual of the model on the recording [m], shape (F, K).
    """

    def column(name: str) -> FloatArray:
        k, theta = model.index(name), model.theta()
        for step in (DIFFERENCE, -DIFFERENCE):
            moved = theta.copy()
            moved[k] += step * model.parameters[k].step
            other = model.at(moved)
            change = other.theta()[k] - theta[k]
            if change == 0.0:  # at an end of its range
                continue
            try:
                beside = simulate(other, [recording], ()).fields[0][0]
            except SimulationError:
                continue
            return np.asarray((residual - beside) / change)
        return np.zeros_like(residual)

    return np.stack(Threads().map(column, names), axis=1)


def field(
    recording: Recording, predicted: FloatArray, moves: FloatArray | None, scale: FloatArray
) -> Field:
    """Residual and derivatives of a simulation in the coefficients of a recording [m].

    Args:
        predicted: control points of the last F frames [m], shape (F, n, 3 or more).
        moves: derivatives of the simulated shapes by the simulation's P parameters, shape (F, P, n,
            3); None: none.
        scale: derivatives of those parameters by the model's, shape (P,).

    Raises:
        SimulationError: something is not finite.
    """
    residual = recording.residual(predicted)
    jacobian = np.zeros((len(residual), len(scale), residual.shape[1]))
    if moves is not None:
        jacobian = recording.coefficients(moves) * scale[:, None]
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
        raise SimulationError("the simulation gives no finite shapes")
    return residual, jacobian


def moved(fields: Sequence[Field], step: FloatArray) -> tuple[Field, ...]:
    """Residuals where a step of the parameters (P,) leads, as if the model were linear."""
    return tuple((r - np.einsum("fpk,p->fk", j, step), j) for r, j in fields)


def least(
    fields: Sequence[Field], offset: FloatArray, precision: FloatArray
) -> tuple[FloatArray, float]:
    """Least squares with priors, as if the model were linear and errors white.

    Args:
        fields: one residual field per recording.
        offset: prior means minus the values, shape (P,).
        precision: inverse prior variances, shape (P,).

    Returns:
        The step of the parameters, shape (P,), and the root mean square distance that it leaves
        [m].
    """
    hessian = np.sum([np.einsum("fpk,fqk->pq", j, j) for _, j in fields], axis=0)
    pull = np.sum([np.einsum("fpk,fk->p", j, r) for r, j in fields], axis=0)
    count = sum(r.size for r, _ in fields)
    step = np.zeros(len(offset))
    for _ in range(LEAST_ITERATIONS):
        variance = sum(float(np.sum(r**2)) for r, _ in moved(fields, step)) / count
        lhs = hessian / variance + np.diag(precision)
        step = np.asarray(np.linalg.solve(lhs, pull / variance + precision * offset))
    left = [np.linalg.norm(r, axis=1).mean() for r, _ in moved(fields, step)]
    return step, float(np.mean(left))


def evaluate(
    model: ParametricModel, recordings: Sequence[Recording],
    start: Sequence[Variances] | None = None,
) -> Evaluation:  # fmt: skip
    """Simulate recordings and fit the variances of what is left.

    Raises:
        SimulationError: one of them cannot be simulated.
    """
    return judged(simulate(model, recordings), start)


def judged(found: Simulated, start: Sequence[Variances] | None = None) -> Evaluation:
    """Fit the variances of what a simulation leaves.

    Raises:
        SimulationError: derivatives are too large for a likelihood.
    """
    return _evaluation(found, _spectra(found), start)


def with_variances(found: Simulated, variances: tuple[Variances, ...]) -> Evaluation:
    """What a simulation leaves, with the variances of something similar; see `rejudged`.

    Raises:
        SimulationError: derivatives are too large for a likelihood.
    """
    return _evaluation(found, _spectra(found), variances, fitted=False)


def rejudged(at: Evaluation) -> Evaluation:
    """The same with variances that are fitted to what it leaves itself.

    Raises:
        SimulationError: derivatives are too large for a likelihood.
    """
    return replace(_evaluation(at, at.spectra, at.variances), derived=at.derived)


def _spectra(found: Simulated) -> tuple[Spectrum, ...]:
    return spectra(found.fields, found.model.settings.rod.control_points, found.motions)


def _evaluation(
    found: Simulated, bins: tuple[Spectrum, ...], variances: Sequence[Variances] | None, *,
    fitted: bool = True,
) -> Evaluation:  # fmt: skip
    """An evaluation whose likelihood is finite: without one, nothing can be simulated.

    Args:
        variances: with which their fit begins; None: as the residuals suggest.
        fitted: whether they are fitted to what a simulation leaves; if not, they count as given.
    """
    model = found.model
    offset, precision = model.offset(), model.precision()
    try:
        if fitted:
            length = model.settings.rod.length
            known, best = fit_variances(bins, offset, precision, length, variances, linear=False)
        else:
            known = tuple(variances or ())
            best = posterior(bins, known, offset, precision, linear=False)
    except np.linalg.LinAlgError as err:  # priors vanish beside the derivatives
        raise SimulationError(BOUNDLESS) from err
    if not np.isfinite(best.evidence):
        raise SimulationError(BOUNDLESS)
    return Evaluation(
        model, found.fields, found.err, found.predicted, found.motions, bins, known, best
    )


def restricted(at: Evaluation, names: Sequence[str]) -> Posterior:
    """Posterior of the model in which only some of the parameters are open, at the same values."""
    pick = [at.model.index(name) for name in names]
    return linear_posterior(
        at, tuple(s.chosen(pick) for s in at.spectra), at.model.offset()[pick],
        at.model.precision()[pick], ITERATIONS,
    )  # fmt: skip


def linear_posterior(
    at: Evaluation, bins: Sequence[Spectrum], offset: FloatArray, precision: FloatArray,
    iterations: int = VARIANCE_ITERATIONS,
) -> Posterior:  # fmt: skip
    """The posterior of a model linearised at an evaluation's values, with fitted variances."""
    length = at.model.settings.rod.length
    return fit_variances(bins, offset, precision, length, at.variances, iterations)[1]


def borrowed(at: Evaluation, model: ParametricModel, recordings: Sequence[Recording]) -> Evaluation:
    """A model held against recordings, with derivatives and variances of another that has all it
    has.

    Args:
        at: evaluation against the same recordings, or longer ones with the same beginnings.

    Raises:
        SimulationError: it cannot be simulated.
    """
    found = simulate(model, recordings, ())
    pick = [at.model.index(name) for name in model.names]
    fields = tuple(
        (r, j[: len(r), pick]) for (r, _), (_, j) in zip(found.fields, at.fields, strict=True)
    )
    found = replace(found, fields=fields)
    shorter = [len(r) < s.frames for (r, _), s in zip(fields, at.spectra, strict=True)]
    if any(shorter):
        return replace(with_variances(found, at.variances), derived=False)
    bins = of_residuals(at.spectra, [r for r, _ in fields], pick)
    return replace(_evaluation(found, bins, at.variances, fitted=False), derived=False)


def linearly_fitted(at: Simulated) -> Evaluation:
    """The fit of a model as if it were linear and errors white; nothing is simulated.

    Its `err` is the root mean square distance of each picture, which residuals tell.
    """
    step, _ = least(at.fields, at.model.offset(), at.model.precision())
    model = at.model.at(at.model.theta() + step)
    step = model.theta() - at.model.theta()  # within ranges
    fields = moved(at.fields, step)
    err = tuple(np.linalg.norm(r, axis=1) for r, _ in fields)
    return judged(Simulated(model, fields, err, at.predicted, at.motions))


def as_fine(settings: Settings, recording: Recording) -> Settings:
    """The settings with the time steps that a recording asks for."""
    tolerance = recording.tolerance_with(settings.effects)
    if tolerance is None:
        return settings
    simulation = replace(settings.simulation, tolerance=tolerance)
    return replace(settings, simulation=simulation)
