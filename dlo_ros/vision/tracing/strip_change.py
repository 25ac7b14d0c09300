# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Courses that change over from the DLO to a strip beside it, such as its shadow.

A shadow of the DLO's width that it casts beside itself has two edges, as the DLO has. Light changes
along a DLO, so that its colour alone does not tell them apart: a course may run on the DLO, be lost
for some widths, and go on in the shadow. But then each of both parts has beside it, all along, a
strip of the other one's colour.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import (
    CORE,
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
    inner = width * np.linspace(-CORE, CORE, 5)
    outer = width * np.linspace(-NARROW, NARROW, 3)
    offsets = np.concatenate([inner, BESIDE * width + outer, -BESIDE * width + outer])
    sides = [len(inner), len(inner) + len(outer)]
    colours = []  # of each part's middle and both sides, shape (3, 3)
    for first, last in runs:
        some = slice(first, last)
        strip = np.median(strip_along(image, pixels[some], normals[some], offsets), axis=0)
        colours.append(np.array([part.mean(axis=0) for part in np.split(strip, sides)]))
    for before, after in pairwise(colours):
        change = float(np.linalg.norm(before[0] - after[0]))
        if change > LEAST_CHANGE * contrast and all(
            np.linalg.norm(one[1:] - other[0], axis=1).min() < NEARER * change
            for one, other in ((before, after), (after, before))
        ):
            raise VisionError("what looks like the DLO changes over to a strip beside it")
