# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Posterior sampling beyond the curvature at the optimum, and bootstrap over recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.batched_forecast import forecast_each
from dlo_ros.identification.estimate import (
    COMBINATIONS,
    logarithms,
    search_information,
    with_logarithms,
)
from dlo_ros.identification.offline.set_up_estimate import MaterialFit
from dlo_ros.identification.offline.wrench_identification import ForceInformation
from dlo_ros.inference.joint import Evaluation, as_fine, evaluate, field
from dlo_ros.inference.joint_fit import WHITE_ITERATIONS, fit
from dlo_ros.inference.losses import CORRELATED, WHITE
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parallel import Pool, Threads
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.spectrum import of_residuals
from dlo_ros.inference.weighted_quantiles import weighted_quantiles
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

BATCH_SIZE = 8  # samples that are simulated at once
PROPOSAL_SCALE = 1.3  # spread of the proposals, in that of the Gaussian posterior
LEVELS = (0.025, 0.5, 0.975)


@dataclass(frozen=True)
class Sample:
    """A weighted sample of the posterior.

    Args:
        theta: ln (E, mu, c, t_r), shape (N, 4).
        weight: weights of the samples, which sum to 1, shape (N,).
    """

    theta: FloatArray
    weight: FloatArray

    @property
    def effective(self) -> float:
        """Effective number of independent draws."""
        return float(1.0 / np.sum(self.weight**2))

    def quantiles(self, name: str) -> tuple[float, float, float]:
        """2.5 %, 50 % and 97.5 % of young_modulus, density or specific_modulus."""
        values = self.theta @ COMBINATIONS[name]
        low, middle, high = np.exp(weighted_quantiles(values, self.weight, LEVELS))
        return float(low), float(middle), float(high)


def sample(
    settings: Settings,
    found: MaterialFit,
    forces: ForceInformation | None = None,
    *,
    count: int,
    pool: Pool | None = None,
    done: Callable[[float], None] = lambda share: None,
) -> Sample:
    """Sample the posterior: full simulations, weighted by how far the fit's gradient is from zero.

    The gradient counts with the variances of the fit's errors, so that correlated residuals count
    as in the standard deviations; the curvature beyond the optimum is the model's.

    Args:
        settings: settings as they were given to the fit; searchable.
        found: the fit.
        forces: information of measured forces, which the fit contains.
        count: number of samples.
        pool: pool in which simulations run.
        done: function that is called with the fraction that is done.

    Raises:
        SimulationError: no sample can be simulated.
    """
    guess, prior = logarithms(settings), search_information(settings)
    usable = np.isfinite(guess)
    covariance = np.linalg.inv(found.information + prior)
    rng = np.random.default_rng(0)
    steps = rng.multivariate_normal(np.zeros(4), PROPOSAL_SCALE**2 * covariance, size=count)
    steps[0] = 0.0
    theta = np.where(usable, found.theta + steps, guess)
    chunks = [theta[k : k + BATCH_SIZE] for k in range(0, count, BATCH_SIZE)]
    at, own = found.at, [k for k, p in enumerate(found.at.model.parameters) if not p.effect]
    place = [MATERIAL.index(at.model.names[k]) for k in own]
    tasks = []
    for chunk in chunks:
        sets = [with_logarithms(found.settings, row) for row in chunk]
        tasks += [(recording, sets) for recording in found.recordings]
    residuals = (pool or Threads()).map(_residuals, tasks, lambda k, _: done((k + 1) / len(tasks)))
    per = len(found.recordings)
    gradient = np.concatenate(
        [_gradients(at, residuals[k * per : (k + 1) * per], own) for k in range(len(chunks))]
    )
    hessian = CORRELATED.normal_equations(at)[0][np.ix_(own, own)]
    off_data = np.zeros((count, len(MATERIAL)))
    off_data[:, place] = gradient @ np.linalg.pinv(hessian, rcond=1e-9, hermitian=True)
    off_prior = np.where(usable, theta - guess, 0.0)
    shapes, misfit = found.information, _squares(off_prior, prior)
    if forces is not None:
        shapes = shapes - forces.information
        off = np.where(usable, theta - found.theta, 0.0)
        misfit += _squares(off, forces.information) - 2.0 * off @ forces.gradient
    misfit += _squares(off_data, shapes)
    proposed = _squares(steps, found.information + prior) / PROPOSAL_SCALE**2
    logs = np.where(np.isfinite(misfit), -0.5 * misfit + 0.5 * proposed, -np.inf)
    if not np.isfinite(logs).any():
        raise SimulationError("no sample of the posterior can be simulated")
    weight = np.exp(logs - logs.max())
    return Sample(theta, weight / weight.sum())


