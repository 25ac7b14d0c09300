# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The result of a live run: the estimate, and ERR before and after (no ROS here)."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlo_ros.command import Motion
from dlo_ros.errors import DloError, RecordingError
from dlo_ros.identification.residual_noise import noise_floor
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.nodes.received_data import EstimateSample, ReceivedData
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import read_recording
from dlo_ros.rod.boundary.shape_orientation import all_along
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

LAST_MOMENTS = 500_000_000
"""Time [ns] at the end of the recording over which the live ERR is averaged."""


@dataclass(frozen=True)
class LiveOutcome:
    """The result of a live run.

    Args:
        sample: the estimate at the end.
        err_initial: time mean of eq. (10) that the initial guess gives on what was observed [m];
            None where it cannot be simulated. Simulated afterwards, since live nodes soon know
            better.
        err: mean of the live ERR over the last half second [m]; None where the simulator did not
            have the estimate by then, so that it is the error of something else.
        noise_floor: the ERR that a perfect model would have [m]; None where not known.
        initial: prediction of the initial guess by stamp [ns], control points, each of shape (n,
            4).
    """

    sample: EstimateSample
    err_initial: float | None
    err: float | None
    noise_floor: float | None
    initial: Mapping[int, FloatArray]


def assess(bag: Path, settings: Settings, received: ReceivedData) -> LiveOutcome:
    """Compare the end of a run with its beginning.

    Args:
        bag: the bag that was played.
        settings: the initial guess.
        received: the messages that the nodes published.

    Raises:
        RecordingError: the bag cannot be read, or the identifier published no estimate.
    """
    sample, errors = received.estimate(), received.errors(settings.rod.length)
    if sample is None or not errors:
        raise RecordingError(f"{bag}: the identifier published no estimate")
    observations = tuple(Observation(s, received.observed[s]) for s in sorted(received.observed))
    before = _initial_guess(bag, settings, observations)
    after = [value for stamp, value in errors.items() if stamp >= max(errors) - LAST_MOMENTS]
    err = float(np.mean(after)) if in_time(received, settings.rod.length) else None
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    return LiveOutcome(
        sample,
        None if before is None else float(np.mean(before.err)),
        err,
        noise_floor(observations, basis),
        {}
        if before is None
        else {int(s): p for s, p in zip(before.stamps, before.predicted, strict=True)},
    )


def in_time(received: ReceivedData, length: float) -> bool:
    """Whether the last ERR is that of the estimate: the simulator had it by then.

    Args:
        received: the messages that the nodes published.
        length: length of the DLO [m].
    """
    errors = received.errors(length)
    return bool(errors) and received.in_time(max(errors) - LAST_MOMENTS)


def _initial_guess(
    bag: Path, settings: Settings, observations: tuple[Observation, ...]
) -> Forecast | None:
    commands = read_recording(bag, settings).commands
    # What was observed before the command had come may have its ends swapped.
    usable = all_along(Motion(list(commands)), observations, settings.rod.length)
    try:
        return forecast(Manipulation(bag.name, commands, usable), settings)
    except DloError as err:
        LOG.warning("the initial guess cannot be simulated: %s", err)
        return None
