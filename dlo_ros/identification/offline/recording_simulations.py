# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulations of all recordings, as fine as their residuals ask for."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from dlo_ros.errors import SimulationError
from dlo_ros.identification.batched_forecast import forecast_varied
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.inference.parallel import Pool, Threads
from dlo_ros.inference.time_steps import sufficient_time_steps
from dlo_ros.parameters import Settings
from dlo_ros.rod.resolution import RECHECK_RATIO
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)


@dataclass
class Simulations:
    """Pool and knot spans with which recordings are simulated.

    Args:
        pool: pool in which simulations run.
        spans: knot spans of each recording, with E/mu and tolerance for which they were judged.
    """

    pool: Pool = field(default_factory=Threads)
    spans: dict[int, tuple[float, float, Forecast]] = field(default_factory=dict)

    def known(self, index: int, settings: Settings) -> Forecast | None:
        """A forecast whose resolution is fine enough for these settings, too."""
        if index not in self.spans:
            return None
        ratio, tolerance, found = self.spans[index]
        apart = settings.rod.specific_modulus / ratio
        same = tolerance == settings.simulation.tolerance
        return found if same and 1 / RECHECK_RATIO < apart < RECHECK_RATIO else None

    def vary(self, train: Sequence[Manipulation], settings: Settings) -> list[Forecast]:
        """Forecasts of all recordings with derivatives.

        Raises:
            SimulationError: a recording cannot be simulated.
        """
        known = [self.known(k, settings) for k in range(len(train))]
        tasks = [
            (r, settings, None if f is None else f.spans) for r, f in zip(train, known, strict=True)
        ]
        found = self.pool.map(_varied, tasks)
        for k, (before, now) in enumerate(zip(known, found, strict=True)):
            if before is None:
                ratio, tolerance = settings.rod.specific_modulus, settings.simulation.tolerance
                self.spans[k] = (ratio, tolerance, now)
            else:
                found[k] = replace(now, resolution_error=before.resolution_error)
        return found

    def long_steps(
        self, train: Sequence[Manipulation], settings: Settings, forecasts: Sequence[Forecast]
    ) -> float | None:
        """Tolerance of time steps as long as the residuals allow; None: as the settings ask for.

        Args:
            train: recordings.
            settings: settings with the material of the forecasts.
            forecasts: a forecast of each recording, with the knot spans that it needs.
        """

        def residuals(tolerance: float) -> Sequence[FloatArray]:
            steps = stepping(settings, tolerance)
            tasks = [(r, steps, f.spans) for r, f in zip(train, forecasts, strict=True)]
            return self.pool.map(_residual, tasks)

        try:
            found = sufficient_time_steps(residuals, [f.residual for f in forecasts])
        except SimulationError as err:
            LOG.info("time steps stay as they are: %s", err)
            return None
        if found <= settings.simulation.tolerance:
            return None
        LOG.info("time steps of tolerance %.1g", found)
        return found


def stepping(settings: Settings, tolerance: float) -> Settings:
    """The settings with another tolerance."""
    return replace(settings, simulation=replace(settings.simulation, tolerance=tolerance))


def _varied(task: tuple[Manipulation, Settings, int | None]) -> Forecast:
    recording, settings, spans = task
    return forecast_varied(recording, settings, spans=spans)


def _residual(task: tuple[Manipulation, Settings, int]) -> FloatArray:
    recording, settings, spans = task
    return forecast(recording, settings, spans=spans).residual
