# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Identify (E, mu) from whole recordings, the set-up known to its tolerances."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import Estimate, searchable, summarise
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.identification.offline.set_up_estimate import MaterialFit, weighed
from dlo_ros.identification.offline.wrench_identification import (
    ForceInformation,
    information_with_forces,
    with_scale_of_forces,
)
from dlo_ros.identification.residual_noise import noise_floor
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.inference.joint import as_fine
from dlo_ros.inference.parallel import Pool
from dlo_ros.parameters import Settings
from dlo_ros.spline import SplineBasis

LOG = logging.getLogger(__name__)

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class RecordingResult:
    """The agreement of one recording with the model.

    Args:
        name: name of the recording.
        role: `train` or `validate`.
        forecast, before: forecasts of the recording with the estimate and with the initial guess;
            None where the simulation failed.
        noise_floor: the err that a perfect model would have [m], None where unknown.
    """

    name: str
    role: str
    forecast: Forecast | None
    before: Forecast | None
    noise_floor: float | None

    @property
    def err(self) -> float | None:
        """Time mean of eq. (10) with the estimate [m]."""
        return None if self.forecast is None else float(self.forecast.err.mean())

    @property
    def err_initial(self) -> float | None:
        """Time mean of eq. (10) with the initial guess [m]."""
        return None if self.before is None else float(self.before.err.mean())


@dataclass(frozen=True)
class Identification:
    """The result of `identify`.

    Args:
        estimate: estimate of the parameters.
        recordings: agreement of each recording with the model, `train` before `validate`.
        fitted: the fit itself.
        forces: information of measured forces, which the estimate contains; None: there are none.
    """

    estimate: Estimate
    recordings: tuple[RecordingResult, ...]
    fitted: MaterialFit
    forces: ForceInformation | None = None

    @property
    def noise_floor(self) -> float | None:
        """The err that a perfect model would have [m], None where unknown."""
        own = (r.noise_floor for r in self.recordings if r.role == "train")
        floors = [floor for floor in own if floor is not None]
        return float(np.mean(floors)) if floors else None


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
    given, settings = settings, searchable(settings)
    progress("fitting", 0.1)
    begun = begin(train, settings)
    progress("looking at the set-up", 0.6)
    found = weighed(begun, settings)
    LOG.info("E/mu %.5g m^2/s^2", found.settings.rod.specific_modulus)
    for name, (value, std) in found.set_up.items():
        LOG.info("set-up: %s = %.4g +- %.2g", name, value, std)
    progress("looking at the forces", 0.9)
    found, forces = _with_forces(train, found, settings, pool)
    estimate = summarise(
        settings.with_effects(found.settings.effects), found.theta, found.information
    )
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    results = []
    for role, group in (("train", train), ("validate", validate)):
        for k, recording in enumerate(group):
            progress(f"predicting {recording.name}", 1.0)
            here, spans = estimate.settings, None
            if role == "train":
                here, spans = as_fine(here, found.recordings[k]), found.recordings[k].spans
            after, before = _attempt(recording, here, spans), _attempt(recording, given)
            floor = noise_floor(recording.observations, basis, after)
            results.append(RecordingResult(recording.name, role, after, before, floor))
    return Identification(estimate, tuple(results), found, forces)


def _with_forces(
    train: Sequence[Manipulation], found: MaterialFit, given: Settings, pool: Pool | None
) -> tuple[MaterialFit, ForceInformation | None]:
    """The fit with the forces that were measured at the grips, and their information."""
    try:
        forces = information_with_forces(train, found, given, pool)
        if forces is None:
            return found, None
        return with_scale_of_forces(found, forces), forces
    except SimulationError as err:
        LOG.warning("measured forces are not used: %s", err)
        return found, None


def _attempt(
    recording: Manipulation, settings: Settings, spans: int | None = None
) -> Forecast | None:
    try:
        return forecast(recording, settings, spans=spans)
    except (SimulationError, InputError) as err:  # such as too few shapes, to validate with
        LOG.warning("%s cannot be simulated: %s", recording.name, err)
        return None
