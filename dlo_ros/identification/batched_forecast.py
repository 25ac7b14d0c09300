# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many forecasts of one recording at once, and derivatives from them.

Where the rod stays in the plane, eight parameter sets are simulated at the price of little more
than one (`dlo_ros.rod.protocol.RodBatch`). Their differences are the derivatives: all eight
share their time steps, so that the error of these cancels. Elsewhere the forecasts are made one by
one.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.cooperative_tasks import exhausted
from dlo_ros.identification.estimate import logarithms, with_logarithms
from dlo_ros.inference.forecast import (
    Forecast,
    Manipulation,
    as_started,
    compared,
    forecast,
    motion_of,
    seen_until,
    unit_of,
)
from dlo_ros.parameters import Settings
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.rod.protocol import RodBatch, RodSimulation
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

DIFFERENCE = (0.02, 0.02, 0.1, 0.1)  # of the logarithms of MATERIAL, to either side
DENSITY = MATERIAL.index("density")


def forecast_varied(
    manipulation: Manipulation, settings: Settings, *, spans: int | None = None
) -> Forecast:
    """Forecast of one recording as `forecast` gives it, with derivatives by `MATERIAL`.

    Raises:
        InputError, SimulationError: as `forecast`.
    """
    together = exhausted(varied_in_pieces(manipulation, settings, spans))
    if together is not None:
        return together.forecast
    return forecast(manipulation, settings, parameters=MATERIAL, spans=spans)


def varied_in_pieces(
    manipulation: Manipulation,
    settings: Settings,
    spans: int | None = None,
    frames: int | None = None,
) -> Generator[None, None, Varied | None]:
    """Forecast as of `forecast_varied`, in short pieces; None where the sets cannot be simulated at
    once.

    Args:
        frames: observations of a piece; None: all.
    """
    theta = logarithms(settings)
    usable = np.isfinite(theta)
    if not usable[:2].all():
        return None
    # Without forces of their own (weights, draughts) every force is proportional to E, mu or c, so
    # that scaling all three changes nothing: what mu does follows from the others.
    follows = not settings.effects
    vary = [k for k in range(len(MATERIAL)) if usable[k] and not (follows and k == DENSITY)]
    sets = [settings]
    for k in vary:
        for side in (1.0, -1.0):
            moved = theta.copy()
            moved[k] += side * DIFFERENCE[k]
            sets.append(with_logarithms(settings, moved))
    together = yield from _together(manipulation, sets, spans, None, frames)
    if together is None or any(f is None for f in together.forecasts):
        return None
    forecasts = [f for f in together.forecasts if f is not None]

    def quotient(values: FloatArray) -> FloatArray:
        """Derivatives by `MATERIAL`, shape (4, ...), of what the sets differ in, (S, ...)."""
        result = np.zeros((len(MATERIAL), *values.shape[1:]))
        for k, above, below in zip(vary, values[1::2], values[2::2], strict=True):
            result[k] = (above - below) / (2.0 * DIFFERENCE[k])
        if follows:
            result[DENSITY] = -result[0] - result[2]
        return result

    derivative = -quotient(np.array([f.residual for f in forecasts]))
    derivative = np.ascontiguousarray(derivative.swapaxes(0, 1))  # (F, 4, n, 3)
    sensitivity = quotient(np.array([f.predicted[..., :3] for f in forecasts])).swapaxes(0, 1)
    here = replace(forecasts[0], derivative=derivative, sensitivity=sensitivity)
    return Varied(here, together.batch.differentiated(MATERIAL, quotient))


@dataclass(frozen=True)
class Varied:
    """A forecast with derivatives by `MATERIAL`, and the simulation at its end, which has them."""

    forecast: Forecast
    simulation: RodSimulation


def forecast_each(
    manipulation: Manipulation,
    settings: Sequence[Settings],
    *,
    spans: int | None = None,
    last_stamp: int | None = None,
) -> list[Forecast | None]:
    """Forecasts with several settings of one DLO; None where the simulation fails.

    Raises:
        InputError: as `forecast`.
    """
    return exhausted(forecast_in_pieces(manipulation, settings, spans, last_stamp))


def forecast_in_pieces(
    manipulation: Manipulation,
    settings: Sequence[Settings],
    spans: int | None = None,
    last_stamp: int | None = None,
    frames: int | None = None,
) -> Generator[None, None, list[Forecast | None]]:
    """Forecasts as of `forecast_each`, in short pieces for callers that must not wait.

    Args:
        frames: observations of a piece; None: all.
    """
    together = yield from _together(manipulation, settings, spans, last_stamp, frames)
    if together is not None:
        return together.forecasts
    result: list[Forecast | None] = []
    for one in settings:
        yield
        try:
            result.append(forecast(manipulation, one, spans=spans, last_stamp=last_stamp))
        except SimulationError:
            result.append(None)
    return result


def _together(
    manipulation: Manipulation,
    sets: Sequence[Settings],
    spans: int | None,
    last_stamp: int | None,
    frames: int | None = None,
) -> Generator[None, None, _Together | None]:
    """Forecasts from one run of all sets; None where that cannot be done."""
    observations = seen_until(manipulation, last_stamp)
    sets = [as_started(one, manipulation) for one in sets]
    motion = motion_of(manipulation)
    first = simulation_of(sets[0], motion, spans=spans)
    try:
        yield from first.starting(observations[:2], observations[-1].stamp)
    except SimulationError:
        return None
    batch = yield from first.batching(sets, observations[-1].stamp)
    if batch is None:
        return None
    if sets[0].simulation.start == "moving":
        observations = observations[1:]
    stamps = [o.stamp for o in observations]
    later = [s for s in stamps if s > first.stamp]
    pieces: list[FloatArray] = [] if len(later) == len(stamps) else [batch.shapes[:, None]]
    if later:
        yield
        try:
            for leg in _legs(later, frames):
                pieces.append(batch.advance_through(leg))
                yield
        except InputError:
            return None
    shapes = np.concatenate(pieces, axis=1)
    error = first.resolution.error if first.resolution else np.nan
    result: list[Forecast | None] = []
    for k in range(len(sets)):
        yield
        if k in batch.failures:
            result.append(None)
            continue
        result.append(
            compared(
                observations,
                shapes[k],
                None,
                first.published,
                first.basis.spans,
                error,
                stable=batch.stable[k],
                unit=unit_of(manipulation),
            )
        )
    return _Together(result, batch)


@dataclass(frozen=True)
class _Together:
    """Forecasts of all sets, None where one has failed, and the sets themselves at the end."""

    forecasts: list[Forecast | None]
    batch: RodBatch


def _legs(stamps: list[int], frames: int | None) -> list[list[int]]:
    """Stamps in pieces."""
    size = frames or len(stamps)
    return [stamps[k : k + size] for k in range(0, len(stamps), size)]
