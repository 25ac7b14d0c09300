# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Moves a curve from a part of the DLO to its middle, where the DLO's width is known.

A rope of two tones side by side, or with a shadow along it, shows three edges, and the part of most
contrast may be but half of it. The two edges that lie the known width apart are those of the DLO.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import (
    Float32,
    normals_of,
    smooth_curve,
    smooth_strip,
    spacing_for,
    strip_along,
)
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.tracing.ridge_snapping import best_course

FURTHEST = 0.4  # [widths] that the curve may lie beside the middle
WIDTHS = (0.85, 1.0, 1.15)  # of the known one that the distance of the edges may be
LESS_LIKELY = 0.85  # how much a pair of another distance than the known one counts
STEEPNESS = 0.3  # cost of moving by a pixel from one profile to the next
CLEARLY = 1.3  # times as strong must the edges of the moved curve be
SMALLEST = 0.1  # [widths] a smaller shift is left to the measurement of the edges
BLUR = 0.06  # [widths]
PEAK = 0.12  # [widths] to each side of an edge within which there is no other


def centred(image: Image, curve: FloatArray, width: float) -> tuple[FloatArray, bool]:
    """A curve moved to the middle between two edges that are a known width apart.

    Args:
        image: BGR.
        curve: equally spaced points on the DLO [px], shape (m, 2).
        width: width of the DLO [px], known to about a tenth.

    Returns:
        The curve, and whether it was moved.
    """
    step = max(0.5, width / 16.0)
    reach = int(np.ceil(FURTHEST * width / step))
    halves = [max(1, round(0.5 * share * width / step)) for share in WIDTHS]
    margin = max(halves) + 1
    offsets: FloatArray = np.arange(-reach - margin, reach + margin + 1.0) * step
    spacing = spacing_for(width)
    normals = normals_of(smooth_curve(curve, 1.5 * width / spacing))
    strip = strip_along(image, curve, normals, offsets)
    # Along the DLO its edges stay where they are, texture does not.
    edge = _steepness(smooth_strip(strip, 0.7 * width / spacing, BLUR * width / step))
    # Only the tops of edges: the flank of a strong one outdoes the top of a weak one.
    size = 2 * max(1, round(PEAK * width / step)) + 1
    edge = np.where(edge >= maximum_filter1d(edge, size, axis=1), edge, 0.0)
    edge = maximum_filter1d(edge, 3, axis=1)
    middle = slice(margin, margin + 2 * reach + 1)
    score = np.zeros((len(curve), 2 * reach + 1))
    for half in halves:
        left = edge[:, middle.start - half : middle.stop - half]
        right = edge[:, middle.start + half : middle.stop + half]
        share = 1.0 if half == halves[len(halves) // 2] else LESS_LIKELY
        score = np.maximum(score, share * np.minimum(left, right))
    usual = max(float(np.median(score.max(axis=1))), 1e-6)
    score = np.minimum(score / usual, 1.5)
    shift = best_course(score, STEEPNESS * step * step, 2) - reach
    here = score[:, reach]
    there = score[np.arange(len(curve)), np.rint(shift).astype(np.int64) + reach]
    large = abs(float(np.median(shift))) * step > SMALLEST * width
    if not large or there.sum() < CLEARLY * here.sum():
        return curve, False
    moved = smooth_curve((shift * step)[:, None], width / spacing)
    return curve + moved * normals, True


@njit()
def _steepness(strip: Float32) -> Float32:
    """Change of the colour across a curve from each sample to the next [grey levels], shape (m, k).

    Args:
        strip: colours across the curve, shape (m, k, 3).
    """
    rows, samples, channels = strip.shape
    result = np.empty((rows, samples), dtype=np.float32)
    for i in range(rows):
        for j in range(samples):
            low, high = max(j - 1, 0), min(j + 1, samples - 1)
            square = np.float32(0.0)
            for c in range(channels):
                square += (strip[i, high, c] - strip[i, low, c]) ** 2
            result[i, j] = np.sqrt(square) / np.float32(high - low)
    return result
