# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Loads of the DLO and its grips in recordings by a model, for the reports."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from dlo_ros.errors import DloError
from dlo_ros.inference.forecast import (
    Manipulation,
    borne_from,
    forecast,
    warn_of_instability,
)
from dlo_ros.inference.smoothly_led import smoothly_led
from dlo_ros.parameters import Settings
from dlo_ros.report.loads import LoadRow
from dlo_ros.rod.loads.extreme_loads import Extremes


def borne(recordings: Sequence[Manipulation], settings: Settings) -> tuple[LoadRow, ...]:
    """A row for each recording that can be simulated with these settings, which are a result's.

    What is held is led along a smooth path: at each corner of straight pieces it would be
    accelerated in an instant.
    """
    rows, length = [], settings.rod.length
    for recording in recordings:
        with suppress(DloError):
            found = forecast(smoothly_led(recording, length), settings, loads=True)
            warn_of_instability(found, recording.name)
            first = borne_from(recording, settings)
            if not found.loadings[first:]:  # the rod model does not say what is borne
                continue
            times = 1e-9 * (found.stamps - found.stamps[0]).astype(np.float64)
            extremes = Extremes(found.loadings[first:], times[first:].tolist())
            pulled, bent = extremes.loadings[extremes.pulled], extremes.loadings[extremes.bent]
            rows.append(
                LoadRow(
                    recording.name, pulled.tension, bent.bend_radius,
                    extremes.largest_force("start"), extremes.largest_force("end"),
                )
            )  # fmt: skip
    return tuple(rows)
