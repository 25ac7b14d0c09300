# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The points of ridges in a bar map, of which chains are traced."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.ridge_map import ORIENTATIONS

STEP = 2  # [px] to each side within which tracing looks for the next ridge point
GOES_ON = 0.3  # share of a ridge's strength that it has at least nearly a width further on


@njit()
def ridge_points(
    strength: NDArray[np.float32], orientation: NDArray[np.int8], reach: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Local maxima across the bar's direction, with sub-pixel offsets (x, y)."""
    height, width = strength.shape
    found = np.empty(height * width, dtype=np.int32)
    count = 0
    # With a border nothing that is compared lies outside; flat, a way is one number.
    stride = width + 2 * reach
    padded = np.zeros((height + 2 * reach, stride), dtype=np.float32)
    for y in range(height):
        row, inner = strength[y], padded[y + reach, reach : reach + width]
        for x in range(width):
            inner[x] = row[x]
    flat = padded.ravel()
    neighbours = np.zeros((ORIENTATIONS, 2), dtype=np.int64)
    next_to, along = np.zeros(ORIENTATIONS, dtype=np.int64), np.zeros(ORIENTATIONS, dtype=np.int64)
    aside = np.zeros((ORIENTATIONS, reach + 1), dtype=np.int64)
    for k in range(ORIENTATIONS):
        angle = k * math.pi / ORIENTATIONS
        normal = (-math.sin(angle), math.cos(angle))
        for axis in range(2):
            if abs(normal[axis]) > 0.3827:
                neighbours[k, axis] = 1 if normal[axis] > 0.0 else -1
        next_to[k] = neighbours[k, 0] + stride * neighbours[k, 1]
        along[k] = stride * round(reach * normal[0]) - round(reach * normal[1])
        for step in range(reach + 1):
            aside[k, step] = round(step * normal[0]) + stride * round(step * normal[1])
    # Each condition's list of a row's columns is made without a branch, which no processor could
    # foresee.
    left = np.empty(width, dtype=np.int64)
    for y in range(1, height - 1):
        begin = (y + reach) * stride + reach
        many = 0
        for x in range(1, width - 1):
            left[many] = x
            many += int(flat[begin + x] > 0.0)
        peaks = 0
        for i in range(many):
            x = left[i]
            here, way = begin + x, next_to[orientation[y, x]]
            left[peaks] = x
            peaks += int((flat[here] >= flat[here + way]) & (flat[here] > flat[here - way]))
        # A line goes on, at least to one side; a spot does not.
        lines = 0
        for i in range(peaks):
            x = left[i]
            here, way = begin + x, along[orientation[y, x]]
            left[lines] = x
            lines += int(max(flat[here + way], flat[here - way]) > GOES_ON * flat[here])
        for i in range(lines):
            x = left[i]
            here, k = begin + x, orientation[y, x]
            # The blur of a strong bar makes weak ones beside it.
            beside = np.float32(0.0)
            for step in range(2, reach + 1):
                beside = max(beside, flat[here + aside[k, step]], flat[here - aside[k, step]])
            found[count] = y * width + x
            count += int(beside <= 2.0 * flat[here])
    rows = np.empty(count, dtype=np.int64)
    columns = np.empty(count, dtype=np.int64)
    offsets = np.empty((count, 2))
    for i in range(count):
        y, x = divmod(found[i], width)
        k, here = orientation[y, x], (y + reach) * stride + reach + x
        value, ahead, behind = flat[here], flat[here + next_to[k]], flat[here - next_to[k]]
        shift = 0.5 * (ahead - behind) / max(2.0 * value - ahead - behind, 1e-6)
        shift = min(max(shift, -0.5), 0.5)
        rows[i], columns[i] = y, x
        offsets[i, 0] = shift * neighbours[k, 0]
        offsets[i, 1] = shift * neighbours[k, 1]
    return rows, columns, offsets


@njit()
def without_specks(
    rows: NDArray[np.int64], columns: NDArray[np.int64], shape: tuple[int, int], least: int
) -> NDArray[np.int64]:
    """Indices of the points of ridges that are linked, by steps, to at least so many in all."""
    total = len(rows)
    index = np.full((shape[0] + 2 * STEP, shape[1] + 2 * STEP), -1, dtype=np.int32)
    parent = np.arange(total)
    size = np.ones(total, dtype=np.int64)
    for k in range(total):  # row by row, so that the half of the neighbours before suffices
        y, x = rows[k] + STEP, columns[k] + STEP
        index[y, x] = k
        for dy in range(-STEP, 1):
            for dx in range(-STEP, STEP + 1 if dy < 0 else 0):
                other = index[y + dy, x + dx]
                if other < 0:
                    continue
                one, other = _root(parent, k), _root(parent, other)
                if one != other:
                    if size[one] < size[other]:
                        one, other = other, one
                    parent[other] = one
                    size[one] += size[other]
    kept = np.empty(total, dtype=np.int64)
    count = 0
    for k in range(total):
        kept[count] = k
        count += int(size[_root(parent, k)] >= least)
    return kept[:count].copy()


@njit(from_python=False)
def _root(parent: NDArray[np.int64], k: int) -> int:
    """The point that stands for all that are linked to one."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k
