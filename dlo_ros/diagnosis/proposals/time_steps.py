# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Time steps that are short enough for what may be added to the plain model.

The initial fit chooses them for the plain model. A heavy plug on a free end moves more rapidly:
with steps that are right to 0.1 mm without it, shapes may be off by 7 mm, and their derivatives
have nothing to do with them, so that no fit finds the plug.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from dlo_ros.effects import effects, starts
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline.initial_fit import TIME_FACTOR, apart, rms, whitened
from dlo_ros.inference.joint import Simulated, simulate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.scene import scene_of
from dlo_ros.inference.thresholds import IMMATERIAL, SMALL_SHARE
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

SHORTEST = 1e-4
"""Smallest tolerance of time steps that is tried."""


def with_short_steps(recordings: Sequence[Recording], at: Simulated) -> tuple[Recording, ...]:
    """The recordings with time steps short enough for what begins far from neutral.

    Args:
        at: the plain model's simulation of them, or of longer ones with the same beginnings.
    """
    models = _models(recordings, at.model.settings)
    return tuple(
        _short_enough(recording, models, max(IMMATERIAL, SMALL_SHARE * rms([left])))
        for recording, left in zip(recordings, whitened(at, recordings), strict=True)
    )


def _models(recordings: Sequence[Recording], settings: Settings) -> list[ParametricModel]:
    """The plain model with each smooth effect that begins far from neutral."""
    view = scene_of(settings, recordings)
    given = {name: dict(block) for name, block in settings.effects.items()}
    return [
        ParametricModel(settings.with_effects(given | {s.effect: dict(s.block)}), ())
        for s in starts(view)
        if s.afar and effects()[s.effect].differentiable and s.effect not in given
    ]


def _short_enough(
    recording: Recording, models: Sequence[ParametricModel], allowed: float
) -> Recording:
    """A recording with a tolerance at which the models' errors are allowed.

    Args:
        allowed: root mean square error in units of the noise.
    """
    here = recording
    while here.tolerance is not None and here.tolerance > SHORTEST:
        finer = replace(here, tolerance=here.tolerance / TIME_FACTOR)
        error = max((_error(m, here, finer) for m in models), default=0.0)
        if error < allowed:
            break
        LOG.info("%s: %.2g times the noise with steps of %g", here.name, error, here.tolerance)
        here = finer
    return here


def _error(model: ParametricModel, recording: Recording, finer: Recording) -> float:
    """Error of a simulation in units of the noise; 0 where there is no finer one to compare."""
    try:
        here, there = (simulate(model, [r], ()) for r in (recording, finer))
    except SimulationError:
        return 0.0
    return apart(here, there, [recording])
