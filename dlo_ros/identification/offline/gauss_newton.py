# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The material fit: parallel starts, then Gauss-Newton on the logarithms of the parameters.

Derivatives are exact or differences of simulations with shared steps. The cost is the concentrated
likelihood, in which the noise is unknown, plus the prior. Recordings are simulated side by side in
threads, since compiled code releases the interpreter's lock.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import SimulationError
from dlo_ros.identification.batched_forecast import forecast_each
from dlo_ros.identification.estimate import search_information, with_logarithms
from dlo_ros.identification.offline.recording_simulations import Simulations, stepping
from dlo_ros.identification.residual_information import NOISE_LIMIT
from dlo_ros.identification.residual_noise import correlation_length
from dlo_ros.inference.forecast import Forecast, Manipulation
from dlo_ros.inference.measured import MOST_GROSS, outliers
from dlo_ros.parameters import Settings
from dlo_ros.spline import DEGREE, FloatArray

LOG = logging.getLogger(__name__)

START_FACTORS = (1.0, 1 / 100, 1 / 30, 1 / 10, 1 / 3, 3.0, 10.0, 30.0, 100.0)  # of E/mu
SCAN_SECONDS = 4.0  # of each recording, for the comparison of starts
MAX_ITERATIONS = 30
CONVERGED = 1e-4  # change of a logarithm
LEAST_GAIN = 5e-3  # gain of the log likelihood, repeated residuals counted once
LONGEST_STEP = 1.5  # change of a logarithm in one iteration
STEP_COARSER = 2.0  # of the time steps, to see what they do
SCAN_TOLERANCE = 1e-3  # of the simulations by which starts are compared

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class MaterialFit:
    """A point of the search.

    Args:
        theta: ln (E, mu, c, t_r).
        forecasts: forecasts of all recordings, with derivatives.
        cost: see above.
        normal: J^T J summed over recordings (4, 4) [m^2].
        gradient: J^T r (4,).
        sum_of_squares: sum of squared residuals [m^2].
        count: residual numbers that can differ from zero.
    """

    theta: FloatArray
    forecasts: list[Forecast]
    cost: float
    normal: FloatArray
    gradient: FloatArray
    sum_of_squares: float
    count: int


def _scanned(task: tuple[Manipulation, list[Settings], int]) -> list[float]:
    """Median squared residual of one recording's beginning with several settings."""
    recording, sets, spans = task
    stop = recording.observations[0].stamp + round(SCAN_SECONDS * NANOSECONDS)
    # The median over time: an outlier picture must not decide.
    return [
        np.inf if f is None else float(np.median(np.sum(f.residual**2, axis=(1, 2))))
        for f in forecast_each(recording, sets, spans=spans, last_stamp=stop)
    ]


def _coarser(task: tuple[Manipulation, Settings, Settings, int, int]) -> list[Forecast | None]:
    """Forecasts with longer time steps, and with fewer knot spans."""
    recording, current, steps, spans, half = task
    return [
        *forecast_each(recording, [steps], spans=spans),
        *forecast_each(recording, [current], spans=half),
    ]


def count_numbers(residual: FloatArray) -> int:
    """Numbers of a residual that carry information: planar recordings have no y."""
    squares = np.sum(residual**2, axis=(0, 1))
    active = int(np.count_nonzero(squares > 1e-9 * max(float(squares.max()), 1e-300)))
    frames, n, _ = (int(k) for k in residual.shape)
    return frames * n * max(active, 1)


def best_start(
    train: Sequence[Manipulation],
    settings: Settings,
    guess: FloatArray,
    progress: Progress,
    simulations: Simulations,
) -> FloatArray:
    """The start with the smallest residual: far away a shape may lie on another branch.

    Raises:
        SimulationError: no start can be simulated.
    """
    spans = 2 * (settings.rod.control_points - 3)
    settings = stepping(settings, max(settings.simulation.tolerance, SCAN_TOLERANCE))
    starts = []
    for factor in START_FACTORS:
        theta = guess.copy()
        theta[0] += np.log(factor)
        starts.append(theta)
    sets = [with_logarithms(settings, theta) for theta in starts]
    progress("trying starting values", 0.0)
    scans = simulations.pool.map(_scanned, [(recording, sets, spans) for recording in train])
    sums_of_squares = np.sum(scans, axis=0)
    best = int(np.argmin(sums_of_squares))
    if not np.isfinite(sums_of_squares[best]):
        raise SimulationError(
            f"{train[0].name}: no starting value of E can be simulated; check rod.length, the "
            "command and the first observed shape"
        )
    return starts[best]


