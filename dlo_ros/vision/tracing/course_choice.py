# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which of several courses is the DLO, where all of them are plausible.

Each was measured in the picture before, and those that the picture refutes are left out. Shapes
that are expected may choose between courses that remain, and do nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray

ONE_COURSE = 1.0  # [widths] measured courses that are nowhere further apart are one
FITS = 4.0  # [widths] a course that is further from an expected shape is not the expected one
NEARER = 0.5  # of the distance of another course that fits: an expected shape chooses between both
TWO_COURSES = "two courses of the DLO are equally plausible (an ambiguous crossing or gap)"


def choose(
    courses: Sequence[FloatArray],
    expected: Sequence[FloatArray],
    width: float,
    *,
    either_way: bool,
) -> int:
    """Index of the course that is the DLO.

    Args:
        courses: at least one, the most plausible first [px], shapes (m, 2).
        expected: shapes that the DLO may have, from the start to the end [px], shapes (m, 2).
        width: of the DLO [px].
        either_way: whether the same course backwards is the same course.

    Raises:
        VisionError: several courses, of which the expected shapes do not single out one.
    """
    kept: list[int] = []
    for k, course in enumerate(courses):
        others = [distance(course, courses[j], either_way=either_way) for j in kept]
        if min(others, default=np.inf) > ONE_COURSE * width:
            kept.append(k)
    if len(kept) == 1:
        return kept[0]
    told = [
        _nearest([distance(courses[k], shape, either_way=either_way) for k in kept], width)
        for shape in expected
    ]
    chosen = {k for k in told if k is not None}
    if len(chosen) != 1:
        raise VisionError(TWO_COURSES)
    return kept[chosen.pop()]


def _nearest(apart: Sequence[float], width: float) -> int | None:
    """Index of the distance that a shape tells; None where it fits none, or several alike."""
    first, second = np.argsort(apart)[:2]
    limit = FITS * width
    if apart[second] <= limit:
        limit = NEARER * apart[second]
    return int(first) if apart[first] <= limit else None


def distance(one: FloatArray, other: FloatArray, *, either_way: bool) -> float:
    """Largest distance of two courses, shapes (m, 2).

    Args:
        one, other: points along them.
        either_way: whether the same course backwards is the same course.
    """
    distances = [_apart(one, other)]
    if either_way:
        distances.append(_apart(one, other[::-1]))
    return min(distances)


def _apart(a: FloatArray, b: FloatArray, count: int = 100) -> float:
    """Largest distance of points of equal arc length, counted from the start or from the end.

    So two courses are alike where they differ in nothing but how far one of their ends reaches.
    """
    result = np.inf
    for one, other in ((a, b), (a[::-1], b[::-1])):
        along = [_arc_length(p) for p in (one, other)]
        at = np.linspace(0.0, min(along[0][-1], along[1][-1]), count)
        at_one, at_other = (
            np.column_stack([np.interp(at, s, p[:, 0]), np.interp(at, s, p[:, 1])])
            for s, p in zip(along, (one, other), strict=True)
        )
        result = min(result, float(np.hypot(*(at_one - at_other).T).max()))
    return result


def _arc_length(points: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
