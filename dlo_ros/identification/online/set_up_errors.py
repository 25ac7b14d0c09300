# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Errors of the live estimate by a set-up that is right only within its tolerances.

They are computed again as the DLO moves. The estimate is that of the set-up as the parameter file
states it, which is what a running simulation has. As in `identify` that model is weighed by its
evidence against one with every number of the set-up open within its tolerance (Hoeting et al.,
Bayesian model averaging: a tutorial, 1999), here linear about the estimate; the difference between
both is an error of the estimate.

One of these numbers is the delay between commands and pictures, as where two clocks differ, which a
running simulation can make up for. A turned clamp and another material fit a delayed motion, too,
and far from the estimate the open model is not linear: it is linearised again until the delay stays
what it is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import expit

from dlo_ros.effects.measurement.command_delay import CommandDelay
from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.estimate import Estimate
from dlo_ros.identification.gradual_simulation import simulated
from dlo_ros.identification.online.accumulated_information import fitted_variances
from dlo_ros.identification.online.linearised_model import PriorInformation, Run
from dlo_ros.identification.online.observed_window import ObservedWindow
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.measured import Recording, measured
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import DIAMETER_STD, joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.spectrum import spectrum
from dlo_ros.inference.thresholds import SMALL_SHARE
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

BEGINNING = 3  # observations before there is an estimate
SETTLED = 0.8  # [s] of past before which neither tolerances nor resolution are worth a look
SET_UP_GROWTH = 1.5  # of the past after which the set-up's tolerances are looked at again
LINEARISATIONS = 8
"""Linearisations at a time; the next time goes on from there. 0.1 s takes up to a dozen."""
UNCHANGED = 0.3
"""Step of the delay, over its std, from which on it is found: the steps halve, so that what is left
is less than the std."""


class SetUpErrors:
    """Errors of the estimate by a set-up that is right only within its tolerances.

    Args:
        given: the parameter file, which states the set-up.

    Attributes:
        shifts: independent errors of ln (E, mu, c, t_r) with unit variance, each (4,); none where
            no number of the set-up has a tolerance, and where shapes leave the plane: there the
            set-up counts as exact.
        delay: posterior mean and std of the time by which the DLO is seen to move later than
            commanded [s]; None: not found (yet), stated in the parameter file, or shapes that
            leave the plane.
    """

    def __init__(self, given: Settings) -> None:
        self.shifts: tuple[FloatArray, ...] = ()
        self.delay: tuple[float, float] | None = None
        self._given = given
        self._last: dict[str, float] = {}  # where the model was linearised last, by name
        self._examined: tuple[int, float] = (0, math.nan)  # when: observations, ln(E/mu)

    def due(self, run: Run | None, past: ObservedWindow, estimate: Estimate) -> bool:
        """Whether to compute the errors, while the start of the motion is in the window.

        Args:
            run: the present one.
            past: the observations.
            estimate: the estimate, whose E/mu may have changed since.
        """
        if run is None or past.anchor is not None or run.used < BEGINNING or past.elapsed < SETTLED:
            return False
        used, ratio = self._examined
        other = abs(math.log(estimate.specific_modulus) - ratio) > SMALL_SHARE
        return not used or other or run.used > SET_UP_GROWTH * used

    def compute(
        self, run: Run | None, past: ObservedWindow, estimate: Estimate, prior: PriorInformation
    ) -> Pieces[None]:
        """Compute the errors piece by piece: linearise the open model at the estimate, and on.

        Args:
            run, past, estimate: see `due`.
            prior: prior information with which the estimate weighs pictures.

        Raises:
            SimulationError: the motion cannot be simulated.
        """
        seen = past.manipulation()
        if run is None or seen is None:
            return
        self._examined = (run.used, math.log(estimate.specific_modulus))
        scale, settings = prior.scale(run.at, prior.step(run.at)), estimate.settings
        recording = replace(measured(seen, settings), spans=run.simulation.basis.even_spans)
        view = scene(settings, imposed_names([seen]), [recording.observed])
        model = joint_model(settings, self._given, view)
        if not recording.planar or not any(p.effect for p in model.parameters):
            self.shifts, self.delay = (), None
            return
        here = yield from _linearised(model, recording)
        self.shifts = yield from _shifts(here, scale, prior.prior)
        name = CommandDelay.parameter("delay")
        if name not in model.names:
            return
        k, last, self._last = model.index(name), self._last, {}
        # A command may have brought another grip, which has numbers of its own.
        pairs = zip(model.names, model.theta(), strict=True)
        theta = np.array([last.get(n, x) for n, x in pairs]) if last else None
        for _ in range(LINEARISATIONS):
            if theta is not None:
                here = yield from _linearised(model.at(theta), recording)
            step, variance = here.posterior.step, float(here.posterior.covariance[k, k])
            theta, self.delay = here.model.theta() + step, None
            if abs(step[k]) < UNCHANGED * np.sqrt(variance):
                # The error of the simulation is no noise that more pictures average out.
                off = settings.simulation.tolerance * settings.rod.length
                prior_std = model.parameters[k].std
                speed = max(float(np.sqrt(np.mean(here.fields[0][1][:, k] ** 2))), off / prior_std)
                shift = (1.0 - variance / prior_std**2) * off / speed
                self.delay = float(theta[k]), float(np.hypot(np.sqrt(variance), shift))
                break
        self._last = {} if theta is None else dict(zip(model.names, theta.tolist(), strict=True))


