# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Noise of the observed splines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.inference.thresholds import FEWEST
from dlo_ros.observation import Observation
from dlo_ros.spline import FloatArray, SplineBasis

DIFFERENCE_ORDERS = (2, 4, 6)  # in time: a smooth residual enters them less and less


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


def noise_floor(observations: Sequence[Observation], basis: SplineBasis) -> float | None:
    """ERR of a perfect model [m]; None where the recording does not determine it.

    Differences in time of growing order tell it, which smooth motion enters less and less; the
    smallest counts. They are the root mean square along u, and the median over time: a moment of
    violent motion does not count. Where a DLO swings fast for the frame rate this is an upper
    bound. Of too few frames, or copies of one another, the points' stated std tells it.

    The mean length of a two-dimensional normal vector is sqrt(pi) / 2 times its root mean square.
    """
    if len(observations) >= FEWEST:
        white = whitening(basis.control_points, basis.length)
        shapes = np.array([white @ o.control_points[:, :3] for o in observations])
        stamps = np.array([o.stamp - observations[0].stamp for o in observations]) * 1e-9
        gaps = [divided_differences(shapes, stamps, order) for order in DIFFERENCE_ORDERS]
        square = min(float(np.median(np.sum(gap**2, axis=(1, 2)))) for gap in gaps)
        if square > 1e-18:
            return float(np.sqrt(0.25 * np.pi * square))
    sigma = point_noise(observations, basis)
    return None if sigma is None else float(np.sqrt(0.5 * np.pi) * sigma)
