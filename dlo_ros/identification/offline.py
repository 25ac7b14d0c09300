"""Identify (E, mu) from whole recordings: parallel starts, then Gauss-Newton on logarithms."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import (
    Estimate,
    logarithms,
    search_information,
    searchable,
    summarise,
    with_logarithms,
    within_noise,
)
from dlo_ros.identification.forecast import Forecast, Manipulation, forecast
from dlo_ros.identification.noise import correlation_length, noise_floor
from dlo_ros.parameters import Settings
from dlo_ros.rod.tangents import MATERIAL
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

START_FACTORS = (1.0, 1 / 100, 1 / 30, 1 / 10, 1 / 3, 3.0, 10.0, 30.0, 100.0)  # of E/mu
SCAN_SECONDS = 4.0  # of each recording, for the comparison of starts
MAX_ITERATIONS = 30
CONVERGED = 1e-4  # change of a logarithm
LONGEST_STEP = 1.5  # change of a logarithm in one iteration
NOISE_LIMIT = 1e-7  # [m]: residuals below are rounding

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class RecordingResult:
    """How one recording is matched.

    Args:
        name: of the recording.
        role: `train` or `validate`.
        err, err_initial: time mean of eq. (10) with the estimate and with the initial guess [m];
            None where the simulation failed.
        forecast: with the estimate.
        noise_floor: the err that a perfect model would have [m], None where unknown.
    """

    name: str
    role: str
    err: float | None
    err_initial: float | None
    forecast: Forecast | None
    noise_floor: float | None


@dataclass(frozen=True)
class Identification:
    """What `identify` found."""

    estimate: Estimate
    recordings: tuple[RecordingResult, ...]
    noise_floor: float | None
    iterations: int
    converged: bool


@dataclass(frozen=True)
class _Fit:
    theta: FloatArray
    forecasts: list[Forecast]
    cost: float
    normal: FloatArray  # J^T J summed over recordings (4, 4) [m^2]
    gradient: FloatArray  # J^T r (4,)
    power: float  # sum of squared residuals [m^2]
    count: int  # residual numbers that can differ from zero


def identify(
    train: Sequence[Manipulation],
    settings: Settings,
    validate: Sequence[Manipulation] = (),
    *,
    progress: Progress = lambda text, share: None,
) -> Identification:
    """Fit ln (E, mu, c, t_r) to recordings; c and t_r are nuisances unless they are known.

    Args:
        train: recordings that determine the estimate.
        settings: initial guess and what is known beforehand.
        validate: recordings that are only predicted.
        progress: called with what is being done and the share of it that is done.

    Raises:
        InputError: no usable recording.
        SimulationError: no start can be simulated at all.
    """
    if not train:
        raise InputError("no recording to identify from; give at least one bag")
    for recording in train:
        if not recording.commands:
            raise InputError(f"{recording.name}: has no usable dlo/command")
        if not recording.observations:
            raise InputError(f"{recording.name}: has no usable dlo/observed")
    given, settings = settings, searchable(settings)
    guess = logarithms(settings)
    theta = _best_start(train, settings, guess, progress)
    fit, iterations, converged = _descend(train, settings, guess, theta, progress)
    rms = float(np.sqrt(fit.power / sum(len(f.stamps) for f in fit.forecasts)))
    fine = within_noise(settings, rms)
    if fine != settings:
        # The simulation's own error must lie below the noise, or it would bias the estimate.
        fit, more, converged = _descend(train, fine, guess, fit.theta, progress)
        iterations += more
    estimate = summarise(settings, fit.theta, data_information(fit.forecasts))
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    results = []
    for role, group in (("train", train), ("validate", validate)):
        for k, recording in enumerate(group):
            progress(f"predicting {recording.name}", 1.0)
            with_estimate = fit.forecasts[k] if role == "train" else None
            if with_estimate is None:
                with_estimate = _attempt(recording, estimate.settings)
            before = _attempt(recording, given)
            results.append(
                RecordingResult(
                    recording.name,
                    role,
                    float(with_estimate.err.mean()) if with_estimate else None,
                    float(before.err.mean()) if before else None,
                    with_estimate,
                    noise_floor(recording.observations, basis),
                )
            )
    floors = [r.noise_floor for r in results if r.role == "train" and r.noise_floor is not None]
    return Identification(
        estimate,
        tuple(results),
        float(np.mean(floors)) if floors else None,
        iterations,
        converged,
    )


def data_information(forecasts: Sequence[Forecast]) -> FloatArray:
    """Information of residuals on the logarithms, shape (4, 4), for what they really are.

    The noise is what is left over, model errors included; residuals that repeat along the DLO or
    in time count once. Where recordings pull apart more than that explains, the information is
    reduced until they agree (Birge ratio, on the direction of ln E).
    """
    normals, gradients, residuals = [], [], []
    for f in forecasts:
        assert f.derivative is not None
        j = f.derivative.transpose(0, 2, 3, 1).reshape(-1, f.derivative.shape[1])
        normals.append(j.T @ j)
        gradients.append(j.T @ f.residual.ravel())
        residuals.append(f.residual)
    power = sum(float(np.sum(r**2)) for r in residuals)
    count = sum(_count(r) for r in residuals)
    repeats = correlation_length(residuals, 0) * correlation_length(residuals, 1)
    independent = max(count / repeats, 1.0)
    freedom = max(independent - 2.0, 0.5)
    variance = max(power / count * independent / freedom, NOISE_LIMIT**2)
    scale = 1.0 / (variance * repeats)
    if len(forecasts) > 1:
        pulls = [
            g[0] ** 2 * scale / max(h[0, 0], 1e-300)
            for g, h in zip(gradients, normals, strict=True)
        ]
        scale /= max(1.0, float(np.sum(pulls)) / (len(pulls) - 1))
    total: FloatArray = np.sum(normals, axis=0) * scale
    return total


def _count(residual: FloatArray) -> int:
    """Numbers of a residual that carry information: planar recordings have no y."""
    power = np.sum(residual**2, axis=(0, 1))
    active = int(np.count_nonzero(power > 1e-9 * max(float(power.max()), 1e-300)))
    frames, n, _ = (int(k) for k in residual.shape)
    return frames * n * max(active, 1)


def _attempt(recording: Manipulation, settings: Settings) -> Forecast | None:
    try:
        return forecast(recording, settings)
    except SimulationError as err:
        LOG.warning("%s cannot be simulated: %s", recording.name, err)
        return None


def _best_start(
    train: Sequence[Manipulation], settings: Settings, guess: FloatArray, progress: Progress
) -> FloatArray:
    """The start with the smallest residual: far away a shape may lie on another branch."""
    best, smallest = None, np.inf
    last_error: SimulationError | None = None
    spans = 2 * (settings.rod.control_points - 3)
    for k, factor in enumerate(START_FACTORS):
        progress("trying starting values", k / len(START_FACTORS))
        theta = guess.copy()
        theta[0] += np.log(factor)
        power = 0.0
        try:
            for recording in train:
                stop = recording.observations[0].stamp + round(SCAN_SECONDS * NANOSECONDS)
                found = forecast(
                    recording, with_logarithms(settings, theta), spans=spans, last_stamp=stop
                )
                power += float(np.mean(np.sum(found.residual**2, axis=(1, 2))))
        except SimulationError as err:
            last_error = err
            continue
        if power < smallest:
            best, smallest = theta, power
    if best is None:
        raise last_error or SimulationError("no starting value can be simulated")
    return best


def _evaluate(
    train: Sequence[Manipulation], settings: Settings, guess: FloatArray, theta: FloatArray
) -> _Fit:
    """Simulate all recordings with sensitivities at theta."""
    current = with_logarithms(settings, theta)
    forecasts = [forecast(r, current, parameters=MATERIAL) for r in train]
    normal, gradient, power, count = np.zeros((4, 4)), np.zeros(4), 0.0, 0
    for f in forecasts:
        assert f.derivative is not None
        j = f.derivative.transpose(0, 2, 3, 1).reshape(-1, 4)
        r = f.residual.ravel()
        # Each recording counts by its frames.
        normal += j.T @ j
        gradient += j.T @ r
        power += float(r @ r)
        count += _count(f.residual)
    off = np.where(np.isfinite(guess), theta - guess, 0.0)
    prior = float(off @ search_information(settings) @ off)
    cost = 0.5 * count * np.log(max(power / count, NOISE_LIMIT**2)) + 0.5 * prior
    return _Fit(theta, forecasts, cost, normal, gradient, power, count)


def _descend(
    train: Sequence[Manipulation],
    settings: Settings,
    guess: FloatArray,
    theta: FloatArray,
    progress: Progress,
) -> tuple[_Fit, int, bool]:
    """Levenberg-Marquardt on the concentrated likelihood, in which the noise is unknown."""
    prior = search_information(settings)
    fit = _evaluate(train, settings, guess, theta)
    damping = 1e-3
    for iteration in range(1, MAX_ITERATIONS + 1):
        progress("fitting", iteration / MAX_ITERATIONS)
        scale = fit.count / max(fit.power, fit.count * NOISE_LIMIT**2)
        off = np.where(np.isfinite(guess), fit.theta - guess, 0.0)
        normal = scale * fit.normal + prior
        slope = scale * fit.gradient - prior @ off
        accepted = False
        for _ in range(12):
            lhs = normal + damping * np.diag(np.diag(normal))
            step = np.linalg.solve(lhs, slope)
            step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
            try:
                trial = _evaluate(train, settings, guess, fit.theta + step)
            except SimulationError:
                damping = max(damping, 1e-3) * 10.0
                continue
            if trial.cost <= fit.cost + 1e-9 * abs(fit.cost):
                accepted = True
                break
            if float(np.abs(step).max()) < CONVERGED:
                break
            damping = max(damping, 1e-3) * 10.0
        if not accepted:
            return fit, iteration, True
        small = float(np.abs(step).max()) < CONVERGED
        gained = fit.cost - trial.cost
        fit = trial
        damping *= 0.1
        if small or gained < 1e-6 * abs(fit.cost):
            return fit, iteration, True
    LOG.warning("the fit has not converged after %d iterations", MAX_ITERATIONS)
    return fit, MAX_ITERATIONS, False