def _linearised(model: ParametricModel, recording: Recording) -> Pieces[Evaluation]:
    """The open model linearised at its values, piece by piece."""
    found = yield from simulated(model, recording, model.names)
    yield LONG
    rod, (field,) = model.settings.rod, found.fields
    bins = spectrum(*field, rod.control_points, *found.motions)
    fitted = yield from fitted_variances(bins, model.offset(), model.precision(), rod.length)
    return Evaluation(
        model, found.fields, found.err, found.predicted, found.motions, (bins,), *fitted
    )


def _shifts(here: Evaluation, scale: float, prior: FloatArray) -> Pieces[tuple[FloatArray, ...]]:
    """Errors of the estimate, see `SetUpErrors`, piece by piece.

    Args:
        scale: information per squared metre of a residual number in the estimate [1/m^2].
        prior: information on ln (E, mu, c, t_r) beside that of the pictures, shape (4, 4).
    """
    model, opened, rod = here.model, here.posterior, here.model.settings.rod
    own = np.array([not p.effect for p in model.parameters])
    pick, set_up = np.flatnonzero(own), np.flatnonzero(~own)
    plain = here.spectra[0].chosen(pick.tolist())
    offset, precision = model.offset()[pick], model.precision()[pick]
    _, exact = yield from fitted_variances(plain, offset, precision, rod.length)
    probability = float(expit(opened.evidence - exact.evidence))
    off = opened.step[set_up]
    square = opened.covariance[np.ix_(set_up, set_up)] + np.outer(off, off)
    place = [MATERIAL.index(model.names[k]) for k in pick]
    j = here.fields[0][1].transpose(1, 0, 2).reshape(len(own), -1)
    lhs = prior[np.ix_(place, place)] + scale * (j[pick] @ j[pick].T)
    moves = np.zeros((len(MATERIAL), len(set_up)))
    moves[place] = scale * np.linalg.solve(lhs, j[pick] @ j[set_up].T)
    covariance = moves @ square @ moves.T
    if not rod.diameter_std:
        young_modulus = MATERIAL.index("young_modulus")
        covariance[young_modulus, young_modulus] += (2.0 * DIAMETER_STD) ** 2
    values, vectors = np.linalg.eigh(probability * covariance)
    return tuple(vectors.T * np.sqrt(np.maximum(values, 0.0))[:, None])
