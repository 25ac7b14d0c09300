# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Shapes of each recording for the report, before and after, and the distances between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dlo_ros.diagnosis.findings.diagnosis_outcome import RecordingView
from dlo_ros.diagnosis.residuals.missing_force import missing_force
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Simulated, simulate
from dlo_ros.inference.measured import Recording, spline_space
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

STATIONS = 60


def views(
    recordings: Sequence[Recording], before: Simulated, after: Simulated,
    holdout: Sequence[np.ndarray], given: Settings,
) -> tuple[RecordingView, ...]:  # fmt: skip
    """One view for each recording.

    Args:
        before, after: the plain and the extended model, on the recordings learned from.
        holdout: masks of the frames that are held out, shape (F,) for each recording.
    """
    result = []
    length = given.rod.length
    u = np.linspace(0.0, length, STATIONS)
    values = SplineBasis(given.rod.control_points, length).matrix(u)
    for k, recording in enumerate(recordings):
        shown = []
        for at in (before, after):
            if k < len(at.predicted):
                shown.append((at.predicted[k], at.err[k]))
                continue
            try:
                found = simulate(at.model, [recording], ())
            except SimulationError:
                break
            shown.append((found.predicted[0], found.err[0]))
        if len(shown) < 2:
            continue
        (old, err_old), (new, err_new) = shown
        frames = len(old)
        across = _across(recording, values, given)
        force = missing_force(recording, old, before.model.settings, u)
        result.append(
            RecordingView(
                recording.name,
                "holdout" if holdout[k].any() else "train",
                recording.times[-frames:],
                recording.observed[-frames:],
                old,
                new,
                err_old,
                err_new,
                u,
                across(old),
                across(new),
                None if force is None else force.force,
                None if force is None else force.std,
            )
        )
    return tuple(result)


def _across(
    recording: Recording, values: FloatArray, settings: Settings
) -> Callable[[FloatArray], FloatArray]:
    """Function that gives the distance across the DLO at stations for predicted control points.

    Args:
        values: values of the basis functions at the stations, shape (U, n).

    Returns:
        A function of control points [m], shape (F, n, 3 or more), of the last F frames; it returns
        observed minus predicted [m], shape (F, U).
    """
    n = values.shape[1]
    rows = spline_space(recording.observed, settings)[:, :n]
    stations = np.linalg.inv(whitening(n, settings.rod.length)) @ values.T

    def distance(predicted: FloatArray) -> FloatArray:
        last = slice(-len(predicted), None)
        apart = recording.observed[last] - predicted[..., :3]
        return np.asarray(np.einsum("fknc,fnc->fk", rows[last], apart) @ stations)

    return distance
