# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The noise of recordings, estimated from the scatter of residuals in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import comb

from dlo_ros.identification.residual_noise import (
    DIFFERENCE_ORDERS,
    divided_differences,
    point_noise,
)
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.variances import LEAST_NOISE
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

MEDIAN = 0.4549
"""Median of the square of a normal variable, over its mean."""
LEAST_SHARE = 0.5
"""Smallest share of the typical noise that a single coefficient may have."""


def with_noise(recording: Recording, predicted: FloatArray, settings: Settings) -> Recording:
    """The recording with its noise estimated from the scatter of residuals in time.

    No coefficient is much better than the others, and none along the DLO is better than those
    across it.

    Args:
        predicted: control points [m], shape (F, n, 3 or more), of the last F frames.
    """
    n = settings.rod.control_points
    each = _scatter(recording.residual(predicted), recording, settings)
    least = LEAST_NOISE * settings.rod.length
    typical = max(float(np.sqrt(np.mean(each[:n] ** 2))), least)
    across = np.maximum(each[:n], LEAST_SHARE * typical)
    others = [np.maximum(part, across) for part in np.split(each[n:], (len(each) - n) // n)]
    return replace(recording, noise=np.concatenate([across, *others]))


def _scatter(field: FloatArray, recording: Recording, settings: Settings) -> FloatArray:
    """Standard deviation of each coefficient from frame to frame [m], shape (K,).

    Differences in time of growing order; the smallest counts, and the median over time, so that a
    moment of violent motion does not. It is no less than what the measured points state: a camera
    may repeat its errors in every picture. Where there are too few frames that tells alone, or else
    the differences along u.

    Args:
        field: residual coefficients [m], shape (F, K).
    """
    n = settings.rod.control_points
    whole = point_noise(recording.manipulation.observations, SplineBasis(n, settings.rod.length))
    # `point_noise` is that of the whole shape, of which n coefficients have a share each.
    stated = (whole or 0.0) / np.sqrt(n)
    times = recording.times[-len(field) :]
    gaps = [divided_differences(field, times, o) for o in DIFFERENCE_ORDERS if len(field) > 2 * o]
    found = [np.sqrt(np.median(gap**2, axis=0) / MEDIAN) for gap in gaps]
    if found or stated:
        each = np.min(found, axis=0) if found else np.zeros(field.shape[1])
        return np.asarray(np.maximum(each, stated))
    parts = [_along(part) for part in np.split(field, field.shape[1] // n, axis=1)]
    return np.repeat(parts, n)


def _along(field: FloatArray) -> float:
    """Noise of coefficients (F, n) from their scatter along u, where models are smooth [m]."""
    found = [float(np.sqrt(np.mean(field**2)))]
    for order in DIFFERENCE_ORDERS:
        if field.shape[1] > 2 * order:
            gap = np.diff(field, order, axis=1) / np.sqrt(float(comb(2 * order, order)))
            found.append(float(np.sqrt(np.median(gap**2) / MEDIAN)))
    return min(found)