def evaluate(
    train: Sequence[Manipulation],
    settings: Settings,
    guess: FloatArray,
    theta: FloatArray,
    simulations: Simulations,
    ignored: Sequence[np.ndarray] | None = None,
) -> MaterialFit:
    """Simulate all recordings with sensitivities at theta.

    Args:
        train: recordings.
        settings: settings of the search.
        guess: logarithms beforehand.
        theta: logarithms.
        simulations: pool and resolutions of the simulations.
        ignored: pictures of each recording that do not count, shape (F,) each.

    Raises:
        SimulationError: a recording cannot be simulated.
    """
    forecasts = simulations.vary(train, with_logarithms(settings, theta))
    size = len(theta)
    normal, gradient, sum_of_squares, count = np.zeros((size, size)), np.zeros(size), 0.0, 0
    for k, f in enumerate(forecasts):
        used = f if ignored is None else without(f, ignored[k])
        assert used.derivative is not None
        j = used.derivative.transpose(0, 2, 3, 1).reshape(-1, size)
        r = used.residual.ravel()
        # Each recording counts by its frames.
        normal += j.T @ j
        gradient += j.T @ r
        sum_of_squares += float(r @ r)
        count += count_numbers(used.residual)
    off = np.where(np.isfinite(guess), theta - guess, 0.0)
    prior = float(off @ search_information(settings) @ off)
    cost = 0.5 * count * np.log(max(sum_of_squares / count, NOISE_LIMIT**2)) + 0.5 * prior
    return MaterialFit(theta, forecasts, cost, normal, gradient, sum_of_squares, count)


def without(found: Forecast, ignored: np.ndarray) -> Forecast:
    """A forecast without some of its pictures."""
    if not ignored.any():
        return found
    kept = ~ignored
    return replace(
        found,
        stamps=found.stamps[kept],
        predicted=found.predicted[kept],
        residual=found.residual[kept],
        derivative=None if found.derivative is None else found.derivative[kept],
        err=found.err[kept],
    )


def outlier_pictures(forecasts: Sequence[Forecast]) -> list[np.ndarray]:
    """Outlier pictures of each recording; at most a fifth of them, else none."""
    masks = [outliers(f.residual) for f in forecasts]
    return [m if m.mean() < MOST_GROSS else np.zeros_like(m) for m in masks]


def descend(
    train: Sequence[Manipulation],
    settings: Settings,
    guess: FloatArray,
    theta: FloatArray,
    progress: Progress,
    simulations: Simulations,
    ignored: Sequence[np.ndarray] | None = None,
    *,
    converged: float = CONVERGED,
    begun: MaterialFit | None = None,
) -> tuple[MaterialFit, int, bool]:
    """Levenberg-Marquardt; see `evaluate`.

    Args:
        converged: change of a logarithm at which it stops.
        begun: evaluation at theta, where it is known.

    Returns:
        The best point, the iterations, and whether it has converged.
    """
    prior = search_information(settings)
    fit = begun or evaluate(train, settings, guess, theta, simulations, ignored)
    damping = 1e-3
    for iteration in range(1, MAX_ITERATIONS + 1):
        progress("fitting", iteration / MAX_ITERATIONS)
        scale = fit.count / max(fit.sum_of_squares, fit.count * NOISE_LIMIT**2)
        off = np.where(np.isfinite(guess), fit.theta - guess, 0.0)
        normal = scale * fit.normal + prior
        correlation_time = autocorrelation_time(fit.forecasts)
        judged = normal / correlation_time
        slope = scale * fit.gradient - prior @ off
        accepted = False
        for _ in range(12):
            lhs = normal + damping * np.diag(np.diag(normal))
            step = np.asarray(np.linalg.solve(lhs, slope), dtype=np.float64)
            step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
            if _negligible(step, judged, converged):
                return fit, iteration, True
            try:
                trial = evaluate(train, settings, guess, fit.theta + step, simulations, ignored)
            except SimulationError:
                damping = max(damping, 1e-3) * 10.0
                continue
            if trial.cost <= fit.cost + 1e-9 * abs(fit.cost):
                accepted = True
                break
            damping = max(damping, 1e-3) * 10.0
        if not accepted:
            return fit, iteration, True
        gained = fit.cost - trial.cost
        fit = trial
        LOG.debug("iteration %d: cost %.4f, %.4f less", iteration, fit.cost, gained)
        damping *= 0.1
        if gained < LEAST_GAIN * correlation_time and damping < 1e-2:
            return fit, iteration, True
    LOG.warning("the fit has not converged after %d iterations", MAX_ITERATIONS)
    return fit, MAX_ITERATIONS, False


