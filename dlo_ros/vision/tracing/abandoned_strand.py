# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Courses that turn off a strand which goes straight on.

Where strands of one colour meet, a DLO leaves as it came, with its direction and its curvature. A
course that turns aside there, while the picture shows a strand that carries on what the course did
so far, has taken another DLO's strand. A bend alone is no reason: a DLO may bend wherever nothing
else carries it on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import Mask, resample

STEPS = 2  # points of the course in a width
BEFORE = 6  # [widths] of the course that are carried on, as a curve of constant curvature
AHEAD = (3, 5)  # [widths] where the strand that carries it on is looked for
MOSTLY = 0.8  # share of the part before that must have been seen
ON = 0.5  # [widths] from the course carried on to the strand
FORKED = 4  # [widths] from there on the strand is apart from the course
APART = 1.0  # [widths] of the strand from the course: nearer ridges may be the DLO's own
ALONG = 0.94  # cosine of the angle between the strand and the course carried on: 20 degrees


def abandons_strand(
    course: FloatArray,
    seen: Mask,
    strands: Sequence[FloatArray],
    width: float,
    free: tuple[bool, bool],
) -> bool:
    """Whether a course turns off a strand that goes straight on, or ends on one.

    Args:
        course: the measured course from start to end, shape (m, 2).
        seen: whether the DLO was seen there, shape (m,).
        strands: ridges of the picture that look like the DLO, each of shape (k, 2), k at least 2.
        width: width of the DLO, in the unit of the points.
        free: whether start and end are free; at a clamp a DLO ends whatever lies beyond.
    """
    line = resample(course, width / STEPS)
    visible = np.interp(_shares(line), _shares(course), seen) > 0.5
    if not strands:
        return False
    points = np.vstack(strands)
    apart = cKDTree(_prolonged(line, free)).query(points)[0] > APART * width
    if not np.any(apart):
        return False
    directions = np.vstack([_directions(strand) for strand in strands])
    tree = cKDTree(points)
    return any(
        _leaves(way, shown, tree, directions, apart, width)
        for way, shown in ((line, visible), (line[::-1], visible[::-1]))
    )


def _leaves(
    line: FloatArray,
    visible: Mask,
    tree: cKDTree,
    directions: FloatArray,
    apart: Mask,
    width: float,
) -> bool:
    """The same for one direction along the course, given by points at equal distances.

    Args:
        line: the course, shape (m, 2).
        visible: whether the DLO was seen there, shape (m,).
        tree: points of all strands.
        directions: unit vectors along the strands at these, shape (k, 2).
        apart: whether these lie beside the course, shape (k,).
        width: width of the DLO, in the unit of the points.
    """
    size, low, high = BEFORE * STEPS + 1, AHEAD[0] * STEPS, AHEAD[1] * STEPS
    if len(line) < size:
        return False
    before: FloatArray = np.arange(1.0 - size, 1.0)
    ahead: FloatArray = np.arange(low, high + 1.0)
    to_curve = np.asarray(np.linalg.pinv(np.vander(before, 3)), np.float64)
    windows = np.lib.stride_tricks.sliding_window_view(line, size, axis=0)  # (c, 2, size)
    curves = windows @ to_curve.T  # (c, 2, 3)
    carried = curves @ np.vander(ahead, 3).T  # (c, 2, a)
    way = curves[:, :, :2] @ np.vstack([2.0 * ahead, np.ones(len(ahead))])
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    distance, nearest = tree.query(carried.transpose(0, 2, 1), distance_upper_bound=ON * width)
    found = np.isfinite(distance)
    nearest = np.where(found, nearest, 0)
    along = np.abs(np.sum(directions[nearest] * way.transpose(0, 2, 1), axis=2))
    shown = np.lib.stride_tricks.sliding_window_view(visible, size).mean(axis=1)
    forked = apart[nearest][:, ahead >= FORKED * STEPS].all(axis=1)
    carries_on = (found & (along > ALONG)).all(axis=1) & forked
    return bool(np.any(carries_on & (shown >= MOSTLY)))


def _prolonged(line: FloatArray, free: tuple[bool, bool]) -> FloatArray:
    """A course with straight pieces at the ends that are held."""
    steps: FloatArray = np.arange(1.0, AHEAD[1] * STEPS + 1.0)[:, None] / STEPS
    before = line[0] + steps[::-1] * (line[0] - line[STEPS])
    behind = line[-1] + steps * (line[-1] - line[-1 - STEPS])
    return np.vstack([before[: 0 if free[0] else None], line, behind[: 0 if free[1] else None]])


def _directions(strand: FloatArray) -> FloatArray:
    way = np.gradient(strand, axis=0)
    return np.asarray(way / np.maximum(np.hypot(*way.T), 1e-9)[:, None])


def _shares(points: FloatArray) -> FloatArray:
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    return np.asarray(s / s[-1])
