# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The cost of other values of a few numbers, with everything else fitted anew.

Where simulations are rough, no derivative tells how well such numbers are known.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dlo_ros.diagnosis.explain.trials import FIT_ITERATIONS
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, borrowed
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import misfit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import evidence_std
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import WORTH

LOG = logging.getLogger(__name__)


class Refit(NamedTuple):
    """Another model beside the best one.

    Args:
        loss: loss of log posterior with it.
        scatter: standard deviation of that loss by chance, see `evidence_std`.
    """

    loss: float
    scatter: float

    def stds_away(self, least: float = 0.0) -> float:
        """Standard deviations of a number between its values in the best model and in this one; at
        least 1.

        Half of their square is lost where one of the models is true. Where no law is, each bin of
        the spectrum likes another value, and the loss is a sum of random numbers: then they are
        twice the loss over its scatter, by the sandwich formula for the std of the number.

        Args:
            least: loss of the best of several such models, from which that of this one counts.
        """
        loss = self.loss - least
        known = math.sqrt(max(2.0 * loss, 1.0))
        return max(1.0, min(known, 2.0 * loss / max(self.scatter, 1e-300)))

    def does_as_well(self, least: float = 0.0) -> bool:
        """Whether that lies within what `WORTH` of log posterior tells apart; see `stds_away`."""
        return 0.5 * self.stds_away(least) ** 2 < WORTH


def refitted_loss(at: Evaluation, model: ParametricModel, recordings: Sequence[Recording]) -> Refit:
    """The loss with another model, fitted anew; infinite where that is impossible."""
    found = fitted_beside(at, model, recordings)
    if found is None:
        return Refit(np.inf, 0.0)
    return Refit(misfit(found, at) - misfit(at, at), evidence_std(at, found))


def fitted_beside(
    at: Evaluation, model: ParametricModel, recordings: Sequence[Recording]
) -> Evaluation | None:
    """A model fitted with the derivatives of one beside it, as long as they predict what is gained.

    Args:
        at: the evaluation of a model with the same parameters.

    Returns:
        None where it cannot be simulated.
    """
    try:
        return fit(borrowed(at, model, recordings), recordings, FIT_ITERATIONS, draft=True)
    except SimulationError as err:
        LOG.info("not fitted: %s", err)
        return None
