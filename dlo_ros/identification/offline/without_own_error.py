# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A fit's recordings without the error of its own simulation.

While causes are looked for, time steps and knot spans need only be fine enough for what a model
leaves over. What they do wrong is the same in all pictures, and many pictures determine numbers to
far less than that: a stated standard deviation would be too small. A finer simulation at the fitted
values tells the error, which hardly changes with them, so that it is taken from what is compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, field, simulate, with_variances
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import IMMATERIAL
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

STEP_SHORTER = 2.0
"""Ratio of the time steps of two simulations that are compared."""
EXTRAPOLATED = 1.0 / (STEP_SHORTER**2 - 1.0)
"""Error of the finer one over their difference: it falls with the square of the step."""
ROUNDS = 3
"""Simulations at most, each with shorter time steps and twice the knot spans."""


def without_own_error(
    at: Evaluation, recordings: Sequence[Recording]
) -> tuple[Evaluation, Sequence[Recording]]:
    """The fit held against recordings without its simulation's error, and these recordings.

    What is left is immaterial in standard deviations of the combination of numbers that it moves
    most: E/mu is known far better than E.

    Args:
        at: fit to all of the recordings.

    Returns:
        An evaluation from which a fit goes on, and the recordings; the same as before where the
        error is immaterial, or nothing finer can be simulated.
    """
    information = np.asarray(np.linalg.inv(at.posterior.covariance))

    def stds(change: FloatArray) -> float:
        return float(np.sqrt(max(float(change @ information @ change), 0.0)))

    best, adjusted, finer, last = at, recordings, recordings, np.inf
    before = at.predicted
    for _ in range(ROUNDS):
        finer = [refined(r, at.model.settings) for r in finer]
        try:
            predicted = simulate(at.model, finer, ()).predicted
            exact = [b + EXTRAPOLATED * (b - a) for a, b in zip(before, predicted, strict=True)]
            here, there = _compared_with(at, recordings, exact)
        except SimulationError:
            break
        change = stds(here.posterior.step - best.posterior.step)
        if change > last:  # where something is hit, finer simulations may not converge
            break
        best, adjusted, last, before = here, there, change, predicted
        left = change / (STEP_SHORTER**3 - 1.0)  # of an extrapolated one, with the third power
        if left < IMMATERIAL:
            break
    if stds(best.posterior.step - at.posterior.step) < IMMATERIAL:
        return at, recordings
    return best, adjusted


def refined(recording: Recording, settings: Settings) -> Recording:
    """The recording simulated with shorter time steps, and twice the knot spans.

    Args:
        settings: settings of the model that is to be simulated.
    """
    tolerance = recording.tolerance_with(settings.effects) or settings.simulation.tolerance
    spans = recording.spans and 2 * recording.spans
    return replace(recording, tolerance=tolerance / STEP_SHORTER**3, spans=spans, rapid={})


def _compared_with(
    at: Evaluation, recordings: Sequence[Recording], exact: Sequence[np.ndarray]
) -> tuple[Evaluation, Sequence[Recording]]:
    """The evaluation and the recordings, with what is measured moved by the simulation's error.

    Args:
        exact: control points of a finer simulation of each recording, shape (F, n, 4).
    """
    adjusted = [
        recording.moved(coarse[..., :3] - fine[..., :3])
        for recording, coarse, fine in zip(recordings, at.predicted, exact, strict=True)
    ]
    fields = tuple(
        (field(recording, coarse, None, np.zeros(0))[0], jacobian)
        for recording, coarse, (_, jacobian) in zip(adjusted, at.predicted, at.fields, strict=True)
    )
    found = with_variances(replace(at, fields=fields), at.variances)
    return replace(found, derived=at.derived), adjusted
