# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Courses that change over from the DLO to a strip beside it, such as its shadow.

A shadow of the DLO's width that it casts beside itself has two edges, as the DLO has. Light changes
along a DLO, so that its colour alone does not tell them apart: a course may run on the DLO, be lost
for some widths, and go on in the shadow. But then each of both parts has beside it, all along, a
strip of the other one's colour.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import (
    CORE,
    Float32,
    Mask,
    normals_of,
    strip_along,
)
from dlo_ros.vision.segmentation.ridge_map import Image

SHORTEST = 2.0  # [widths] of a part that shows what lies beside it
STEP = 0.5  # [widths] between cross-sections, of whose colours the median is taken
BESIDE = 0.8
"""Distance of the middle of the strip beside the DLO [widths]: shadows are about as wide as the DLO
and partly below it."""
NARROW = 0.1  # [widths] to both sides of its middle that are looked at
NEARER = 0.5  # of the difference of two colours: a colour this near to one of them is that one
LEAST_CHANGE = 0.3  # of the DLO's contrast: colours that differ by less are one


def check_strips(
    image: Image, pixels: FloatArray, seen: Mask, width: float, contrast: float
) -> None:
    """Refuse a course that changes over between the DLO and a strip beside it.

    Args:
        image: BGR.
        pixels: the course from start to end [px], shape (m, 2).
        seen: whether the DLO was seen there, shape (m,).
        width: width of the DLO [px].
        contrast: contrast of the DLO to its background [grey levels].

    Raises:
        VisionError: two successive parts differ, and each has the colour of the other beside it.
    """
    if seen.all():
        return
    spacing = float(np.median(np.hypot(*np.diff(pixels, axis=0).T)))
    step = max(1, round(STEP * width / spacing))
    pixels, seen = pixels[::step], seen[::step]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(np.int8)))
    least = SHORTEST * width / (spacing * step)
    runs = [run for run in edges.reshape(-1, 2) if run[1] - run[0] > least]
    if len(runs) < 2:
        return
    normals = normals_of(pixels)
    core: FloatArray = width * np.linspace(-CORE, CORE, 5)
    beside: FloatArray = width * (BESIDE + np.linspace(-NARROW, NARROW, 3))

    strip = strip_along(image, pixels, normals, core)
    own = [_usual_colour(strip[a:b]) for a, b in runs]

    def nearest(run: NDArray[np.int64], colour: FloatArray) -> float:
        """How near the colours beside a part come to another one."""
        part = slice(run[0], run[1])
        strips = [
            strip_along(image, pixels[part], normals[part], side) for side in (beside, -beside)
        ]
        return min(float(np.linalg.norm(_usual_colour(strip) - colour)) for strip in strips)

    for k in range(len(runs) - 1):
        change = float(np.linalg.norm(own[k] - own[k + 1]))
        if change > LEAST_CHANGE * contrast and all(
            nearest(runs[a], own[b]) < NEARER * change for a, b in ((k, k + 1), (k + 1, k))
        ):
            raise VisionError("what looks like the DLO changes over to a strip beside it")


def _usual_colour(strip: Float32) -> FloatArray:
    """Median along a strip, mean across it, BGR, shape (3,)."""
    ordered = np.sort(strip, axis=0)
    half = len(strip) // 2
    median = ordered[half] if len(strip) % 2 else 0.5 * (ordered[half - 1] + ordered[half])
    return np.asarray(median.mean(axis=0))
