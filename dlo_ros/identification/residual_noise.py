# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Noise of the observed splines: of whole shapes, and of each coefficient of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import comb

from dlo_ros.inference.forecast import Forecast
from dlo_ros.inference.joint import Simulated
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.inference.thresholds import FEWEST
from dlo_ros.inference.variances import LEAST_NOISE
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

DIFFERENCE_ORDERS = (2, 4, 6)  # in time: a smooth residual enters them less and less
MEDIAN = 0.4549
"""Median of the square of a normal variable, over its mean."""
LEAST_SHARE = 0.5
"""Smallest share of the typical noise that a single coefficient may have."""


def divided_differences(values: FloatArray, times: FloatArray, order: int) -> FloatArray:
    """Differences over neighbouring frames, exact for polynomials, with the noise of one frame.

    Args:
        values: shape (F, ...).
        times: growing, shape (F,).

    Returns:
        Shape (F - order, ...).
    """
    t = sliding_window_view(times, order + 1)
    t = (t - t[:, :1]) / (t[:, -1:] - t[:, :1])
    weights = 1.0 / np.prod(t[:, :, None] - t[:, None, :] + np.eye(order + 1), axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    windows = sliding_window_view(values, order + 1, axis=0)
    return np.asarray(np.einsum("fo,f...o->f...", weights, windows))


def point_noise(observations: Sequence[Observation], basis: SplineBasis) -> float | None:
    """Noise floor by the stated std of the measured points, where a recording has them [m]."""
    values = [
        float(np.sqrt(np.mean(o.points.std**2) * basis.control_points / len(o.points.std)))
        for o in observations
        if o.points is not None and len(o.points.std) >= basis.control_points
    ]
    return float(np.median(values)) if values else None


def noise_floor(
    observations: Sequence[Observation], basis: SplineBasis, fitted: Forecast | None = None
) -> float | None:
    """ERR of a perfect model [m]; None where the recording does not determine it.

    Differences in time of growing order tell it, which smooth motion enters less and less; the
    smallest counts. They are the root mean square along u, and the median over time: a moment of
    violent motion does not count. Where a DLO swings fast for the frame rate that is an upper
    bound, and what a fitted model leaves of the motion tells more. Of too few frames, or copies of
    one another, the points' stated std tells it.

    The mean length of a two-dimensional normal vector is sqrt(pi) / 2 times its root mean square.

    Args:
        fitted: a model's forecast of these observations; None: there is none.
    """
    shapes = {o.stamp: o.control_points[:, :3] for o in observations}
    series = [shapes]
    if fitted is not None:
        pairs = zip(fitted.stamps, fitted.predicted, strict=True)
        series.append({int(s): shapes[int(s)] - p[:, :3] for s, p in pairs})
    white = whitening(basis.control_points, basis.length)
    squares = [_typical_square(each, white) for each in series if len(each) >= FEWEST]
    if squares and min(squares) > 1e-18:
        return float(np.sqrt(0.25 * np.pi * min(squares)))
    sigma = point_noise(observations, basis)
    return None if sigma is None else float(np.sqrt(0.5 * np.pi) * sigma)


def _typical_square(shapes: Mapping[int, FloatArray], white: FloatArray) -> float:
    """Median over time of the mean square along u of differences in time [m^2].

    Args:
        shapes: control points (n, 3) by stamp [ns].
        white: shape (n, n), see `whitening`.
    """
    values = np.array([white @ shape for shape in shapes.values()])
    stamps = np.array([stamp - next(iter(shapes)) for stamp in shapes]) * 1e-9
    gaps = [divided_differences(values, stamps, order) for order in DIFFERENCE_ORDERS]
    return min(float(np.median(np.sum(gap**2, axis=(1, 2)))) for gap in gaps)


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


def apart(at: Simulated, other: Simulated, recordings: Sequence[Recording]) -> float:
    """Root mean square difference of two simulations in units of the noise."""
    pairs = zip(whitened(at, recordings), whitened(other, recordings), strict=True)
    return rms([a - b for a, b in pairs])


def whitened(at: Simulated, recordings: Sequence[Recording]) -> list[FloatArray]:
    """Residuals of each recording in units of the noise, shape (F, K) each."""
    return [r / recording.noise for (r, _), recording in zip(at.fields, recordings, strict=True)]


def rms(residuals: Sequence[FloatArray]) -> float:
    """Root mean square of all residuals."""
    return float(np.sqrt(np.mean(np.concatenate([r.ravel() for r in residuals]) ** 2)))
