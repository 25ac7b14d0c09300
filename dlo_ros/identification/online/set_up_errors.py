# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Errors of the live estimate by a set-up that is right only within its tolerances.

They are computed again as the DLO moves. The estimate is that of the set-up as the parameter file
states it, which is what a running simulation has. As in `identify` that model is weighed by its
evidence against one with every number of the set-up open within its tolerance (Hoeting et al.,
Bayesian model averaging: a tutorial, 1999), here linear about the estimate; the difference between
both is an error of the estimate.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace

import numpy as np
from scipy.special import expit

from dlo_ros.errors import SimulationError
from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.estimate import Estimate
from dlo_ros.identification.gradual_simulation import simulated
from dlo_ros.identification.online.accumulated_information import fitted_variances
from dlo_ros.identification.online.delay_estimate import DelayEstimate
from dlo_ros.identification.online.linearised_model import PriorInformation, Run
from dlo_ros.identification.online.observed_window import ObservedWindow
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.measured import measured
from dlo_ros.inference.priors import DIAMETER_STD, joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.spectrum import spectrum
from dlo_ros.inference.thresholds import SMALL_SHARE
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

BEGINNING = 3  # observations before there is an estimate
SETTLED = 0.8  # [s] of past before which neither tolerances nor resolution are worth a look
SET_UP_GROWTH = 1.5  # of the past after which the set-up's tolerances are looked at again


class SetUpErrors:
    """Errors of the estimate by a set-up that is right only within its tolerances.

    Args:
        given: the parameter file, which states the set-up.

    Attributes:
        shifts: errors of ln (E, mu, c, t_r), see `_shifts`.
        delay: delay of what is seen behind the commands.
    """

    def __init__(self, given: Settings) -> None:
        self.shifts: tuple[FloatArray, ...] = ()
        self.delay = DelayEstimate(given)
        self._given = given
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
        """Compute the errors piece by piece.

        Args:
            run, past, estimate: see `due`.
            prior: prior information with which the estimate weighs pictures.
        """
        seen = past.manipulation()
        if run is None or seen is None:
            return
        self._examined = (run.used, math.log(estimate.specific_modulus))
        scale = prior.scale(run.at, prior.step(run.at))
        settings, spans = estimate.settings, run.simulation.basis.spans
        try:
            self.shifts = yield from _shifts(seen, settings, self._given, spans, scale, prior.prior)
            yield from self.delay.compute(seen, settings, spans)
        except SimulationError as err:
            LOG.info("the set-up's tolerances are not looked at: %s", err)


def _shifts(
    past: Manipulation, settings: Settings, given: Settings, spans: int, scale: float,
    prior: FloatArray,
) -> Pieces[tuple[FloatArray, ...]]:  # fmt: skip
    """Independent errors of ln (E, mu, c, t_r) with unit variance, each (4,), piece by piece.

    None where no number of the set-up has a tolerance, and where shapes leave the plane: there the
    set-up counts as exact.

    Args:
        past: commands and observations from the start of the simulation on.
        settings: settings with the estimate.
        given: the parameter file, whose values the priors lie around.
        spans: knot spans of the simulation.
        scale: information per squared metre of a residual number in the estimate [1/m^2].
        prior: information on ln (E, mu, c, t_r) beside that of the pictures, shape (4, 4).

    Raises:
        SimulationError: the motion cannot be simulated.
    """
    recording = replace(measured(past, settings), spans=spans)
    if not recording.planar:
        return ()
    view = scene(settings, imposed_names([past]), [recording.observed])
    model = joint_model(settings, given, view)
    own = np.array([not p.effect for p in model.parameters])
    if own.all():
        return ()
    ((residual, jacobian),) = (yield from simulated(model, recording, model.names)).fields
    yield LONG
    bins = spectrum(residual, jacobian, settings.rod.control_points)
    offset, precision, length = model.offset(), model.precision(), settings.rod.length
    pick = np.flatnonzero(own)
    _, opened = yield from fitted_variances(bins, offset, precision, length)
    plain = bins.chosen(pick.tolist())
    _, exact = yield from fitted_variances(plain, offset[pick], precision[pick], length)
    probability = float(expit(opened.evidence - exact.evidence))
    set_up = np.flatnonzero(~own)
    off = opened.step[set_up]
    square = opened.covariance[np.ix_(set_up, set_up)] + np.outer(off, off)
    place = [MATERIAL.index(model.names[k]) for k in pick]
    j = jacobian.transpose(1, 0, 2).reshape(len(own), -1)
    lhs = prior[np.ix_(place, place)] + scale * (j[pick] @ j[pick].T)
    moves = np.zeros((len(MATERIAL), len(set_up)))
    moves[place] = scale * np.linalg.solve(lhs, j[pick] @ j[set_up].T)
    covariance = moves @ square @ moves.T
    if not settings.rod.diameter_std:
        young_modulus = MATERIAL.index("young_modulus")
        covariance[young_modulus, young_modulus] += (2.0 * DIAMETER_STD) ** 2
    values, vectors = np.linalg.eigh(probability * covariance)
    return tuple(vectors.T * np.sqrt(np.maximum(values, 0.0))[:, None])
