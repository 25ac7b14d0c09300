# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Depth of the DLO along its centreline, from a depth image aligned with the picture.

Depth sensors fail on thin cables: pixels at the edges lie between the DLO and what is behind it,
others have no depth at all. So only the core is sampled, and medians are taken. How far the axis
lies behind the surface depends on the DLO's direction, which the fit knows (`view_projection.py`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.picture_strip import normals_of

Depths = NDArray[np.floating[Any]]

CORE = np.linspace(-0.2, 0.2, 5)  # [widths] from the middle, where the depth is read
NEAREST, FARTHEST = 0.05, 20.0  # [m] other depths are none
LEAST_KNOWN = 0.3  # share of a course whose depth must be known
MEDIAN = 6.0  # [widths] along which a first shape's depths are smoothed


def profile_depths(image: Depths, located: Located, radius: float) -> FloatArray:
    """Depth of the surface's middle at each profile [m], NaN where there is none, shape (k,).

    Args:
        image: depths along the optical axis [m], NaN or 0 where there is none, shape (h, w).
        located: the DLO in the picture.
        radius: radius of the DLO [m].
    """
    return _across(image, located.points, located.normals, located.width, radius)


def _across(
    image: Depths, points: FloatArray, normals: FloatArray, width: float, radius: float
) -> FloatArray:
    height, wide = image.shape
    at = points[:, None, :] + (CORE * width)[:, None] * normals[:, None, :]
    x, y = np.rint(at[..., 0]).astype(np.int64), np.rint(at[..., 1]).astype(np.int64)
    inside = (x >= 0) & (y >= 0) & (x < wide) & (y < height)
    depth = image[y.clip(0, height - 1), x.clip(0, wide - 1)].astype(np.float64)
    known = inside & (depth > NEAREST) & (depth < FARTHEST)
    # The surface lies further back beside its middle.
    depth = np.where(known, depth - radius * (1.0 - np.sqrt(1.0 - (2.0 * CORE) ** 2)), np.inf)
    ordered, number = np.sort(depth, axis=1), known.sum(axis=1)
    rows = np.arange(len(points))
    low, high = np.maximum((number - 1) // 2, 0), np.minimum(number // 2, len(CORE) - 1)
    middle = np.full(len(points), np.nan)
    good = number > 0
    middle[good] = 0.5 * (ordered[rows, low] + ordered[rows, high])[good]
    return middle


def course_points(
    image: Depths, camera: Camera, course: FloatArray, width: float, radius: float
) -> FloatArray:
    """Points of the axis all along a course in the board frame [m], roughly, shape (k, 3).

    Args:
        image: see `profile_depths`.
        camera: camera of the picture.
        course, width, radius: see `course_depth`.
    """
    z = course_depth(image, course, width, radius) + radius
    seen = np.column_stack([camera.rays(course), np.ones(len(course))]) * z[:, None]
    return np.asarray((seen - camera.translation) @ camera.rotation)


def course_depth(image: Depths, course: FloatArray, width: float, radius: float) -> FloatArray:
    """Depth of the surface all along a course [m], smoothed, holes bridged, shape (k,).

    Args:
        image: see `profile_depths`.
        course: pixels, shape (k, 2).
        width: width of the DLO [px].
        radius: radius of the DLO [m].

    Raises:
        VisionError: hardly any of it has a depth.
    """
    depth = _across(image, course, normals_of(course), width, radius)
    known = np.flatnonzero(np.isfinite(depth))
    if len(known) < LEAST_KNOWN * len(depth):
        share = 100.0 * len(known) / max(len(depth), 1)
        raise VisionError(f"the depth image has a depth on {share:.0f} % of the DLO only")
    filled = np.interp(np.arange(len(depth)), known, depth[known])
    spacing = max(float(np.median(np.hypot(*np.diff(course, axis=0).T))), 1e-3)
    size = 2 * max(1, round(0.5 * MEDIAN * width / spacing)) + 1
    # The last depths beside a free end are of what is behind: repeated, they would prevail.
    smooth = median_filter(filled, size=size, mode="reflect")
    kernel = np.ones(size) / size
    padded = np.pad(smooth, size // 2, mode="edge")
    return np.asarray(np.convolve(padded, kernel, "valid"))
