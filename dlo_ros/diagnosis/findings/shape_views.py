# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What the report shows of each recording: shapes before and after, and where they are wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis.findings.diagnosis_outcome import View
from dlo_ros.diagnosis.fitting.evaluation import Evaluation, evaluate
from dlo_ros.diagnosis.residuals.missing_force import missing_force
from dlo_ros.errors import SimulationError
from dlo_ros.inference.forecast import whitening
from dlo_ros.inference.measured import Recording, spline_space
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

STATIONS = 60


def views(
    recordings: Sequence[Recording], before: Evaluation, after: Evaluation,
    holdout: Sequence[np.ndarray], given: Settings,
) -> tuple[View, ...]:  # fmt: skip
    """One view for each recording.

    Args:
        before, after: the plain and the extended model, on the recordings learned from.
        holdout: see `aside.Split`.
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
                found = evaluate(at.model, [recording], given, derivatives=False)
            except SimulationError:
                break
            shown.append((found.predicted[0], found.err[0]))
        if len(shown) < 2:
            continue
        (old, err_old), (new, err_new) = shown
        frames = len(old)
        force = missing_force(recording, old, before.model.settings, u)
        result.append(
            View(
                recording.name,
                "holdout" if holdout[k].any() else "train",
                recording.times[-frames:],
                recording.observed[-frames:],
                old,
                new,
                err_old,
                err_new,
                u,
                _across(recording, old, values, given),
                _across(recording, new, values, given),
                None if force is None else force.force,
                None if force is None else force.std,
            )
        )
    return tuple(result)


def _across(
    recording: Recording, predicted: FloatArray, values: FloatArray, settings: Settings
) -> FloatArray:
    """Distance across the DLO [m], shape (F, U)."""
    n = predicted.shape[1]
    observed = recording.observed[-len(predicted) :]
    rows = spline_space(observed, settings)[:, :n]
    coefficients = np.einsum("fknc,fnc->fk", rows, observed - predicted[..., :3])
    back = np.linalg.inv(whitening(n, settings.rod.length))
    return np.asarray(coefficients @ back @ values.T)
