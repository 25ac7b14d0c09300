# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Schedule of the errors by the set-up's tolerances, which are computed again as the DLO moves."""

from __future__ import annotations

import logging
import math

from dlo_ros.errors import SimulationError
from dlo_ros.identification.cooperative_tasks import Pieces
from dlo_ros.identification.estimate import Estimate
from dlo_ros.identification.online.linearised_model import PriorInformation, Run
from dlo_ros.identification.online.observed_window import ObservedWindow
from dlo_ros.identification.online.set_up_shifts import Weighting, set_up_shifts
from dlo_ros.inference.thresholds import SMALL_SHARE
from dlo_ros.parameters import Settings
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
        shifts: errors of ln (E, mu, c, t_r), see `set_up_shifts`.
    """

    def __init__(self, given: Settings) -> None:
        self.shifts: tuple[FloatArray, ...] = ()
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
        step = prior.step(run.at)
        weighting = Weighting(prior.scale(run.at, step), prior.prior)
        settings, spans = estimate.settings, run.simulation.basis.spans
        try:
            self.shifts = yield from set_up_shifts(seen, settings, self._given, spans, weighting)
        except SimulationError as err:
            LOG.info("the set-up's tolerances are not looked at: %s", err)
