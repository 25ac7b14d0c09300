# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The choice of the DLO among several courses that are all plausible.

Each was measured in the picture before, and those that the picture refutes are left out, as are
those for which it shows far less evidence than for another. Shapes that are expected may choose
between courses that remain, and do nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import Mask

ONE_COURSE = 1.0  # [widths] measured courses that are nowhere further apart are one
FITS = 4.0  # [widths] a course that is further from an expected shape is not the expected one
NEARER = 0.5  # of the distance of another course that fits: an expected shape chooses between both
DECISIVE = math.log(200.0)
"""Log of the odds at which one course rules another out: of pictures with two courses at most 0.5 %
may be decided wrongly."""
STRANDS = 1.0  # [widths] that a DLO's ridges are never apart, so that courses are two strands

TWO_COURSES = "two courses of the DLO are equally plausible (an ambiguous crossing or gap)"


class AmbiguousError(VisionError):
    """The picture bears out several courses."""


def choose(
    courses: Sequence[FloatArray],
    evidence: Sequence[float],
    expected: Sequence[FloatArray],
    width: float,
    rival: float = -math.inf,
    *,
    either_way: bool,
    seen: Sequence[Mask] | None = None,
) -> int:
    """Index of the course that is the DLO.

    Args:
        courses: courses, at least one [px], shapes (m, 2).
        evidence: log likelihood of each, up to one constant.
        expected: shapes that the DLO may have, from the start to the end [px], shapes (m, 2).
        width: width of the DLO [px].
        rival: log likelihood of the likeliest course that may be the DLO, too, but of which only a
            part was seen, up to the same constant.
        either_way: whether the same course backwards is the same course.
        seen: whether the DLO was seen there, for each course, shapes (m,). Two courses that differ
            only in how they bridge what neither shows are one, and the likelier bridge is taken.
            None: it was seen everywhere.

    Raises:
        AmbiguousError: the rival is likelier than all courses, or several courses, of which the
            expected shapes do not single out one.
    """
    kept: list[int] = []
    order = sorted(range(len(courses)), key=lambda k: -evidence[k])
    if rival > evidence[order[0]]:
        raise AmbiguousError(TWO_COURSES)
    for k in order:
        if evidence[k] < evidence[order[0]] - DECISIVE:
            break
        others = [distance(courses[k], courses[j], either_way=either_way) for j in kept]
        if seen is not None:
            others += [bridged_apart(courses[k], seen[k], courses[j], seen[j]) for j in kept]
        if min(others, default=np.inf) > ONE_COURSE * width:
            kept.append(k)
    if len(kept) == 1:
        return kept[0]
    nearest = [
        _nearest([distance(courses[k], shape, either_way=either_way) for k in kept], width)
        for shape in expected
    ]
    chosen = {k for k in nearest if k is not None}
    if len(chosen) != 1:
        raise AmbiguousError(TWO_COURSES)
    return kept[chosen.pop()]


def _nearest(apart: Sequence[float], width: float) -> int | None:
    """Index of the distance that fits a shape; None where none fits, or several alike."""
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


def bridged_apart(one: FloatArray, one_seen: Mask, other: FloatArray, other_seen: Mask) -> float:
    """Largest distance of two courses where either was seen, and at least that of their lengths.

    Before a gap points of equal arc length from the start are compared, behind it from the end.

    Args:
        one, other: points along them, from the same end, shapes (m, 2).
        one_seen, other_seen: whether the DLO was seen there, shapes (m,).
    """
    along = [_arc_length(p) for p in (one, other)]
    result = abs(float(along[0][-1] - along[1][-1]))
    pairs = ((one, one_seen, other), (other, other_seen, one))
    for (p, seen, q), (s, t) in zip(pairs, (along, along[::-1]), strict=True):
        apart = [
            np.hypot(*(p - np.column_stack([np.interp(at, t, column) for column in q.T])).T)
            for at in (s, t[-1] - (s[-1] - s))
        ]
        result = max(result, float(np.min(apart, axis=0)[seen].max(initial=0.0)))
    return result


def on_two_strands(
    one: FloatArray, one_seen: Mask, other: FloatArray, other_seen: Mask, width: float
) -> bool:
    """Whether a course runs along another strand than the other for more than a width.

    One DLO has no two ridges further apart than it is wide. What lies ahead of the other course's
    ends does not count, nor what lies beside what was not seen of it.

    Args:
        one, other: points of the courses, shapes (m, 2).
        one_seen, other_seen: whether the DLO was seen there, shapes (m,).
        width: width of the DLO, in the unit of the points.
    """
    step = np.hypot(*np.diff(other, axis=0).T)
    distance, nearest = cKDTree(other).query(one)
    along = np.concatenate([[0.0], np.cumsum(step)])[nearest]
    beyond = (along < width) | (along > float(np.sum(step)) - width)
    apart = one_seen & other_seen[nearest] & ~beyond & (distance > STRANDS * width)
    length = np.concatenate([[0.0], np.hypot(*np.diff(one, axis=0).T)])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], apart, [False]]).astype(np.int8)))
    runs = [float(np.sum(length[a:b])) for a, b in edges.reshape(-1, 2)]
    return max(runs, default=0.0) > STRANDS * width


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
