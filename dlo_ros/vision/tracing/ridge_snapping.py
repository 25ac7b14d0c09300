# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Moves a rough curve onto the DLO that runs beside it."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import (
    CORE,
    Float32,
    normals_of,
    smooth_curve,
    spacing_for,
    strip_along,
)
from dlo_ros.vision.segmentation.ridge_map import Image

STEEPNESS = 0.08  # cost of moving by a pixel from one profile to the next


def follow(
    image: Image,
    curve: FloatArray,
    width: float,
    search: float,
    colour: FloatArray | None = None,
    contrast: float | None = None,
) -> FloatArray:
    """Move a curve onto the bar that runs beside it (dynamic programming over the offset).

    Args:
        image: BGR.
        curve: equally spaced points [px], shape (m, 2).
        width: width of the DLO [px].
        search: largest distance of the DLO from the curve [px].
        colour: colour of the DLO, where it is known, shape (3,).
        contrast: contrast of the DLO, where it is known [grey levels].

    Returns:
        The moved and smoothed curve, shape (m, 2).
    """
    step = max(1.0, width / 10.0)
    reach = int(np.ceil(search / step))
    margin = int(np.ceil(1.1 * width / step)) + 1
    offsets: FloatArray = np.arange(-reach - margin, reach + margin + 1.0) * step
    normals = normals_of(smooth_curve(curve, 1.5 * width / spacing_for(width)))
    strip = strip_along(image, curve, normals, offsets)
    total = np.cumsum(strip, axis=1, dtype=np.float32)
    count = 2 * reach + 1

    def mean(low: float, high: float) -> Float32:
        first = margin + round(low * width / step)
        last = max(first + 1, margin + round(high * width / step) + 1)
        upper = total[:, last - 1 : last - 1 + count]
        return np.asarray((upper - total[:, first - 1 : first - 1 + count]) / (last - first))

    core = mean(-CORE, CORE)
    left, right = mean(-0.95, -0.65), mean(0.65, 0.95)
    score = np.minimum(np.linalg.norm(core - left, axis=2), np.linalg.norm(core - right, axis=2))
    scale = contrast if contrast else float(np.percentile(score.max(axis=1), 60))
    scale = max(scale, 1.0)
    score = np.minimum(score / scale, 1.0)
    if colour is not None:
        unlike = np.linalg.norm(core - colour.astype(np.float32), axis=2) / scale
        score -= np.minimum(unlike, 1.5)
    shift = best_course(score.astype(np.float64), STEEPNESS * step * step, 2) - reach
    sigma = 0.6 * width / spacing_for(width)
    moved = smooth_curve((shift * step)[:, None], sigma)
    return curve + moved * normals


@njit()
def best_course(score: FloatArray, steepness: float, largest: int) -> FloatArray:
    """Offset index per row that maximises the sum of scores less the cost of moving."""
    rows, count = score.shape
    value = score[0].copy()
    new = np.empty(count)
    origin = np.zeros((rows, count), dtype=np.int16)
    for i in range(1, rows):
        for j in range(count):
            best = -1e18
            source = j
            for d in range(-largest, largest + 1):
                k = j + d
                if 0 <= k < count:
                    v = value[k] - steepness * d * d
                    if v > best:
                        best = v
                        source = k
            new[j] = best + score[i, j]
            origin[i, j] = source
        value, new = new, value
    result = np.empty(rows)
    j = int(np.argmax(value))
    for i in range(rows - 1, -1, -1):
        result[i] = j
        j = origin[i, j]
    return result
