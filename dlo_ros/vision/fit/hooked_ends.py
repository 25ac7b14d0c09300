# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Courses that turn aside to a clamp, at which the DLO would not arrive.

Close to a clamp a DLO may be hidden, and its course is bridged to where the command has the clamp.
Where a bracket, the camera or its board is not where it should be, the DLO ends beside that place,
and the bridge turns off the DLO's course like a hook.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.fit.planar_clamps import EndPoses
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.segmentation.picture_strip import Mask

ASIDE = 1.0  # [widths] from a clamp, at which the seen course would arrive: the bridge is a hook
BESIDE, FAR = 0.5, 5.0  # [widths] from the bridge, between which the course tells where it leads
FEWEST_POINTS = 6  # of that part
LONGEST = 6.0  # [widths] of a bridge, over which that part tells anything


def is_hooked(found: VisionResult | None, ends: EndPoses) -> bool:
    """Whether a course that was newly found turns aside to a clamp.

    Args:
        found: the course; None: there is none.
        ends: the clamps.
    """
    if found is None or found.tracked:
        return False
    ways = ((ends.start, slice(None)), (ends.end, slice(None, None, -1)))
    return any(
        _missed(found.pixels[way], found.pixels_seen[way], found.width) > ASIDE * found.width
        for clamp, way in ways
        if clamp is not None
    )


def _missed(pixels: FloatArray, seen: Mask, width: float) -> float:
    """Distance from its first point at which a course would arrive that goes on as it is seen to
    [px]; 0 where it is seen there, or too little of it is.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    hidden = float(arc[np.argmax(seen)])
    near = seen & (arc > hidden + BESIDE * width) & (arc < hidden + FAR * width)
    if not 0.0 < hidden < LONGEST * width or np.count_nonzero(near) < FEWEST_POINTS:
        return 0.0
    arrived = np.polynomial.polynomial.polyfit(arc[near], pixels[near], 2)[0]
    return float(np.hypot(*(arrived - pixels[0])))
