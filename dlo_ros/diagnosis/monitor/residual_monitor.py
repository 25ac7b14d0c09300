# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Monitor of the residuals that E, mu and damping leave in a live identification.

The autocovariance of these residuals from picture to picture is compared with the noise that is new
in every picture. Where it is as large, the joint model of `diagnose` is evaluated on the same
pictures (`suspects`): what a set-up within its tolerances explains is no reason to warn. The cause
itself and its size are left to `diagnose`.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from dlo_ros.command import NANOSECONDS
from dlo_ros.diagnosis.monitor.suspects import Suspects, suspects
from dlo_ros.errors import DloError
from dlo_ros.identification.cooperative_tasks import Pieces
from dlo_ros.identification.identifiability import rounded
from dlo_ros.identification.information import discrepancy
from dlo_ros.identification.residual_noise import divided_differences
from dlo_ros.inference.forecast import Forecast, Manipulation
from dlo_ros.inference.thresholds import OWN
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

WINDOW = 90  # pictures that are looked at together
FIRST = 30
EVERY = 15  # pictures between two looks
LOOKS = 2  # one after the other that must find something, before the window is full
RIDGE = 1e-9  # of a column's own size, so that columns that say the same do no harm


@dataclass(frozen=True)
class CorrelatedResidual:
    """The residuals of the fit of E, mu and damping: their correlated part and their noise.

    Args:
        common: root mean square distance along the DLO that neighbouring pictures share [m].
        noise: root mean square distance that is new in every picture [m].
        own: error that the simulation and the theory may have themselves [m].
    """

    common: float
    noise: float
    own: float

    @property
    def correlated(self) -> bool:
        """Whether they are so much more than noise that `diagnose` would look for causes."""
        noise = math.hypot(self.noise, self.own)
        return math.hypot(self.common, noise) > OWN * noise


@dataclass(frozen=True)
class Suspicion:
    """A correlated residual, and the causes that are suspected.

    Args:
        leftover: the residuals that E, mu and damping leave.
        suspects: result of the joint model's linear test; None where it could not be computed.
    """

    leftover: CorrelatedResidual
    suspects: Suspects | None

    def __str__(self) -> str:
        ask = "record them and run `dlo_ros diagnose`"
        if self.suspects is None:
            apart = rounded(1e3 * self.leftover.common)
            times = rounded(self.leftover.common / self.leftover.noise)
            return (
                f"the shapes differ from the model by {apart} mm that E and mu cannot remove "
                f"({times} times the noise); {ask}"
            )
        err, setup_err = (rounded(1e3 * x) for x in (self.suspects.err, self.suspects.setup_err))
        seen = (
            f"the shapes differ from the model by {err} mm that E and mu cannot remove "
            f"({setup_err} mm with a set-up that is off within its tolerances)"
        )
        names = f"suspects: {self.suspects}; " if self.suspects.found else ""
        return f"{seen}; {names}{ask}"


class ResidualMonitor:
    """Watches the residuals of a live identification; read `suspicion` whenever."""

    def __init__(self) -> None:
        self.suspicion: Suspicion | None = None
        self._looked, self._found, self._tried = 0, 0, 0
        self._test: Pieces[None] | None = None

    @property
    def busy(self) -> bool:
        """Whether `proceed` has something to do."""
        return self._test is not None

    def due(self, count: int) -> bool:
        """Whether it is time for a look, now that there are so many pictures."""
        return count >= FIRST and not self._looked <= count < self._looked + EVERY

    def look(self, found: Forecast, settings: Settings, past: Manipulation | None) -> None:
        """Look at the residuals of a model that has converged; quick.

        Args:
            found: the pictures since the start with derivatives by `MATERIAL`.
            settings: the parameters that it was made with.
            past: the same pictures with what was imposed; None where their beginning is gone.
        """
        count = len(found.stamps)
        if not self.due(count):
            return
        self._looked = count
        leftover = correlated_residual(found, settings)
        self._found = self._found + 1 if leftover.correlated else 0
        if not self._found:
            self.suspicion = None
        if self._found < (LOOKS if count < WINDOW else 1) or self.busy:
            return
        if past is None:
            self.suspicion = self.suspicion or Suspicion(leftover, None)
        # More pictures may tell more, but not each of them.
        elif not self._tried <= count < 2 * self._tried:
            self._tried = count
            self._test = self._ranked(past, settings, found.spans, leftover)

    def proceed(self) -> None:
        """Do a piece of the linear test."""
        if self._test is not None:
            try:
                next(self._test)
            except StopIteration:
                self._test = None

    def _ranked(
        self, past: Manipulation, settings: Settings, spans: int, leftover: CorrelatedResidual
    ) -> Pieces[None]:
        try:
            found = yield from suspects(
                past, settings, spans, math.hypot(leftover.noise, leftover.own)
            )
        except DloError as err:
            LOG.warning("the suspects cannot be ranked: %s", err)
            self.suspicion = Suspicion(leftover, None)
            return
        self.suspicion = Suspicion(leftover, found) if found.wrong else None


def correlated_residual(found: Forecast, settings: Settings) -> CorrelatedResidual:
    """The residuals of the last pictures of a forecast with derivatives, without a last fit.

    The noise follows from differences in time of second and fourth order, the correlated part from
    the products of neighbours.
    """
    assert found.derivative is not None
    field = found.residual[-WINDOW:].reshape(min(len(found.residual), WINDOW), -1)
    columns = found.derivative[-WINDOW:].transpose(0, 2, 3, 1).reshape(field.size, -1)
    field = _without(field.ravel(), columns).reshape(field.shape)
    times = (found.stamps[-WINDOW:] - found.stamps[0]) / NANOSECONDS
    gaps = [divided_differences(field, times, order) for order in (2, 4)]
    noise = [float(np.median(np.sum(gap**2, axis=1))) for gap in gaps]
    common = float(np.mean(np.sum(field[1:] * field[:-1], axis=1)))
    own = discrepancy(found.resolution_error, settings)
    return CorrelatedResidual(math.sqrt(max(common, 0.0)), math.sqrt(min(noise)), own)


def _without(field: FloatArray, columns: FloatArray) -> FloatArray:
    """A field (N,) without what columns (N, P) can explain of it."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0.0, size, 1.0)
    lhs = scaled.T @ scaled + RIDGE * np.eye(columns.shape[1])
    return np.asarray(field - scaled @ np.linalg.solve(lhs, scaled.T @ field))
