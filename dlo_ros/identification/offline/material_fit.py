# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The material fit: parallel starts, then least squares on the logarithms of the parameters.

The search is that of `dlo_ros.inference.joint_fit`. Where it has ended, derivatives are exact or
differences of simulations with shared steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import SimulationError
from dlo_ros.identification.batched_forecast import forecast_each
from dlo_ros.identification.estimate import logarithms, with_logarithms
from dlo_ros.identification.material_model import material_model
from dlo_ros.identification.offline.recording_simulations import Simulations, stepping
from dlo_ros.inference.forecast import Forecast, Manipulation
from dlo_ros.inference.joint import evaluate as joint_evaluate
from dlo_ros.inference.joint_fit import expected_gain, fit
from dlo_ros.inference.losses import WhiteLoss
from dlo_ros.inference.measured import Recording, measured, outliers
from dlo_ros.inference.thresholds import MOST_GROSS
from dlo_ros.parameters import Settings
from dlo_ros.spline import DEGREE, FloatArray

START_FACTORS = (1.0, 1 / 100, 1 / 30, 1 / 10, 1 / 3, 3.0, 10.0, 30.0, 100.0)  # of E/mu
SCAN_SECONDS = 4.0  # of each recording, for the comparison of starts
MAX_ITERATIONS = 30
CONVERGED = 1e-4  # gain over the misfit
STEP_COARSER = 2.0  # of the time steps, to see what they do
SCAN_TOLERANCE = 1e-3  # of the simulations by which starts are compared

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class MaterialFit:
    """A point of the search.

    Args:
        theta: ln (E, mu, c, t_r).
        forecasts: forecasts of all recordings, with derivatives.
        normal: J^T J summed over recordings (4, 4) [m^2].
        gradient: J^T r (4,).
    """

    theta: FloatArray
    forecasts: list[Forecast]
    normal: FloatArray
    gradient: FloatArray


@dataclass(frozen=True)
class Searched:
    """Where a search has ended: ln (E, mu, c, t_r), and whether it has converged."""

    theta: FloatArray
    converged: bool


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
    theta: FloatArray,
    simulations: Simulations,
    ignored: Sequence[np.ndarray],
) -> MaterialFit:
    """Simulate all recordings with sensitivities at theta.

    Args:
        train: recordings.
        settings: settings of the search.
        theta: logarithms.
        simulations: pool and resolutions of the simulations.
        ignored: pictures of each recording that do not count, shape (F,) each.

    Raises:
        SimulationError: a recording cannot be simulated.
    """
    forecasts = simulations.vary(train, with_logarithms(settings, theta))
    size = len(theta)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    for f, mask in zip(forecasts, ignored, strict=True):
        used = without(f, mask)
        assert used.derivative is not None
        j = used.derivative.transpose(0, 2, 3, 1).reshape(-1, size)
        # Each recording counts by its frames.
        normal += j.T @ j
        gradient += j.T @ used.residual.ravel()
    return MaterialFit(theta, forecasts, normal, gradient)


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


def searched(
    train: Sequence[Manipulation],
    settings: Settings,
    theta: FloatArray,
    forecasts: Sequence[Forecast],
    ignored: Sequence[np.ndarray],
    *,
    tolerance: float | None = None,
    converged: float = CONVERGED,
) -> Searched:
    """Least squares from a point, with simulations that stay as fine as they are there.

    Args:
        train: recordings.
        settings: the parameter file, perhaps with a set-up, and the tolerance of its simulations.
        theta: logarithms from where it begins.
        forecasts: forecasts of the recordings there.
        ignored: see `evaluate`.
        tolerance: tolerance of the time steps; None: that of the settings.
        converged: gain over the misfit at which it ends.

    Raises:
        SimulationError: a recording cannot be simulated where it begins.
    """
    step = tolerance or settings.simulation.tolerance
    recordings = [
        replace(seen(r, mask, settings), spans=f.spans, tolerance=step)
        for r, mask, f in zip(train, ignored, forecasts, strict=True)
    ]
    model = material_model(with_logarithms(settings, theta), settings)
    loss = WhiteLoss(converged=converged)
    at = fit(joint_evaluate(model, recordings), recordings, MAX_ITERATIONS, loss=loss)
    return Searched(logarithms(at.model.settings), expected_gain(at, loss) < loss.least_gain(at))


def seen(recording: Manipulation, ignored: np.ndarray, settings: Settings) -> Recording:
    """A recording without its outlier pictures, shape (F,) of the last F."""
    if ignored.any():
        # A forecast may leave out the first picture, from where the motion starts.
        first = len(recording.observations) - len(ignored)
        kept = [
            o for k, o in enumerate(recording.observations) if k < first or not ignored[k - first]
        ]
        recording = replace(recording, observations=tuple(kept))
    return measured(recording, settings)


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
