# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Free ends: where a DLO that no clamp holds begins and stops."""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.picture_strip import resample

EXTENSION = 3.0  # [widths] a free end is looked for beyond where it was
BRIDGED = 0.5  # [widths] an interruption of the colour that is no end


def prolong(
    points: FloatArray, width: float, spacing: float, start: bool, end: bool
) -> tuple[FloatArray, float]:
    """Equally spaced curve, prolonged straight on where an end is free.

    Args:
        points: polyline [px], shape (m, 2).
        width: width of the DLO [px].
        spacing: spacing of the resulting points [px].
        start, end: whether that end is free.

    Returns:
        The curve, shape (k, 2), and how much was added at each free end [px].
    """
    extra = EXTENSION * width
    curve = resample(points, spacing)
    span = max(1, min(len(curve) - 1, round(2 * width / spacing)))
    steps = np.arange(1, int(extra / spacing) + 1)[:, None] * spacing
    pieces = [curve]
    if start:
        away = curve[0] - curve[span]
        pieces.insert(0, (curve[0] + steps * away / max(float(np.hypot(*away)), 1e-9))[::-1])
    if end:
        away = curve[-1] - curve[-1 - span]
        pieces.append(curve[-1] + steps * away / max(float(np.hypot(*away)), 1e-9))
    return np.vstack(pieces), extra


def free_end(located: Located, prolonged: float, from_start: bool) -> float:
    """Place at which the DLO's colour stops near a prolonged end.

    Args:
        located: the DLO along a curve from `prolong`.
        prolonged: length by which that end was prolonged [px].
        from_start: whether the end is the one at the start of the curve.

    Returns:
        The profile, with fraction, counted from the curve's first.
    """
    likeness = located.likeness if from_start else located.likeness[::-1]
    count = len(likeness)
    inner = min(count - 1, round(2.0 * prolonged / located.spacing))
    at = inner
    gap = max(1, round(BRIDGED * located.width / located.spacing))
    missed = 0
    for k in range(inner, -1, -1):
        if likeness[k] > 0.5:
            at, missed = k, 0
        else:
            missed += 1
            if missed > gap:
                break
    # Where no edge is seen along it any more, a dark patch of the board goes on.
    seen = located.seen if from_start else located.seen[::-1]
    outermost = int(np.argmax(seen)) if np.any(seen) else 0
    at = max(at, outermost - round(0.8 * located.width / located.spacing))
    position = float(at)
    if at > 0 and likeness[at - 1] < 0.5 < likeness[at]:
        position -= float((likeness[at] - 0.5) / (likeness[at] - likeness[at - 1]))
    return position if from_start else count - 1.0 - position
