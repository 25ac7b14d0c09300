# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Masks and values over the profiles along a DLO: gaps, islands, outliers, running medians."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import minimum_filter1d

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.medians import median, median_filter
from dlo_ros.vision.segmentation.picture_strip import Mask

WIDTH_WINDOW = 8.0  # [widths] to each side, for the usual distance of the edges


def running_median(values: FloatArray, size: int) -> FloatArray:
    """Median over a window that moves along; of many values only a part is used."""
    index = np.arange(len(values))
    size = min(len(values), size)
    step = max(1, size // 32)
    some = median_filter(values[::step], max(3, size // step), reflect=True)
    return np.asarray(np.interp(index, index[::step], some))


def robust_std(values: FloatArray) -> float:
    """Standard deviation by the median absolute deviation; infinite without values."""
    if len(values) == 0:
        return float("inf")
    return 1.4826 * median(np.abs(values - median(values)))


def odd_width(width: FloatArray, both: Mask, profiles: float) -> Mask:
    """Profiles whose edges lie at another distance than in the neighbourhood.

    A hole or another strand of the DLO's tone beside it shifts one edge, and the middle by half.
    The width may change slowly, with the distance from the camera.
    """
    result = np.zeros(len(width), dtype=np.bool_)
    index = np.flatnonzero(both)
    if len(index) < 5:
        return result
    usual = running_median(width[index], 2 * round(WIDTH_WINDOW * profiles) + 1)
    difference = np.abs(width[index] - usual)
    spread = 1.4826 * median(difference)
    result[index] = difference > 4.0 * spread + 0.1 + 0.006 * usual
    return result


def eroded(mask: Mask, size: int) -> Mask:
    """A mask without what lies within a size of where it is false."""
    if size < 1 or mask.all():
        return mask
    return np.asarray(minimum_filter1d(mask, 2 * size + 1, mode="nearest"), dtype=np.bool_)


def long_runs(mask: Mask, size: int) -> Mask:
    """Mask of runs of true values that are longer than a size."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    result = np.zeros_like(mask)
    for first, last in edges.reshape(-1, 2):
        result[first:last] = last - first > size
    return result


def without_islands(seen: Mask, size: int) -> Mask:
    """The mask without pieces shorter than a size that lie between gaps longer than it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2]
    before = first - np.concatenate([[0], last[:-1]])
    after = np.concatenate([first[1:], [len(seen)]]) - last
    result = seen.copy()
    for k in np.flatnonzero((last - first < size) & (before > size) & (after > size)):
        result[first[k] : last[k]] = False
    return result


def filled(values: FloatArray, seen: Mask) -> FloatArray:
    """Values with those that were not seen interpolated."""
    if not np.any(seen):
        return np.zeros(len(values))
    index = np.arange(len(values))
    return np.asarray(np.interp(index, index[seen], values[seen]))


def outliers(middle: FloatArray, seen: Mask, width: float, spacing: float) -> Mask:
    """Points that jump away from their neighbours."""
    index = np.flatnonzero(seen)
    result = np.zeros(len(middle), dtype=np.bool_)
    if len(index) < 5:
        return result
    size = min(len(index), 2 * max(2, round(1.5 * width / spacing)) + 1)
    values = middle[index]
    residual = values - median_filter(values, size)
    spread = 1.4826 * median(np.abs(residual)) + 0.02 * width + 0.05
    result[index] = np.abs(residual) > 6.0 * spread
    return result