def autocorrelation_time(forecasts: Sequence[Forecast]) -> float:
    """Integrated autocorrelation time of the residuals, in pictures."""
    residuals = [f.residual for f in forecasts]
    return correlation_length(residuals, 0) * correlation_length(residuals, 1)


def _negligible(step: FloatArray, normal: FloatArray, converged: float) -> bool:
    """Whether a step is small, or far below the standard deviations."""
    sigmas = float(np.sqrt(max(float(step @ normal @ step), 0.0)))
    return float(np.abs(step).max()) < converged or sigmas < 0.01


def numerical_shifts(
    train: Sequence[Manipulation],
    settings: Settings,
    fit: MaterialFit,
    ignored: Sequence[np.ndarray],
    simulations: Simulations,
) -> list[FloatArray]:
    """Shifts of the estimate by time steps and knot spans of the simulation, each (4,).

    They follow from coarser simulations: the error of the time steps falls with their square, that
    of cubic splines at least with the third power.
    """
    current = with_logarithms(settings, fit.theta)
    steps = stepping(current, STEP_COARSER**3 * current.simulation.tolerance)

    published = settings.rod.control_points - DEGREE
    tasks = [
        (recording, current, steps, f.spans, max(f.spans // 2, published))
        for recording, f in zip(train, fit.forecasts, strict=True)
    ]
    moved = np.zeros((2, len(fit.theta)))
    for found, mask, others in zip(
        fit.forecasts, ignored, simulations.pool.map(_coarser, tasks), strict=True
    ):
        assert found.derivative is not None
        halved = 1.0 if others[1] is None or others[1].spans < found.spans else 0.0
        shares = (1.0 / (STEP_COARSER**2 - 1.0), halved / 7.0)
        for k, (other, share) in enumerate(zip(others, shares, strict=True)):
            if other is not None:
                gap = np.where(mask[:, None, None], 0.0, other.residual - found.residual)
                moved[k] += share * np.einsum("fpic,fic->p", found.derivative, gap)
    inverse = np.linalg.pinv(fit.normal, rcond=1e-9, hermitian=True)
    return [inverse @ m for m in moved]


def recentred(
    fit: MaterialFit, guess: FloatArray, known: FloatArray, information: FloatArray
) -> FloatArray:
    """The best logarithms with the information that the data have after correlation.

    While searching, the data count as white, which gives them too much weight against the prior.

    Args:
        fit: the point at which the search ended.
        guess: logarithms beforehand.
        known: information (4, 4) beforehand.
        information: information (4, 4) of the data.
    """
    off = np.where(np.isfinite(guess), fit.theta - guess, 0.0)
    # Where the data alone would go, in the directions that they determine.
    wanted = np.linalg.pinv(fit.normal, rcond=1e-9, hermitian=True) @ fit.gradient
    step = np.linalg.solve(information + known, information @ wanted - known @ off)
    return np.asarray(fit.theta + step)
