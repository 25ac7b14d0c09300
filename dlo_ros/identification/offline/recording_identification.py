# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Identify (E, mu) from whole recordings: parallel starts, then least squares on logarithms."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

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
from dlo_ros.identification.offline.material_fit import (
    MaterialFit,
    Progress,
    best_start,
    evaluate,
    numerical_shifts,
    outlier_pictures,
    recentred,
    searched,
    without,
)
from dlo_ros.identification.offline.recording_simulations import Simulations
from dlo_ros.identification.offline.set_up_estimate import weighed
from dlo_ros.identification.offline.wrench_identification import (
    ForceInformation,
    information_with_forces,
)
from dlo_ros.identification.residual_information import data_information
from dlo_ros.identification.residual_noise import noise_floor
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.inference.parallel import Pool, Threads
from dlo_ros.inference.time_steps import typical_distance
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

COARSE_CONVERGED = 1e-2  # gain over the misfit at which the search goes on with a finer simulation
MOVED = 1e-4  # change of a logarithm that asks for another simulation


@dataclass(frozen=True)
class RecordingResult:
    """The agreement of one recording with the model.

    Args:
        name: name of the recording.
        role: `train` or `validate`.
        err, err_initial: time mean of eq. (10) with the estimate and with the initial guess [m];
            None where the simulation failed.
        forecast: forecast of the recording with the estimate.
        noise_floor: the err that a perfect model would have [m], None where unknown.
        before: forecast with the initial guess.
    """

    name: str
    role: str
    err: float | None
    err_initial: float | None
    forecast: Forecast | None
    noise_floor: float | None
    before: Forecast | None = None


