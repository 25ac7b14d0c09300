# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Medians of a few hundred numbers, compiled: NumPy's and SciPy's take longer to be called."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray


def median(values: FloatArray) -> float:
    """Median of some numbers, shape (m,); NaN of none."""
    return float(_median(np.ascontiguousarray(values, dtype=np.float64)))


@njit()
def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else np.nan


def median_filter(values: FloatArray, size: int, *, reflect: bool = False) -> FloatArray:
    """Medians over a window that moves along, as SciPy's `median_filter`.

    Args:
        values: shape (m,), m at least 1.
        size: numbers in the window; of an even number it reaches one further back than ahead, and
            the median is the larger one of the two in the middle.
        reflect: whether the values are mirrored beyond their ends, else repeated.
    """
    return np.asarray(_median_filter(np.ascontiguousarray(values, dtype=np.float64), size, reflect))


@njit()
def _median_filter(values: FloatArray, size: int, reflect: bool) -> FloatArray:
    """See `median_filter`: the window is kept sorted."""
    count, before = len(values), size // 2
    extended = np.empty(count + size - 1)
    for i in range(len(extended)):
        at = i - before
        if reflect:
            at %= 2 * count
            at = min(at, 2 * count - 1 - at)
        extended[i] = values[min(max(at, 0), count - 1)]
    window = np.sort(extended[:size])
    result = np.empty(count)
    result[0] = window[before]
    for i in range(1, count):
        old, new = extended[i - 1], extended[i + size - 1]
        at = np.searchsorted(window, old)
        while at + 1 < size and window[at + 1] < new:
            window[at] = window[at + 1]
            at += 1
        while at > 0 and window[at - 1] > new:
            window[at] = window[at - 1]
            at -= 1
        window[at] = new
        result[i] = window[before]
    return result
