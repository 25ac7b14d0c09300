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

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import Mask

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
    profiles: FloatArray,
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
    right = _crossings(sections[:, ::-1], offsets, width)
    between = 0.5 * (left - right)  # both are counted from the outside
    found = np.sqrt(between**2 @ LIKELY)
    known = np.isfinite(found)
    if not np.any(known):
        return np.zeros(len(profiles))
    return np.asarray(np.interp(np.arange(len(profiles)), at[known], found[known]))


def _usual(
    profiles: FloatArray,
    offsets: FloatArray,
    middle: FloatArray,
    seen: Mask,
    width: float,
    spacing: float,
) -> tuple[FloatArray, FloatArray]:
    """Medians of the cross-sections over parts of the DLO, shape (b, k), and the parts' middles."""
    count, samples = profiles.shape
    size = max(FEWEST, round(LENGTH * width / spacing))
    parts = -(-count // size)
    # Shifted so that the middle that was found lies at zero.
    place = (offsets[None, :] + middle[:, None] - offsets[0]) / (offsets[1] - offsets[0])
    low = np.clip(np.floor(place).astype(np.int64), 0, samples - 2)
    share = np.clip(place - low, 0.0, 1.0)
    rows = np.arange(count)[:, None]
    shifted = (1.0 - share) * profiles[rows, low] + share * profiles[rows, low + 1]
    padded = np.full((parts * size, samples), np.inf)
    padded[:count][seen] = shifted[seen]
    number = np.bincount(np.flatnonzero(seen) // size, minlength=parts)
    enough = np.flatnonzero(number >= FEWEST)
    ordered = np.sort(padded.reshape(parts, size, samples)[enough], axis=1)
    half = number[enough]
    each = np.arange(len(enough))
    medians = 0.5 * (ordered[each, (half - 1) // 2] + ordered[each, half // 2])
    return np.asarray(medians), np.asarray((enough + 0.5) * size)


def _crossings(sections: FloatArray, offsets: FloatArray, width: float) -> FloatArray:
    """Offsets at which each cross-section's left edge passes the levels of its climb [px], shape
    (b, levels).

    A level that the edge has passed already where the board should be lies there or further out;
    it counts as there. NaN where no edge is seen.
    """
    outside = (offsets <= -BOARD * width) & (offsets >= -1.05 * width)
    climb = np.flatnonzero((offsets > -BOARD * width) & (offsets <= 0.0))
    away = sections[:, climb] - sections[:, outside].mean(axis=1, keepdims=True)
    largest = np.abs(away).max(axis=1, keepdims=True)
    # The sign of the first difference that is one, from the outside inwards.
    first = np.argmax(np.abs(away) >= CLEAR * largest, axis=1)
    rows = np.arange(len(away))
    away = away * np.sign(away[rows, first])[:, None]
    top = np.maximum.accumulate(np.where(np.arange(away.shape[1]) < first[:, None], 0.0, away), 1)
    fallen = (away < top - FALL * largest) & (np.arange(away.shape[1]) > first[:, None])
    last = np.where(fallen.any(axis=1), np.argmax(fallen, axis=1), away.shape[1] - 1)
    height = top[rows, last]
    step = offsets[1] - offsets[0]
    result = np.full((len(away), len(LEVELS)), np.nan)
    for k, level in enumerate(LEVELS):
        wanted = level * height
        at = np.argmax(top >= wanted[:, None], axis=1)
        before = np.maximum(at - 1, 0)
        low, high = away[rows, before], away[rows, at]
        good = (high > low) & (height > 0.0)
        share = np.where(good, (wanted - low) / np.where(good, high - low, 1.0), np.nan)
        share = np.where((at == 0) & (height > 0.0), 0.0, share)
        result[:, k] = offsets[climb[before]] + step * np.clip(share, 0.0, 1.0)
    return result
