# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forecasts of one recording with many parameter sets at once.

Where the rod stays in the plane, eight parameter sets are simulated at the price of little more
than one (`dlo_ros.rod.protocol.RodBatch`). Elsewhere the forecasts are made one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.cooperative_tasks import SHORT, Pieces, exhausted
from dlo_ros.inference.forecast import (
    Forecast,
    Manipulation,
    as_started,
    compared,
    forecast,
    motion_of,
    observations_of,
    unit_of,
)
from dlo_ros.parameters import Settings
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.spline import FloatArray


def forecast_each(
    manipulation: Manipulation, settings: Sequence[Settings], spans: int | None = None
) -> list[Forecast | None]:
    """Forecasts with several settings of one DLO; None where the simulation fails.

    Raises:
        InputError: as `forecast`.
    """
    return exhausted(forecast_in_pieces(manipulation, settings, spans))


def forecast_in_pieces(
    manipulation: Manipulation,
    settings: Sequence[Settings],
    spans: int | None = None,
    frames: int | None = None,
) -> Pieces[list[Forecast | None]]:
    """Forecasts as of `forecast_each`, in short pieces for callers that must not wait.

    Args:
        frames: observations of a piece; None: all.
    """
    together = yield from _together(manipulation, settings, spans, frames)
    if together is not None:
        return together
    result: list[Forecast | None] = []
    for one in settings:
        yield SHORT
        try:
            result.append(forecast(manipulation, one, spans=spans))
        except SimulationError:
            result.append(None)
    return result


def _together(
    manipulation: Manipulation, sets: Sequence[Settings], spans: int | None, frames: int | None
) -> Pieces[list[Forecast | None] | None]:
    """Forecasts from one run of all sets; None where that cannot be done."""
    observations = observations_of(manipulation)
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
    size = frames or len(stamps)
    try:
        for k in range(0, len(later), size):
            yield SHORT
            pieces.append(batch.advance_through(later[k : k + size]))
    except InputError:
        return None
    shapes = np.concatenate(pieces, axis=1)
    error = first.resolution.error if first.resolution else np.nan
    result: list[Forecast | None] = [None] * len(sets)
    for k in range(len(sets)):
        yield SHORT
        if k not in batch.failures:
            result[k] = compared(
                observations,
                shapes[k],
                None,
                first.published,
                first.basis.even_spans,
                error,
                stable=batch.stable[k],
                unit=unit_of(manipulation),
            )
    return result
