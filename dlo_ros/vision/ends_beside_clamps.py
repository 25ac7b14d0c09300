# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Courses that are bridged to a clamp at which the DLO does not end.

Close to a clamp a DLO may be hidden, and its course is bridged to where the command has the clamp.
Where a bracket, the camera or its board is not where it should be, the DLO ends beside that place:
the bridge turns off the DLO's course like a hook, or shows nothing but the bare board.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.fit.planar_clamps import EndPoses
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.segmentation.cross_sections import Sections, offsets_for
from dlo_ros.vision.segmentation.picture_strip import (
    Mask,
    normals_of,
    resample,
    smooth_curve,
    strip_along,
)
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.tracing.occlusion_bridges import (
    FEWEST_SECTIONS,
    LONGEST_BARE,
    NEARBY,
    STEPS,
)

ASIDE = 1.0  # [widths] from a clamp, at which the seen course would arrive: the bridge is a hook
BESIDE, FAR = 0.5, 5.0  # [widths] from the bridge, between which the course tells where it leads
FEWEST_POINTS = 6  # of that part
LONGEST = 6.0  # [widths] of a bridge, over which that part tells anything


def ends_beside(image: Image, found: VisionResult | None, ends: EndPoses) -> bool:
    """Whether a course that was newly found ends beside its clamps.

    Args:
        image: BGR.
        found: the course; None: there is none.
        ends: the clamps.
    """
    if found is None or found.tracked:
        return False
    for clamp, way in ((ends.start, slice(None)), (ends.end, slice(None, None, -1))):
        if clamp is not None:
            course = resample(found.pixels[way], found.width / STEPS)
            share = np.linspace(0.0, 1.0, len(course))
            of_seen = np.linspace(0.0, 1.0, len(found.pixels_seen))
            seen = np.interp(share, of_seen, found.pixels_seen[way]) > 0.5
            if _is_hook(course, seen) or _is_bare(image, course, seen, found.width):
                return True
    return False


def _is_hook(course: FloatArray, seen: Mask) -> bool:
    """Whether a course begins aside of where it would arrive if it went on as it is seen to.

    Args:
        course: `STEPS` points in a width of the DLO, shape (m, 2).
        seen: whether the DLO was seen there, shape (m,).
    """
    hidden, index = int(np.argmax(seen)), np.arange(len(seen))
    near = seen & (index > hidden + BESIDE * STEPS) & (index < hidden + FAR * STEPS)
    if not 0 < hidden < LONGEST * STEPS or np.count_nonzero(near) < FEWEST_POINTS:
        return False
    arrived = np.polynomial.polynomial.polyfit(index[near], course[near], 2)[0]
    step = float(np.hypot(*(course[1] - course[0])))
    return float(np.hypot(*(arrived - course[0]))) > ASIDE * STEPS * step


def _is_bare(image: Image, course: FloatArray, seen: Mask, width: float) -> bool:
    """Whether a course begins on the bare board, see `_is_hook`."""
    hidden = int(np.argmax(seen))
    own = seen & (np.arange(len(seen)) < hidden + NEARBY * STEPS)
    if hidden <= LONGEST_BARE * STEPS or np.count_nonzero(own) < FEWEST_SECTIONS:
        return False
    normals, offsets = normals_of(smooth_curve(course, float(STEPS))), offsets_for(width)
    dlo = Sections.of(strip_along(image, course[own], normals[own], offsets), offsets, width)
    _, bare = dlo.odds(strip_along(image, course[:hidden], normals[:hidden], offsets))
    return bool(np.count_nonzero(bare > 0.0) >= LONGEST_BARE * STEPS)
