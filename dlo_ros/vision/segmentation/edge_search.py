# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The two edges of a DLO in the profiles across it, and the middle between them.

Each edge is the steepest change towards the DLO's colour near an expected place.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import Float32, Mask

FADE = 0.3  # share of the window of an edge over which it fades out
LENS_STD = 0.5  # [px] of a lens's point spread: hardly any camera's picture is sharper


@njit()
def band_mean(strip: Float32, first: int, last: int) -> Float32:
    """Mean colour of the samples first to last (exclusive) of each profile, shape (m, 3)."""
    rows, _, channels = strip.shape
    result = np.zeros((rows, channels), dtype=np.float32)
    for i in range(rows):
        for j in range(first, last):
            for c in range(channels):
                result[i, c] += strip[i, j, c]
        for c in range(channels):
            result[i, c] /= np.float32(last - first)
    return result


@njit()
def slope_towards(strip: Float32, offsets: FloatArray, change: Float32) -> tuple[Float32, Float32]:
    """Slope of the picture across the DLO towards a colour.

    Args:
        strip: colours, shape (m, k, 3).
        offsets: offsets of the samples [px], evenly spaced, shape (k,).
        change: change of the colour at an edge, in the direction of growing offsets, shape (m, 3).

    Returns:
        Slope [grey levels/px], 0 where it falls, shape (m, k), and the whole change [grey levels],
        shape (m,).
    """
    rows, samples = strip.shape[:2]
    slope = np.empty((rows, samples), dtype=np.float32)
    climb = np.empty(rows, dtype=np.float32)
    profile = np.empty(samples, dtype=np.float32)
    per_step = np.float32((samples - 1) / (offsets[-1] - offsets[0]))
    for i in range(rows):
        climb[i] = np.sqrt(change[i, 0] ** 2 + change[i, 1] ** 2 + change[i, 2] ** 2)
        size = max(climb[i], np.float32(1e-6))
        b, g, r = change[i, 0] / size, change[i, 1] / size, change[i, 2] / size
        for j in range(samples):
            profile[j] = strip[i, j, 0] * b + strip[i, j, 1] * g + strip[i, j, 2] * r
        for j in range(samples):
            low, high = max(j - 1, 0), min(j + 1, samples - 1)
            rise = (profile[high] - profile[low]) * per_step / np.float32(high - low)
            slope[i, j] = max(rise, np.float32(0.0))
    return slope, climb


@njit()
def climbing_length(
    slope: Float32, offsets: FloatArray, climb: Float32, expected: FloatArray, window: float
) -> FloatArray:
    """Length over which an edge near an expected offset climbs by the whole change [px].

    Args:
        slope, climb: see `slope_towards`.
        offsets: offsets of the samples [px], shape (k,).
        expected: offset of the edge [px], shape (m,).
        window: distance from there within which the edge is looked for [px].

    Returns:
        Shape (m,).
    """
    length = np.empty(len(slope))
    for i in range(len(slope)):
        peak = 1e-6
        for j in range(len(offsets)):
            peak = max(peak, slope[i, j] * _taper(abs(offsets[j] - expected[i]), window))
        length[i] = climb[i] / peak
    return length


@njit()
def steepest_change(
    slope: Float32,
    offsets: FloatArray,
    climb: Float32,
    expected: FloatArray,
    window: FloatArray,
    width: float,
) -> tuple[FloatArray, Mask]:
    """Position of the steepest change towards the DLO's colour near an expected offset.

    The centroid of the squared slope is taken: it depends on neither level, so that a rope that is
    brighter on one side is not shifted.

    Args:
        slope, climb: see `slope_towards`.
        offsets: offsets of the samples [px], shape (k,).
        expected: offset of the edge [px], shape (m,).
        window: distance from there within which the edge is looked for [px], shape (m,).
        width: width of the DLO [px].

    Returns:
        Offset of the edge [px], shape (m,), and whether there is one.
    """
    position = expected.copy()
    found = np.zeros(len(slope), dtype=np.bool_)
    near = np.empty(len(offsets))
    # An edge climbs at least a quarter of the contrast within a third of the width.
    least = 0.25 / max(0.33 * width, 2.0)
    for i in range(len(slope)):
        peak = 0.0
        for j in range(len(offsets)):
            near[j] = slope[i, j] * _taper(abs(offsets[j] - expected[i]), window[i])
            peak = max(peak, near[j])
        total = moment = 0.0
        for j in range(len(offsets)):
            weight = max(near[j] - 0.25 * peak, 0.0) ** 2
            total += weight
            moment += weight * offsets[j]
        if total > 1e-9:
            position[i] = moment / total
            found[i] = peak > least * climb[i]
    return position, found


@njit(from_python=False, inline="always")
def _taper(distance: float, window: float) -> float:
    """Weight of a sample at a distance from a window's middle.

    A window that fades out does not jump when a sample enters or leaves it.
    """
    return min(max((window - distance) / (FADE * window), 0.0), 1.0)


def middle_of(
    left: FloatArray, has_left: Mask, right: FloatArray, has_right: Mask, half: float
) -> tuple[FloatArray, Mask]:
    """The middle from both edges, or from one and the width.

    Args:
        left, right: offsets of the edges [px], shape (m,).
        has_left, has_right: whether they were found, shape (m,).
        half: half the width of the DLO [px].

    Returns:
        Offset of the middle [px], shape (m,), and whether it was found.
    """
    both = has_left & has_right
    fits = np.abs(right - left - 2 * half) < 0.3 * half + 0.7
    middle = np.where(both, 0.5 * (left + right), np.where(has_left, left + half, right - half))
    seen = (both & fits) | (has_left ^ has_right)
    return np.where(seen, middle, 0.0), np.asarray(seen, dtype=np.bool_)


def blur_length(ramp: FloatArray, step: float) -> FloatArray:
    """Length over which light was smeared [px], shape (m,), by that over which edges climb.

    A Gaussian edge of standard deviation sigma has its contrast over its slope equal to
    sigma sqrt(2 pi). Pixels, their interpolation and the difference of samples that lie a step
    apart on either side have variances of 1/12, 1/6 and step^2 / 3, which are no blur, and a lens
    in focus has `LENS_STD`.
    """
    sharp = 2.0 * np.pi * (1.0 / 12.0 + 1.0 / 6.0 + step**2 / 3.0 + LENS_STD**2)
    return np.asarray(np.sqrt(np.maximum(ramp**2 - sharp, 0.0)))