@dataclass(frozen=True)
class Identification:
    """The result of `identify`.

    Args:
        estimate: estimate of the parameters.
        recordings: agreement of each recording with the model, `train` before `validate`.
        noise_floor: the err that a perfect model would have [m], None where unknown.
        converged: whether the fit has converged.
        fitted: the fit itself; None where a result was put together otherwise.
        set_up: estimated numbers of the set-up with standard deviations; empty where the data
            support an exact set-up.
    """

    estimate: Estimate
    recordings: tuple[RecordingResult, ...]
    noise_floor: float | None
    converged: bool
    fitted: FittedMaterial | None = None
    set_up: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def identify(
    train: Sequence[Manipulation],
    settings: Settings,
    validate: Sequence[Manipulation] = (),
    *,
    progress: Progress = lambda text, share: None,
    pool: Pool | None = None,
) -> Identification:
    """Fit ln (E, mu, c, t_r) to recordings; c and t_r are nuisances unless they are known.

    The set-up counts as known to its tolerances, see `set_up_estimate`.

    Args:
        train: recordings that determine the estimate.
        settings: initial guess and what is known beforehand.
        validate: recordings that are only predicted.
        progress: function that is called with the name of the present step and the fraction of it
            that is done.
        pool: pool in which simulations run; default: threads.

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
    found = fitted(train, settings, progress, pool)
    progress("looking at the set-up", 0.9)
    found, known = _with_set_up(train, found, settings, pool)
    progress("looking at the forces", 0.95)
    found = _with_forces(train, found, settings, known, pool)
    settings = settings.with_effects(found.settings.effects)
    fit, theta, information = found.fit, found.theta, found.information
    estimate = summarise(settings, theta, information)
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
                    before,
                )
            )
    floors = [r.noise_floor for r in results if r.role == "train" and r.noise_floor is not None]
    return Identification(
        estimate,
        tuple(results),
        float(np.mean(floors)) if floors else None,
        found.converged,
        found,
        known,
    )


@dataclass(frozen=True)
class FittedMaterial:
    """The result of the search.

    Args:
        fit: the fit with forecasts of all pictures.
        theta: ln (E, mu, c, t_r).
        information: information of the data on them (4, 4).
        ignored: outlier pictures of each recording, shape (F,) each.
        settings: settings with the tolerance that was needed.
        long_steps: tolerance of time steps that a search may take; None: that of the settings.
        shifts: shifts by which the simulation's own error may have moved theta, each (4,).
        forces: information of measured forces, which theta and the information contain; None: there
            are no forces.
    """

    fit: MaterialFit
    theta: FloatArray
    information: FloatArray
    ignored: list[np.ndarray]
    settings: Settings
    long_steps: float | None
    converged: bool
    shifts: Sequence[FloatArray] = ()
    forces: ForceInformation | None = None


def fitted(
    train: Sequence[Manipulation],
    settings: Settings,
    progress: Progress = lambda text, share: None,
    pool: Pool | None = None,
) -> FittedMaterial:
    """Search from several starts, then with a simulation whose own error lies below the noise.

    Args:
        train: recordings.
        settings: settings as `searchable` gives them.
        progress: see `identify`.
        pool: pool in which simulations run; default: threads.
    """
    guess, simulations = logarithms(settings), Simulations(pool or Threads())
    theta = best_start(train, settings, guess, progress, simulations)
    LOG.info("best start: %s", _words(theta))
    progress("fitting", 0.1)
    here = with_logarithms(settings, theta)
    forecasts = simulations.vary(train, here)
    none = [np.zeros(len(f.stamps), dtype=bool) for f in forecasts]
    long_steps = simulations.long_steps(train, here, forecasts)
    coarse = partial(searched, train, settings, converged=COARSE_CONVERGED)
    found = coarse(theta, forecasts, none, tolerance=long_steps)
    forecasts = simulations.vary(train, with_logarithms(settings, found.theta))
    ignored = outlier_pictures(forecasts)
    LOG.info(
        "coarse fit: %s; %d pictures left out",
        _words(found.theta), sum(int(m.sum()) for m in ignored),
    )  # fmt: skip
    if any(mask.any() for mask in ignored):
        # They have bent the search so far.
        found = coarse(found.theta, forecasts, ignored, tolerance=long_steps)
        forecasts = simulations.vary(train, with_logarithms(settings, found.theta))
        ignored = outlier_pictures(forecasts)
    progress("fitting", 0.5)
    here = with_logarithms(settings, found.theta)
    long_steps = simulations.long_steps(train, here, forecasts)
    fine = within_noise(settings, typical_distance([f.residual for f in forecasts]))
    try:
        forecasts = simulations.vary(train, with_logarithms(fine, found.theta))
        found = searched(train, fine, found.theta, forecasts, ignored)
    except SimulationError as err:
        LOG.warning("a finer simulation fails (%s); its error is larger than wanted", err)
        fine = settings
        found = searched(train, settings, found.theta, forecasts, ignored)
    LOG.info("fine fit%s: %s", "" if found.converged else " (not converged)", _words(found.theta))
    fit = evaluate(train, fine, found.theta, simulations, ignored)
    used = [without(f, mask) for f, mask in zip(fit.forecasts, ignored, strict=True)]
    shifts = numerical_shifts(train, fine, fit, ignored, simulations)
    information = data_information(used, with_logarithms(fine, fit.theta), shifts)
    theta = recentred(fit, guess, search_information(settings), information)
    if float(np.abs(theta - fit.theta).max()) > MOVED:
        try:
            fit = evaluate(train, fine, theta, simulations, ignored)
        except SimulationError as err:
            LOG.warning("the estimate stays where the search ended: %s", err)
            theta = fit.theta
    return FittedMaterial(
        fit, theta, information, ignored, fine, long_steps, found.converged, shifts
    )


def _with_set_up(
    train: Sequence[Manipulation], found: FittedMaterial, given: Settings, pool: Pool | None
) -> tuple[FittedMaterial, Mapping[str, tuple[float, float]]]:
    """The fit with the set-up open within its tolerances, and the set-up's numbers."""
    spans = [f.spans for f in found.fit.forecasts]
    more = weighed(
        train, found.settings, found.theta, found.information, found.ignored, spans, given,
        found.shifts, found.long_steps,
    )  # fmt: skip
    for name, (value, std) in more.values.items():
        LOG.info("set-up: %s = %.4g +- %.2g", name, value, std)
    if not more.values:
        LOG.info("the set-up is taken as stated")
        return replace(found, information=more.information), more.values
    fine = found.settings.with_effects(more.settings.effects)
    simulations = Simulations(pool or Threads())
    try:
        fit = evaluate(train, fine, more.theta, simulations, found.ignored)
    except SimulationError as err:
        LOG.warning("the set-up is taken as exact: %s", err)
        return found, {}
    found = replace(found, fit=fit, theta=more.theta, information=more.information, settings=fine)
    return found, more.values


def _words(theta: FloatArray) -> str:
    """The parameters, for the log.

    Args:
        theta: ln (E, mu, c, t_r).
    """
    modulus, density, drag, time = np.exp(theta)
    return f"E/mu {modulus / density:.5g} m^2/s^2, c {drag:.3g} N s/m^2, t_r {time:.3g} s"


def _with_forces(
    train: Sequence[Manipulation], found: FittedMaterial, given: Settings,
    known: Mapping[str, tuple[float, float]], pool: Pool | None,
) -> FittedMaterial:  # fmt: skip
    """The fit with the forces that were measured at the grips."""
    spans = [f.spans for f in found.fit.forecasts]
    try:
        forces = information_with_forces(
            train, found.settings, found.theta, found.information, given, spans, known, pool
        )
        if forces is None:
            return found
        simulations = Simulations(pool or Threads())
        fit = evaluate(train, found.settings, forces.theta, simulations, found.ignored)
    except SimulationError as err:
        LOG.warning("measured forces are not used: %s", err)
        return found
    information = found.information + forces.information
    return replace(found, fit=fit, theta=forces.theta, information=information, forces=forces)


def _attempt(recording: Manipulation, settings: Settings) -> Forecast | None:
    try:
        return forecast(recording, settings)
    except SimulationError as err:
        LOG.warning("%s cannot be simulated: %s", recording.name, err)
        return None
