# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The normal equations of all observations: those of the present window, and the older ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.information import NormalEquations, discrepancy, model_shift
from dlo_ros.identification.online.linearised_model import PriorInformation, Run
from dlo_ros.inference.joint import BOUNDLESS
from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.inference.variances import Posterior, Variances, fit_variances
from dlo_ros.spline import FloatArray

AUTOCORRELATION_EVERY = 10  # observations between looks at the correlation of the residuals
FORGETTING = 0.7  # weight of older windows: a DLO warms up and wears
ITERATIONS, ROUNDS = 5, 8
"""Iterations of the search for the variances in a piece of work, and pieces."""


class AccumulatedInformation:
    """Normal equations of the present run, and of the windows before it.

    Attributes:
        present: normal equations of the present run, when they were last measured; None before.
        earlier: normal equations of older windows, in units of information; None where there are
            none.
    """

    def __init__(self) -> None:
        self.present: NormalEquations | None = None
        self.earlier: NormalEquations | None = None
        self._measured: tuple[Run | None, int] = (None, 0)
        self._variances: Variances | None = None

    def measure(self, run: Run, prior: PriorInformation) -> Pieces[None]:
        """Measure the information of a run, where that is not known or was measured long ago.

        Args:
            run: the present one.
            prior: prior information, whose autocorrelation time of the residuals is renewed.
        """
        measured, used = self._measured
        recent = run.used < used + max(AUTOCORRELATION_EVERY, run.used // 10)
        if measured is run and recent and run.used >= AUTOCORRELATION_EVERY:
            return
        yield LONG
        used, bins, settings = run.used, run.spectrum(), run.simulation.settings
        usable = np.isfinite(prior.guess)
        offset = np.subtract(prior.guess, run.at.theta, out=np.zeros(4), where=usable)
        before = self._variances
        start = [before] if before and len(before.white) == bins.parts else None
        try:  # from there the search goes on at the next look
            (variances,), _ = _fitted(
                bins, offset, np.diag(prior.prior), settings.rod.length, start
            )
        except SimulationError:
            return
        # The errors of the simulation and of the theory stay the same in all pictures.
        own = discrepancy(run.error, settings)
        whole = replace(variances, lasting=variances.lasting + own**2)
        self._variances, found = variances, NormalEquations.of(bins, whole)
        correlated = found.information(model_shift(settings))
        white = run.at.normal[0, 0] * run.at.scale(prior.step(run.at))
        if correlated[0, 0] > 0.0:
            prior.autocorrelation_time = max(1.0, float(white / correlated[0, 0]))
        self.present, self._measured = found, (run, used)

    def weighed(
        self, run: Run, step: FloatArray, prior: PriorInformation
    ) -> NormalEquations | None:
        """Normal equations of all observations, in units of information.

        Args:
            run: the present one.
            step: step from the point of linearisation to the estimate, shape (4,).
            prior: prior information, which holds the autocorrelation time of the residuals.
        """
        if self.present is None:
            return self.earlier
        present = self.present.scaled(prior.scale(run.at, step))
        return present if self.earlier is None else self.earlier.followed_by(present)

    def fold(self, run: Run, step: FloatArray, prior: PriorInformation) -> None:
        """Count the present window among the older ones; see `weighed`."""
        if self.present is not None and self.earlier is not None:
            self.earlier = self.earlier.remembered(FORGETTING)
        self.earlier, self.present = self.weighed(run, step, prior), None


def fitted_variances(
    bins: Spectrum, offset: FloatArray, precision: FloatArray, length: float
) -> Pieces[tuple[tuple[Variances, ...], Posterior]]:
    """Variances that maximise the marginal likelihood, some iterations at a time.

    Args:
        offset, precision, length: see `fit_variances`.

    Raises:
        SimulationError: derivatives are too large for a likelihood.
    """
    variances = None
    for _ in range(ROUNDS):
        yield LONG
        variances, found = _fitted(bins, offset, precision, length, variances)
    assert variances is not None
    return variances, found


def _fitted(
    bins: Spectrum, offset: FloatArray, precision: FloatArray, length: float,
    start: Sequence[Variances] | None,
) -> tuple[tuple[Variances, ...], Posterior]:  # fmt: skip
    """Some iterations of `fitted_variances`."""
    try:
        variances, found = fit_variances([bins], offset, precision, length, start, ITERATIONS)
    except np.linalg.LinAlgError as err:
        raise SimulationError(BOUNDLESS) from err
    if not np.isfinite(found.evidence):
        raise SimulationError(BOUNDLESS)
    return variances, found
