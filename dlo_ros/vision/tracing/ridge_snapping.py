# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Moves a rough curve onto the DLO that runs beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import (
    CORE,
    Float32,
    inside,
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
    ranges = []
    for low, high in ((-CORE, CORE), (-0.95, -0.65), (0.65, 0.95)):
        first = margin + round(low * width / step)
        ranges.append((first, max(first + 1, margin + round(high * width / step) + 1)))
    core, score = contrasts(strip, np.array(ranges), 2 * reach + 1)
    scale = contrast if contrast else float(np.percentile(score.max(axis=1), 60))
    scale = max(scale, 1.0)
    known = np.zeros(0, np.float32) if colour is None else colour.astype(np.float32)
    score = scores(core, score, known, scale)
    if not np.all(inside(image, curve, search)):
        _disregard_outside(score, image, curve, normals, np.arange(-reach, reach + 1.0) * step)
    shift = best_course(score, STEEPNESS * step * step, 2) - reach
    sigma = 0.6 * width / spacing_for(width)
    moved = smooth_curve((shift * step)[:, None], sigma)
    return curve + moved * normals


def _disregard_outside(
    score: FloatArray, image: Image, curve: FloatArray, normals: FloatArray, offsets: FloatArray
) -> None:
    """Take back, in place, what the repeated border of the picture tells beyond it.

    A row whose own place lies outside tells nothing; another one leads nowhere outside.

    Args:
        score: score of each row's offsets, shape (m, k).
        image: BGR.
        curve, normals: place and unit normal of each row [px], shape (m, 2).
        offsets: [px], shape (k,).
    """
    places = curve[:, None] + offsets[:, None] * normals[:, None]
    seen = inside(image, places.reshape(-1, 2)).reshape(score.shape)
    np.copyto(score, score.min(axis=1, keepdims=True), where=~seen)
    score[~inside(image, curve)] = 0.0


@njit(fastmath=True)
def contrasts(strip: Float32, ranges: NDArray[np.int64], count: int) -> tuple[Float32, Float32]:
    """Colour of a bar at each offset, and its contrast to the weaker of its two sides.

    Args:
        strip: colours across a curve, shape (m, k, 3).
        ranges: first and last (exclusive) sample of the bar and of both sides for the first offset,
            shape (3, 2).
        count: number of offsets, each a sample further.

    Returns:
        Shapes (m, 3, count) and (m, count) [grey levels].
    """
    rows, samples = strip.shape[:2]
    core = np.empty((rows, 3, count), dtype=np.float32)
    contrast = np.empty((rows, count), dtype=np.float32)
    squares = np.empty((2, count), dtype=np.float32)
    total = np.zeros(samples + 1, dtype=np.float32)
    share = np.float32(1.0) / (ranges[:, 1] - ranges[:, 0]).astype(np.float32)
    for i in range(rows):
        squares[:] = 0.0
        for c in range(3):
            for j in range(samples):
                total[j + 1] = total[j] + strip[i, j, c]
            inner = core[i, c]
            low, high = total[ranges[0, 0] :], total[ranges[0, 1] :]
            for j in range(count):
                inner[j] = (high[j] - low[j]) * share[0]
            for side in range(1, 3):
                low, high = total[ranges[side, 0] :], total[ranges[side, 1] :]
                square = squares[side - 1]
                for j in range(count):
                    difference = inner[j] - (high[j] - low[j]) * share[side]
                    square[j] += difference * difference
        for j in range(count):
            contrast[i, j] = np.sqrt(min(squares[0, j], squares[1, j]))
    return core, contrast


@njit(fastmath=True)
def scores(core: Float32, contrast: Float32, colour: Float32, scale: float) -> FloatArray:
    """Score of a bar at each offset: its contrast, less what its colour differs by.

    Args:
        core, contrast: see `contrasts`.
        colour: colour of the DLO, shape (3,); empty where it is not known.
        scale: contrast of the DLO [grey levels].
    """
    rows, count = contrast.shape
    result = np.empty((rows, count))
    one = np.float32(1.0)
    share = one / np.float32(scale)
    for i in range(rows):
        for j in range(count):
            result[i, j] = min(contrast[i, j] * share, one)
        if len(colour) > 0:
            for j in range(count):
                blue = core[i, 0, j] - colour[0]
                green = core[i, 1, j] - colour[1]
                red = core[i, 2, j] - colour[2]
                apart = np.sqrt(blue * blue + green * green + red * red)
                result[i, j] -= min(apart * share, np.float32(1.5))
    return result


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
