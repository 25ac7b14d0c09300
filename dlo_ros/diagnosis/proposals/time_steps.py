# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Time steps that are short enough for what may be added to the plain model.

The initial fit chooses them for the plain model. A heavy plug on a free end moves more rapidly:
with steps that are right to 0.1 mm without it, shapes may be off by 7 mm, and their derivatives
have nothing to do with them, so that no fit finds the plug. A creep, or a friction within the DLO,
for which a plain model stands with more damping, leaves a motion faster, too; how much faster only
the fitted set-up tells. All others keep the longer ones.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from dlo_ros.diagnosis.proposals.linear_evidence import is_present
from dlo_ros.effects import effects, starts
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline.drafts import TIME_FACTOR
from dlo_ros.identification.residual_noise import apart, rms, whitened
from dlo_ros.inference.joint import Simulated, simulate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.plain_rod import instead_of_plain
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
    return _all_short_enough(recordings, at, _models(recordings, at.model.settings))


def with_steps_instead_of_plain(
    recordings: Sequence[Recording], at: Simulated
) -> tuple[Recording, ...]:
    """The recordings with time steps short enough for what the plain rod may stand for.

    Args:
        at: the fitted set-up.
    """
    begun = starts(scene_of(at.model.settings, recordings))
    absent = [s for s in begun if not is_present(at.model, s)]
    models = [(start.effect, model) for start, model in instead_of_plain(at.model, absent)]
    return _all_short_enough(recordings, at, models)


def _all_short_enough(
    recordings: Sequence[Recording], at: Simulated, models: Sequence[tuple[str, ParametricModel]]
) -> tuple[Recording, ...]:
    """Each recording by `_short_enough`, where less than what a model leaves is allowed."""
    return tuple(
        _short_enough(recording, models, max(IMMATERIAL, SMALL_SHARE * rms([left])))
        for recording, left in zip(recordings, whitened(at, recordings), strict=True)
    )


def _models(
    recordings: Sequence[Recording], settings: Settings
) -> list[tuple[str, ParametricModel]]:
    """The plain model with each smooth effect that begins far from neutral, after its name."""
    view = scene_of(settings, recordings)
    given = {name: dict(block) for name, block in settings.effects.items()}
    return [
        (s.effect, ParametricModel(settings.with_effects(given | {s.effect: dict(s.block)}), ()))
        for s in starts(view)
        if s.afar and effects()[s.effect].differentiable and s.effect not in given
    ]


def _short_enough(
    recording: Recording, models: Sequence[tuple[str, ParametricModel]], allowed: float
) -> Recording:
    """A recording with a tolerance for each effect at which the models' errors are allowed.

    Args:
        models: models with an effect, after its name.
        allowed: root mean square error in units of the noise.
    """
    rapid = dict(recording.rapid)
    for name, model in models:
        tolerance = _tolerance(recording, model, allowed)
        if tolerance is not None and tolerance < rapid.get(name, recording.tolerance or 0.0):
            LOG.info("%s: steps of %g with %s", recording.name, tolerance, name)
            rapid[name] = tolerance
    return replace(recording, rapid=rapid)


def _tolerance(recording: Recording, model: ParametricModel, allowed: float) -> float | None:
    """The largest tolerance at which a model's error is allowed, or the smallest that is tried."""
    here = replace(recording, rapid={})
    while here.tolerance is not None and here.tolerance > SHORTEST:
        shorter = max(here.tolerance / TIME_FACTOR**2, SHORTEST)
        finer = replace(here, tolerance=shorter)
        if _error(model, here, finer) < allowed:
            break
        here = finer
    return here.tolerance


def _error(model: ParametricModel, recording: Recording, finer: Recording) -> float:
    """Error of a simulation in units of the noise; 0 where there is no finer one to compare."""
    try:
        here, there = (simulate(model, [r], ()) for r in (recording, finer))
    except SimulationError:
        return 0.0
    return apart(here, there, [recording])
