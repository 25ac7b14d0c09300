# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Corners of a pattern to a few hundredths of a pixel, from the edges that meet there."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.patterns import Charuco, Pattern
from dlo_ros.vision.segmentation.ridge_map import Image

ARM = 0.42  # of a square: how far from a corner its edges are followed
LONGEST_ARM = 30  # [px]; farther away the lens bends them
LANE = 0.2  # of a square: how far beside an edge its pixels count
MARKER_BLUR = 2.0  # [px] by which the gradients of a marker reach beyond it
MARKER_LANE = 0.6  # of the gap between a square's edge and the marker: the least lane
ITERATIONS = 30
WORST_CONDITION = 50.0  # of the corner's normal matrix: edges of one direction make no corner


def refined(
    gray: Image, pattern: Pattern, corners: NDArray[np.int64], pixels: FloatArray
) -> FloatArray:
    """Each corner where the edges around it meet; NaN where there is no corner nearby.

    The point q that minimises the sum of (g . (q - p))^2 over pixels p with gradient g (Foerstner
    and Guelch 1987, as OpenCV's cornerSubPix), but over a cross along the edges instead of a square
    window, so that the edges count on a long way while markers and noise beside them do not.
    """
    spacing = steps(pattern, corners, pixels)
    axes = _axes(pattern, corners, pixels)
    lanes = np.full(len(pixels), LANE)
    if isinstance(pattern, Charuco):  # the blurred edges of markers must stay outside
        gap = 0.5 * (1.0 - pattern.marker / pattern.square)
        lanes = np.clip(gap - MARKER_BLUR / spacing, MARKER_LANE * gap, LANE)
    x0, y0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 2 * LONGEST_ARM, 0)
    x1, y1 = np.ceil(pixels.max(axis=0)).astype(int) + 2 * LONGEST_ARM
    part = gray[y0:y1, x0:x1].astype(np.float32)
    slopes = np.stack([cv2.Scharr(part, cv2.CV_32F, 1, 0), cv2.Scharr(part, cv2.CV_32F, 0, 1)], -1)
    # Beyond the image's border nothing is known, and nothing counts.
    border = 2 * LONGEST_ARM
    slopes = np.pad(slopes, ((border, border), (border, border), (0, 0)))
    x0, y0 = x0 - border, y0 - border
    origin = np.array([x0, y0], dtype=np.float64)
    start = pixels - origin
    result = np.full(pixels.shape, np.nan)
    for k, place in enumerate(start):
        found = _meeting(slopes, place, axes[k], lanes[k])
        if found is not None and np.linalg.norm(found - place) < max(0.25 * spacing[k], 1.5):
            result[k] = found + origin
    return result


def _meeting(
    slopes: NDArray[np.float32], start: FloatArray, axes: FloatArray, lane: float
) -> FloatArray | None:
    """Intersection of edges along the axes (columns, one square long); None where there is none."""
    lengths = np.linalg.norm(axes, axis=0)
    if abs(np.linalg.det(axes)) < 0.05 * lengths[0] * lengths[1]:
        return None
    arms = np.minimum(ARM, LONGEST_ARM / lengths)
    half = int(np.ceil(np.abs(axes * arms).sum(axis=1).max())) + 2
    inverse = np.linalg.inv(axes)
    place = start
    for _ in range(ITERATIONS):
        cx, cy = np.rint(place).astype(int)
        height, columns = slopes.shape[:2]
        if not (half <= cx < columns - half and half <= cy < height - half):
            return None
        y, x = np.mgrid[cy - half : cy + half + 1, cx - half : cx + half + 1]
        offset = np.stack([x - place[0], y - place[1]], axis=-1)
        s, t = np.abs(np.moveaxis(offset @ inverse.T, -1, 0))
        # Fading out sideways, so that no pixel's entry makes the place jump.
        beside = np.where(s < arms[0], np.where(t < lane, 1.0 - (t / lane) ** 2, 0.0), 0.0)
        across = np.where(t < arms[1], np.where(s < lane, 1.0 - (s / lane) ** 2, 0.0), 0.0)
        weight = np.maximum(beside, across)
        inside = weight > 0.0
        g = slopes[cy - half : cy + half + 1, cx - half : cx + half + 1][inside].astype(np.float64)
        weighted = g * weight[inside][:, None]
        normal = g.T @ weighted
        right = weighted.T @ np.einsum("ij,ij->i", g, offset[inside])
        if np.linalg.cond(normal) > WORST_CONDITION:
            return None
        move = np.linalg.solve(normal, right)
        place = place + move
        if np.abs(move).max() < 1e-3:
            break
        if np.abs(place - start).max() > half:
            return None
    return np.asarray(place)


def _axes(pattern: Pattern, corners: NDArray[np.int64], pixels: FloatArray) -> FloatArray:
    """A square's side along x and along y at each corner, as columns [px], shape (n, 2, 2)."""
    flat = pattern.points[corners, :2]
    transform, _ = cv2.findHomography(flat, pixels)
    if transform is None:
        return np.zeros((len(corners), 2, 2))
    ends = []
    for sign in (-0.5, 0.5):
        for step in np.eye(2) * pattern.square * sign:
            p = np.column_stack([flat + step, np.ones(len(flat))]) @ np.asarray(transform).T
            ends.append(p[:, :2] / p[:, 2:])
    return np.stack([ends[2] - ends[0], ends[3] - ends[1]], axis=-1)


def neighbours(
    pattern: Pattern, corners: NDArray[np.int64], pixels: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pixels on the pattern's grid, NaN where unseen, shape (rows, columns, 2), and the spacing."""
    flat = np.full((pattern.rows * pattern.columns, 2), np.nan)
    flat[corners] = pixels
    grid = flat.reshape(pattern.rows, pattern.columns, 2)
    least = np.full((pattern.rows, pattern.columns), np.inf)
    for axis in (0, 1):
        length = np.linalg.norm(np.diff(grid, axis=axis), axis=2)
        length = np.where(np.isfinite(length), length, np.inf)
        first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        last = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        least[first] = np.minimum(least[first], length)
        least[last] = np.minimum(least[last], length)
    return grid, least


def steps(pattern: Pattern, corners: NDArray[np.int64], pixels: FloatArray) -> FloatArray:
    """Distance from each corner to its nearest neighbour [px], shape (n,)."""
    least = neighbours(pattern, corners, pixels)[1].ravel()[corners]
    known = least[np.isfinite(least)]
    return np.where(np.isfinite(least), least, known.min() if len(known) else 0.0)
