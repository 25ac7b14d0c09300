# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Shapes of each recording for the report, before and after, and the distances between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis.findings.diagnosis_outcome import RecordingView
from dlo_ros.diagnosis.residuals.missing_force import missing_force
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Simulated, simulate
from dlo_ros.inference.measured import Recording, leaves_plane, spline_space
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
        last = slice(-len(old), None)
        missed_old, missed_new = _across(recording, values, np.stack([old, new]), given)
        force = missing_force(recording, old, before.model.settings, u)
        result.append(
            RecordingView(
                recording.name,
                "holdout" if holdout[k].any() else "train",
                recording.times[last],
                recording.observed[last],
                old,
                new,
                err_old,
                err_new,
                u,
                missed_old,
                missed_new,
                None if force is None else force.force,
                None if force is None else force.std,
            )
        )
    return tuple(result)


def _across(
    recording: Recording, values: FloatArray, predicted: FloatArray, settings: Settings
) -> FloatArray:
    """Observed minus predicted across the DLO at stations [m], shape (S, F, U).

    In the plane it is positive to the left of growing u, in space it has no sign.

    Args:
        values: values of the basis functions at the stations, shape (U, n).
        predicted: control points of S models [m], shape (S, F, n, 3 or more), of the last F frames.
    """
    n, observed = values.shape[1], recording.observed[-predicted.shape[1] :]
    spatial = leaves_plane(recording.manipulation, settings)
    rows = spline_space(observed, settings, spatial=spatial)
    stations = np.linalg.inv(whitening(n, settings.rod.length)) @ values.T
    apart = observed - predicted[..., :3]
    missed = np.einsum("fknc,sfnc->sfk", rows, apart)
    left = np.asarray(missed[..., :n] @ stations)
    return np.hypot(left, missed[..., 2 * n :] @ stations) if spatial else left
