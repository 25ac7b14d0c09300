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
from dlo_ros.identification.offline.material_fit import searched
from dlo_ros.identification.offline.recording_identification import FittedMaterial
from dlo_ros.inference.forecast import Forecast, Manipulation
from dlo_ros.inference.parallel import Pool, Threads
from dlo_ros.inference.weighted_quantiles import weighted_quantiles
from dlo_ros.parameters import Settings
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
    train: Sequence[Manipulation],
    settings: Settings,
    found: FittedMaterial,
    *,
    count: int = 400,
    seed: int = 0,
    pool: Pool | None = None,
    done: Callable[[float], None] = lambda share: None,
) -> Sample:
    """Sample the posterior: full simulations, weighted by how far the fit's gradient is from zero.

    The gradient's covariance is that of the errors as they are (`residual_information`), so that
    correlated residuals count as in the standard deviations; the curvature beyond the optimum is
    the model's.

    Args:
        train, settings: recordings and settings as they were given to the fit; settings searchable.
        found: the fit.
        count: number of samples.
        seed: seed of the random numbers.
        pool: pool in which simulations run.
        done: function that is called with the fraction that is done.

    Raises:
        SimulationError: no sample can be simulated.
    """
    guess, prior = logarithms(settings), search_information(settings)
    usable = np.isfinite(guess)
    covariance = np.linalg.inv(found.information + prior)
    rng = np.random.default_rng(seed)
    steps = rng.multivariate_normal(np.zeros(4), PROPOSAL_SCALE**2 * covariance, size=count)
    steps[0] = 0.0
    theta = np.where(usable, found.theta + steps, guess)
    chunks = [theta[k : k + BATCH_SIZE] for k in range(0, count, BATCH_SIZE)]
    tasks = []
    for chunk in chunks:
        sets = [with_logarithms(found.settings, row) for row in chunk]
        for recording, f, mask in zip(train, found.fit.forecasts, found.ignored, strict=True):
            assert f.derivative is not None
            tasks.append((recording, sets, f.spans, f.derivative, mask))
    gradients = (pool or Threads()).map(_gradients, tasks, lambda k, _: done((k + 1) / len(tasks)))
    per = len(train)
    gradient = np.concatenate(
        [np.sum(gradients[k * per : (k + 1) * per], axis=0) for k in range(len(chunks))]
    )
    inverse = np.linalg.pinv(found.fit.normal, rcond=1e-9, hermitian=True)
    off_data = gradient @ inverse.T
    off_prior = np.where(usable, theta - guess, 0.0)
    shapes = found.information
    off_force = np.zeros(count)
    if found.forces is not None:
        shapes = shapes - found.forces.information
        off = np.where(usable, theta - found.theta, 0.0)
        off_force = np.einsum("kp,pq,kq->k", off, found.forces.information, off)
        off_force -= 2.0 * off @ found.forces.gradient
    misfit = off_force + np.einsum("kp,pq,kq->k", off_data, shapes, off_data)
    misfit = misfit + np.einsum("kp,pq,kq->k", off_prior, prior, off_prior)
    proposed = np.einsum("kp,pq,kq->k", steps, found.information + prior, steps) / PROPOSAL_SCALE**2
    logs = np.where(np.isfinite(misfit), -0.5 * misfit + 0.5 * proposed, -np.inf)
    if not np.isfinite(logs).any():
        raise SimulationError("no sample of the posterior can be simulated")
    weight = np.exp(logs - logs.max())
    return Sample(theta, weight / weight.sum())


def _gradients(
    task: tuple[Manipulation, list[Settings], int, FloatArray, np.ndarray],
) -> FloatArray:
    """J^T r with the derivatives of the optimum, NaN where the simulation fails, shape (S, 4)."""
    recording, sets, spans, derivative, ignored = task
    result = np.full((len(sets), derivative.shape[1]), np.nan)
    for k, f in enumerate(forecast_each(recording, sets, spans=spans)):
        if f is not None:
            kept = np.where(ignored[:, None, None], 0.0, f.residual)
            result[k] = np.einsum("fpic,fic->p", derivative, kept)
    return result


def bootstrap(
    train: Sequence[Manipulation],
    found: FittedMaterial,
    *,
    count: int = 50,
    seed: int = 0,
    pool: Pool | None = None,
    before: dict[int, FloatArray] | None = None,
    done: Callable[[int, FloatArray | None], None] = lambda number, theta: None,
) -> FloatArray:
    """Fit recordings drawn with replacement, again and again.

    Args:
        train: recordings as they were given to the fit.
        found: the fit, from which each starts.
        count: number of draws.
        seed: seed of the draws; the same seed draws the same recordings.
        pool: pool in which the fits run.
        before: earlier results by number, from a run that was interrupted.
        done: function that is called with the number of a draw and its result.

    Returns:
        ln (E, mu, c, t_r) of the draws that could be fitted, shape (at most count, 4).

    Raises:
        InputError: fewer than two recordings.
    """
    if len(train) < 2:
        raise InputError("a bootstrap over recordings needs at least two of them")
    draws = np.random.default_rng(seed).integers(len(train), size=(count, len(train)))
    known = before or {}
    missing = [k for k in range(count) if k not in known]
    tasks = []
    for k in missing:
        chosen = [int(i) for i in draws[k]]
        tasks.append(
            (
                [train[i] for i in chosen], found.settings, found.theta,
                [found.fit.forecasts[i] for i in chosen], [found.ignored[i] for i in chosen],
            )
        )  # fmt: skip
    fits = (pool or Threads()).map(_refitted, tasks, lambda i, theta: done(missing[i], theta))
    results = {**known, **{k: t for k, t in zip(missing, fits, strict=True) if t is not None}}
    return np.array([results[k] for k in sorted(results)])


def _refitted(
    task: tuple[list[Manipulation], Settings, FloatArray, list[Forecast], list[np.ndarray]],
) -> FloatArray | None:
    """Logarithms of a fit to some recordings; None where it fails."""
    try:
        return searched(*task).theta
    except SimulationError:
        return None
