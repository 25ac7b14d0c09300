# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The normal equations of all observations: those of the present window, and the older ones."""

from __future__ import annotations

from dlo_ros.identification.cooperative_tasks import LONG, Pieces
from dlo_ros.identification.information import model_shifts
from dlo_ros.identification.online.linearised_model import PriorInformation, Run
from dlo_ros.identification.residual_information import NormalEquations
from dlo_ros.spline import FloatArray

AUTOCORRELATION_EVERY = 10  # observations between looks at the correlation of the residuals
FORGETTING = 0.7  # weight of older windows: a DLO warms up and wears


class AccumulatedInformation:
    """Normal equations of the present run, and of the windows before it.

    Attributes:
        present: information of the present run, when it was last measured; None before.
        earlier: normal equations of older windows, in units of information; None where there are
            none.
    """

    def __init__(self) -> None:
        self.present: NormalEquations | None = None
        self.earlier: NormalEquations | None = None
        self._measured: tuple[Run | None, int] = (None, 0)

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
        found = run.equations()
        correlated = found.information(model_shifts(run.simulation.settings, 4))
        white = run.at.normal[0, 0] * run.at.scale(prior.step(run.at))
        if correlated[0, 0] > 0.0:
            prior.autocorrelation_time = max(1.0, float(white / correlated[0, 0]))
        self.present, self._measured = found, (run, run.used)

    def weighed(
        self, run: Run, step: FloatArray, prior: PriorInformation
    ) -> NormalEquations | None:
        """Normal equations of all observations, in units of information.

        Errors that stay in all pictures are the same in all windows, too.

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
        if self.present is not None:
            present, earlier = self.present.scaled(prior.scale(run.at, step)), self.earlier
            self.earlier = (
                present if earlier is None else earlier.remembered(FORGETTING).followed_by(present)
            )
        self.present = None
