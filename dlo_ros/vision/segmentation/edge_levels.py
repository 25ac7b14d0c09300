# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the middle of a DLO's usual cross-section.

Scatter along the DLO shows nothing of what all cross-sections have in common: a highlight beside
the middle, or a shadow beside one edge. But such a cross-section is not alike on both sides: the
middle between the edges is another one at each level of brightness. In the mean over some widths,
each edge is followed from the board inwards to where it stops climbing, and the middles at several
levels of the climb are compared with the one that was found.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import Float32, Mask

LENGTH = 4.0  # [widths] of the DLO that one cross-section is the median of
FEWEST = 8  # profiles of it
BOARD = 0.75  # [widths] from the middle, beyond which the board is
LEVELS = (0.2, 0.5, 0.8)  # of an edge's climb
LIKELY: FloatArray = (1.0 - np.array(LEVELS)) / np.sum(1.0 - np.array(LEVELS))
"""Probability that each is the level at which the DLO's surface begins.

The climb begins with the surface; how it ends depends on how the round surface is lit. So the
density of the level falls to zero at the end of the climb, linearly.
"""
CLEAR = 0.1  # of the largest difference from the board: an edge is more
FALL = 0.1  # of the same, by which what climbs no longer has fallen


def doubt_of_middle(
    profiles: Float32,
    offsets: FloatArray,
    middle: FloatArray,
    seen: Mask,
    width: float,
    spacing: float,
) -> FloatArray:
    """Root mean square distance of the middles at several levels from the one that was found.

    Args:
        profiles: brightness across the DLO, shape (m, k).
        offsets: offsets of the samples [px], evenly spaced, shape (k,).
        middle: middle of the DLO found in each profile [px], shape (m,).
        seen: profiles in which it was, shape (m,).
        width: width of the DLO [px].
        spacing: distance between profiles [px].

    Returns:
        [px], shape (m,); 0 where it is unknown.
    """
    sections, at = _usual(profiles, offsets, middle, seen, width, spacing)
    if len(at) == 0:
        return np.zeros(len(profiles))
    left = _crossings(sections, offsets, width)
    right = _crossings(np.ascontiguousarray(sections[:, ::-1]), offsets, width)
    between = 0.5 * (left - right)  # both are counted from the outside
    found = np.sqrt(between**2 @ LIKELY)
    known = np.isfinite(found)
    if not np.any(known):
        return np.zeros(len(profiles))
    return np.asarray(np.interp(np.arange(len(profiles)), at[known], found[known]))


def _usual(
    profiles: Float32,
    offsets: FloatArray,
    middle: FloatArray,
    seen: Mask,
    width: float,
    spacing: float,
) -> tuple[FloatArray, FloatArray]:
    """Medians of the cross-sections over parts of the DLO, shape (b, k), and the parts' middles."""
    count = len(profiles)
    size = max(FEWEST, round(LENGTH * width / spacing))
    parts = -(-count // size)
    number = np.bincount(np.flatnonzero(seen) // size, minlength=parts)
    enough = np.flatnonzero(number >= FEWEST)
    medians = _medians(profiles, offsets, middle, seen, enough, size)
    return np.asarray(medians), np.asarray((enough + 0.5) * size)


@njit()
def _medians(
    profiles: Float32,
    offsets: FloatArray,
    middle: FloatArray,
    seen: Mask,
    parts: NDArray[np.int64],
    size: int,
) -> FloatArray:
    """Medians of the cross-sections that were seen in some parts of a size, shape (b, k).

    The cross-sections are shifted so that the middle that was found lies at zero.
    """
    count, samples = profiles.shape
    step = offsets[1] - offsets[0]
    result = np.empty((len(parts), samples))
    shifted = np.empty((samples, size))
    for p in range(len(parts)):
        number = 0
        for i in range(parts[p] * size, min((parts[p] + 1) * size, count)):
            if not seen[i]:
                continue
            for j in range(samples):
                place = (offsets[j] + middle[i] - offsets[0]) / step
                low = min(max(int(np.floor(place)), 0), samples - 2)
                share = min(max(place - low, 0.0), 1.0)
                shifted[j, number] = (1.0 - share) * profiles[i, low] + share * profiles[i, low + 1]
            number += 1
        for j in range(samples):
            result[p, j] = np.median(shifted[j, :number])
    return result


@njit()
def _crossings(sections: FloatArray, offsets: FloatArray, width: float) -> FloatArray:
    """Offsets at which each cross-section's left edge passes the levels of its climb [px], shape
    (b, levels).

    A level that the edge has passed already where the board should be lies there or further out;
    it counts as there. NaN where no edge is seen.
    """
    result = np.full((len(sections), len(LEVELS)), np.nan)
    begin = last_outside = 0
    for j in range(len(offsets)):
        begin += offsets[j] < -1.05 * width
        last_outside += offsets[j] <= -BOARD * width
    samples = 0
    for j in range(last_outside, len(offsets)):
        samples += offsets[j] <= 0.0
    away, top = np.empty(samples), np.empty(samples)
    for i in range(len(sections)):
        ground = np.mean(sections[i, begin:last_outside])
        largest = 0.0
        for j in range(samples):
            away[j] = sections[i, last_outside + j] - ground
            largest = max(largest, abs(away[j]))
        # The sign of the first difference that is one, from the outside inwards.
        first = 0
        while first < samples - 1 and abs(away[first]) < CLEAR * largest:
            first += 1
        sign = np.sign(away[first])
        height, last = 0.0, -1
        for j in range(samples):
            away[j] *= sign
            height = max(height, away[j] if j >= first else 0.0)
            top[j] = height
            if last < 0 and j > first and away[j] < height - FALL * largest:
                last = j
        height = top[last]  # that of the innermost sample where nothing falls
        if height <= 0.0:
            continue
        for k in range(len(LEVELS)):
            wanted = LEVELS[k] * height
            at = 0
            while at < samples and top[at] < wanted:
                at += 1
            before = max(at - 1, 0)
            low, high = away[before], away[at]
            if at > 0 and not high > low:
                continue
            share = min(max((wanted - low) / (high - low), 0.0), 1.0) if at > 0 else 0.0
            result[i, k] = offsets[last_outside + before] + share * (offsets[1] - offsets[0])
    return result
