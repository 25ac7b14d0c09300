# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Curves in the picture, and the picture straightened along them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.ridge_map import Image

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

TRUNCATED = 4.0  # standard deviations at which a Gaussian ends
CORE = 0.3  # half width of the part taken as the DLO's own colour, in widths


def spacing_for(width: float) -> float:
    """Distance of the profiles [px] for a DLO of a width [px]."""
    return float(np.clip(width / 5.0, 1.0, 4.0))


def resample(points: FloatArray, spacing: float) -> FloatArray:
    """Equally spaced points along a polyline, both ends kept, shape (m, d)."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = np.concatenate([[True], steps > 1e-9])
    points = points[keep]
    s = np.concatenate([[0.0], np.cumsum(steps[keep[1:]])])
    count = max(4, round(float(s[-1]) / spacing) + 1)
    at = np.linspace(0.0, s[-1], count)
    return np.column_stack([np.interp(at, s, column) for column in points.T])


def smooth_curve(points: FloatArray, sigma: float) -> FloatArray:
    """Gaussian smoothing along a curve that neither shortens its ends nor bends them."""
    if sigma <= 0.0:
        return points
    count = min(len(points) - 1, int(3 * sigma) + 1)
    head = 2 * points[0] - points[count:0:-1]
    tail = 2 * points[-1] - points[-2 : -count - 2 : -1]
    smooth = gaussian_filter1d(np.vstack([head, points, tail]), sigma, axis=0)
    return np.asarray(smooth[count : count + len(points)])


def normals_of(points: FloatArray) -> FloatArray:
    """Unit normals (the tangent turned from x to y) along a curve, shape (m, 2)."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(np.hypot(tangent[:, 0], tangent[:, 1]), 1e-12)[:, None]
    return np.column_stack([-tangent[:, 1], tangent[:, 0]])


def strip_along(
    image: Image, curve: FloatArray, normals: FloatArray, offsets: FloatArray
) -> Float32:
    """Colours on lines across a curve, shape (m, k, 3)."""
    x, y = _lines_across(curve, normals, offsets)
    sampled = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float32)


@njit()
def _lines_across(
    curve: FloatArray, normals: FloatArray, offsets: FloatArray
) -> tuple[Float32, Float32]:
    """Pixels x and y of points on lines across a curve, shapes (m, k)."""
    x = np.empty((len(curve), len(offsets)), dtype=np.float32)
    y = np.empty_like(x)
    for i in range(len(curve)):
        for j in range(len(offsets)):
            x[i, j] = curve[i, 0] + normals[i, 0] * offsets[j]
            y[i, j] = curve[i, 1] + normals[i, 1] * offsets[j]
    return x, y


def smooth_strip(strip: Float32, along: float, across: float = 0.0) -> Float32:
    """Gaussian means of what `strip_along` returned, or of a column for each of its lines.

    Args:
        strip: shape (m, k) or (m, k, 3).
        along, across: standard deviations along the curve and across it, in samples.
    """
    sizes = [2 * round(TRUNCATED * sigma) + 1 for sigma in (across, along)]
    smooth = cv2.GaussianBlur(
        strip, sizes, sigmaX=across, sigmaY=along, borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(smooth, dtype=np.float32)


def inside(image: Image, points: FloatArray, margin: float = 0.0) -> Mask:
    """Whether each point lies within the picture."""
    height, width = image.shape[:2]
    x, y = points[:, 0], points[:, 1]
    return np.asarray(
        (x >= margin) & (y >= margin) & (x <= width - 1 - margin) & (y <= height - 1 - margin)
    )
