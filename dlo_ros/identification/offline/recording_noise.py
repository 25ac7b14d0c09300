# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The noise of recordings, estimated from the scatter of residuals in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import comb

from dlo_ros.identification.residual_noise import (
    DIFFERENCE_ORDERS,
    divided_differences,
    point_noise,
)
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import SCATTERING
from dlo_ros.inference.variances import LEAST_NOISE
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

MEDIAN = 0.4549
"""Median of the square of a normal variable, over its mean."""
ALIKE_PARTS = 4
"""Number of parts of the DLO in each of which lasting errors of a camera are alike."""
TIP = 0.05
"""Standard deviation of the place along the DLO that a camera sees, over the diameter."""
LEAST_SHARE = 0.5
"""Smallest share of the typical noise that a single coefficient may have."""


def with_noise(recording: Recording, predicted: FloatArray, settings: Settings) -> Recording:
    """The recording with its noise estimated from the scatter of residuals in time."""
    noise = noise_of(recording.residual(predicted), recording, settings)
    return replace(recording, noise=noise)


def scatter(field: FloatArray, recording: Recording, settings: Settings) -> FloatArray:
    """Standard deviation of each coefficient from frame to frame [m], shape (K,).

    Differences in time of growing order; the smallest counts, and the median over time, so that a
    moment of violent motion does not. Where there are too few frames the stated standard deviation
    of the measured points tells, or else the differences along u.

    Args:
        field: residual coefficients [m], shape (F, K).
    """
    found = [np.sqrt(np.median(gap**2, axis=0) / MEDIAN) for gap in _gaps(field, recording)]
    if found:
        return np.asarray(np.min(found, axis=0))
    n = settings.rod.control_points
    stated = point_noise(recording.manipulation.observations, SplineBasis(n, settings.rod.length))
    if stated:
        # `point_noise` is that of the whole shape, of which n coefficients have a share each.
        return np.full(field.shape[1], stated / np.sqrt(n))
    parts = [_along(part) for part in np.split(field, field.shape[1] // n, axis=1)]
    return np.repeat(parts, n)


def _gaps(field: FloatArray, recording: Recording) -> list[FloatArray]:
    """Differences in time of growing order, scaled such that white noise keeps its size."""
    times, orders = recording.times[-len(field) :], DIFFERENCE_ORDERS
    return [divided_differences(field, times, o) for o in orders if len(field) > 2 * o]


def _along(field: FloatArray) -> float:
    """Noise of coefficients (F, n) from their scatter along u, where models are smooth [m]."""
    found = [float(np.sqrt(np.mean(field**2)))]
    for order in DIFFERENCE_ORDERS:
        if field.shape[1] > 2 * order:
            gap = np.diff(field, order, axis=1) / np.sqrt(float(comb(2 * order, order)))
            found.append(float(np.sqrt(np.median(gap**2) / MEDIAN)))
    return min(found)


def with_bias(
    recordings: Sequence[Recording], predicted: Sequence[FloatArray], settings: Settings
) -> tuple[Recording, ...]:
    """Recordings with the errors that a camera repeats in every picture.

    Where measured points scatter less from picture to picture than their stated std, the rest of
    that std is an error that stays: edges of a strand lie on pixels, and light falls from one side.
    Such errors are correlated along the DLO.

    Args:
        predicted: control points of each recording [m], shape (F, n, 3 or more).
    """
    shares, stated, along = [], [], []
    for recording, shapes in zip(recordings, predicted, strict=True):
        points = [o.points for o in recording.manipulation.observations if o.points is not None]
        if not points:
            return tuple(recordings)
        std = float(np.median([np.sqrt(np.mean(p.std**2)) for p in points]))
        count = float(np.median([len(p.std) for p in points]))
        n = recording.observed.shape[1]
        field = recording.residual(shapes)[:, :n]
        # All coefficients together: of one alone a few dozen pictures tell too little.
        found = [float(np.median(gap**2)) / MEDIAN for gap in _gaps(field, recording)]
        each = min(found) if found else float(np.median(scatter(field, recording, settings) ** 2))
        shares.append(count * each / max(std, 1e-12) ** 2)
        stated.append(std)
        ends = [np.sqrt(np.mean(p.std_along**2)) for p in points if p.std_along is not None]
        tip = TIP * settings.rod.diameter
        along.append(max(tip, float(np.median(ends))) if ends else tip)
    if min(shares) > SCATTERING:
        return tuple(recordings)
    biased = []
    for recording, std, tip in zip(recordings, stated, along, strict=True):
        bias = np.full(len(recording.noise), std / np.sqrt(ALIKE_PARTS))
        n = recording.observed.shape[1]
        bias[n : 2 * n] = np.maximum(bias[n : 2 * n], tip)
        biased.append(replace(recording, bias=bias))
    return tuple(biased)


def noise_of(field: FloatArray, recording: Recording, settings: Settings) -> FloatArray:
    """Noise that is attributed to each coefficient [m], shape (K,).

    No coefficient is much better than the others, and none along the DLO is better than those
    across it.

    Args:
        field: residual coefficients [m], shape (F, K).
    """
    n = settings.rod.control_points
    each = np.maximum(scatter(field, recording, settings), recording.bias)
    least = LEAST_NOISE * settings.rod.length
    typical = max(float(np.sqrt(np.mean(each[:n] ** 2))), least)
    across = np.maximum(each[:n], LEAST_SHARE * typical)
    others = [np.maximum(part, across) for part in np.split(each[n:], (len(each) - n) // n)]
    return np.concatenate([across, *others])