def _squares(rows: FloatArray, information: FloatArray) -> FloatArray:
    """Squared lengths of rows (N, 4) in units of what information (4, 4) leaves, shape (N,)."""
    return np.asarray(np.einsum("kp,pq,kq->k", rows, information, rows))


def _residuals(task: tuple[Recording, list[Settings]]) -> list[FloatArray | None]:
    """Residuals of a recording with some settings, shape (F, K); None: it cannot be simulated."""
    recording, sets = task
    fine = [as_fine(settings, recording) for settings in sets]
    found = forecast_each(recording.manipulation, fine, spans=recording.spans)
    none = np.zeros(0)
    return [None if f is None else field(recording, f.predicted, None, none)[0] for f in found]


def _gradients(
    at: Evaluation, residuals: Sequence[Sequence[FloatArray | None]], own: Sequence[int]
) -> FloatArray:
    """Gradients with the derivatives and the variances of the optimum, shape (S, P).

    They are NaN where a simulation fails.

    Args:
        residuals: of each recording, with each of S settings.
        own: numbers of the P parameters.
    """
    weights = [1.0 / v.of(s) for s, v in zip(at.spectra, at.variances, strict=True)]
    result = np.full((len(residuals[0]), len(own)), np.nan)
    for k, each in enumerate(zip(*residuals, strict=True)):
        left = [r for r in each if r is not None]
        if len(left) == len(each):
            bins = of_residuals(at.spectra, left, own)
            result[k] = np.sum([w @ s.gradient for w, s in zip(weights, bins, strict=True)], axis=0)
    return result


def bootstrap(
    found: MaterialFit,
    *,
    count: int,
    pool: Pool | None = None,
    before: dict[int, FloatArray] | None = None,
    done: Callable[[int, FloatArray | None], None] = lambda number, theta: None,
) -> FloatArray:
    """Fit recordings drawn with replacement, again and again.

    Args:
        found: the fit, from which each starts.
        count: number of draws.
        pool: pool in which the fits run.
        before: earlier results by number, from a run that was interrupted.
        done: function that is called with the number of a draw and its result.

    Returns:
        ln (E, mu, c, t_r) of the draws that could be fitted, shape (at most count, 4).

    Raises:
        InputError: fewer than two recordings.
    """
    recordings = found.recordings
    if len(recordings) < 2:
        raise InputError("a bootstrap over recordings needs at least two of them")
    # Every run makes the same draws, so that it can go on with what an interrupted one found.
    draws = np.random.default_rng(0).integers(len(recordings), size=(count, len(recordings)))
    known = before or {}
    missing = [k for k in range(count) if k not in known]
    own = tuple(p for p in found.at.model.parameters if not p.effect)
    plain = ParametricModel(found.settings, own)
    tasks = [(plain, [recordings[i] for i in draws[k]]) for k in missing]
    fits = (pool or Threads()).map(_refitted, tasks, lambda i, theta: done(missing[i], theta))
    results = {**known, **{k: t for k, t in zip(missing, fits, strict=True) if t is not None}}
    return np.array([results[k] for k in sorted(results)]).reshape(-1, len(MATERIAL))


def _refitted(task: tuple[ParametricModel, list[Recording]]) -> FloatArray | None:
    """Logarithms of a fit to some recordings; None where it fails."""
    model, recordings = task
    try:
        at = fit(evaluate(model, recordings), recordings, WHITE_ITERATIONS, loss=WHITE)
    except SimulationError:
        return None
    return logarithms(at.model.settings)
