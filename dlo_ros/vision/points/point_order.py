# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Courses through an unordered cloud of points along a curve.

The cloud is contracted onto its local principal lines, thinned to nodes, and the nodes are joined
by a minimum spanning tree, whose longest path is a course (Lee, Curve reconstruction from
unorganized points, Computer Aided Geometric Design 17, 2000). Where the curve crosses itself the
tree takes a short cut, so a second course is traced straight on from the start.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from dlo_ros.spline import FloatArray

RADII = (0.025, 0.04, 0.065)
"""Neighbourhoods of the contraction [L]: strands must lie further apart, the noise must be less."""
MOST_ORDERED = 600  # points by which an order is searched; more do not help
CONTRACTIONS = 3
LONELY = 0.3  # of the usual number of neighbours, below which a point counts as an outlier
NODES_APART = 0.7  # [radii] distance of neighbouring nodes
LONGEST_GAP = 8.0  # [radii] that a traced course leaps over
TURN = 0.5  # [rad] usual change of direction from one step of a traced course to the next
EXCESS = 1.6  # a course may be so many times longer than the DLO


def courses(
    points: FloatArray,
    length: float,
    start: FloatArray | None = None,
    direction: FloatArray | None = None,
    end: FloatArray | None = None,
) -> Iterator[FloatArray]:
    """Courses through the cloud, the likelier ones first.

    Args:
        points: [m], shape (m, 3).
        length: length of the DLO [m].
        start: position of the grip at u = 0 [m], shape (3,); None: not known.
        direction: unit vector of growing u there, shape (3,); None: not known.
        end: position of the grip at u = L [m], shape (3,); None: not known.

    Yields:
        Polylines [m], shape (k, 3), from the start where it is known.
    """
    some = points[:: max(1, -(-len(points) // MOST_ORDERED))]
    for radius in (share * length for share in RADII):
        thin = contracted(some, radius)
        if len(thin) < 4:
            continue
        nodes = _nodes(thin, NODES_APART * radius)
        if len(nodes) < 4:
            continue
        path = nodes[_longest_path(nodes, start, end)]
        yield path
        if start is None:
            beginning, ahead = path[0], path[1] - path[0]
        else:
            beginning = start
            nearest = thin[np.linalg.norm(thin - start, axis=1) < 3.0 * radius]
            ahead = direction if direction is not None else nearest.mean(axis=0) - start
            if direction is None and not len(nearest):
                continue
        traced = _traced(thin, beginning, ahead, radius, EXCESS * length)
        if len(traced) > 3:
            yield traced


def contracted(points: FloatArray, radius: float) -> FloatArray:
    """The points moved onto the principal line of their neighbours, lonely ones left out.

    Args:
        points: [m], shape (m, 3).
        radius: radius of the Gaussian neighbourhood [m].
    """
    moved = points
    for step in range(CONTRACTIONS):
        weight = np.exp(-0.5 * cdist(moved, moved, "sqeuclidean") / (0.5 * radius) ** 2)
        total = weight.sum(axis=1)
        if step == 0:
            keep = total - 1.0 > LONELY * float(np.median(total - 1.0))
            moved, weight = moved[keep], weight[np.ix_(keep, keep)]
            if len(moved) < 4:
                return np.asarray(moved)
            total = weight.sum(axis=1)
        mean = weight @ moved / total[:, None]
        square = np.einsum("ij,ja,jb->iab", weight, moved, moved, optimize=True)
        spread = square / total[:, None, None] - mean[:, :, None] * mean[:, None, :]
        line = np.linalg.eigh(spread)[1][:, :, 2]
        moved = mean + np.sum((moved - mean) * line, axis=1, keepdims=True) * line
    return np.asarray(moved)


def _nodes(points: FloatArray, apart: float) -> FloatArray:
    """Means of the points around representatives that are at least `apart` from each other."""
    free = np.ones(len(points), dtype=bool)
    result = []
    while free.any():
        near = free & (np.linalg.norm(points - points[np.argmax(free)], axis=1) < apart)
        result.append(points[near].mean(axis=0))
        free &= ~near
    return np.array(result)


def _longest_path(nodes: FloatArray, start: FloatArray | None, end: FloatArray | None) -> list[int]:
    """Nodes of the longest path of the minimum spanning tree, or of that between known ends."""
    tree = minimum_spanning_tree(cdist(nodes, nodes))

    def nearest(place: FloatArray) -> int:
        return int(np.argmin(np.linalg.norm(nodes - place, axis=1)))

    if start is None:
        away, _ = dijkstra(tree, directed=False, indices=0, return_predecessors=True)
        first = int(np.argmax(away))
    else:
        first = nearest(start)
    away, before = dijkstra(tree, directed=False, indices=first, return_predecessors=True)
    last = int(np.argmax(away))
    if start is not None and end is not None and nearest(end) != first:
        last = nearest(end)
    path = [last]
    while path[-1] != first:
        path.append(int(before[path[-1]]))
    return path[::-1]


def _traced(
    points: FloatArray, start: FloatArray, ahead: FloatArray, radius: float, longest: float
) -> FloatArray:
    """A course straight on from a place, step by step to what lies ahead.

    Args:
        points: contracted [m], shape (m, 3).
        start: [m], shape (3,).
        ahead: direction, shape (3,).
        radius: [m] length of a step.
        longest: [m] at which it stops.
    """
    tree = cKDTree(points)
    place, course = np.asarray(start, dtype=np.float64), [start]
    heading = ahead / max(float(np.linalg.norm(ahead)), 1e-12)
    travelled = 0.0
    while travelled < longest:
        target = _ahead(points, tree, place, heading, radius)
        if target is None:
            break
        step = target - place
        size = float(np.linalg.norm(step))
        heading = step / size
        place = target
        travelled += size
        course.append(place)
    return np.array(course)


def _ahead(
    points: FloatArray, tree: cKDTree, place: FloatArray, heading: FloatArray, radius: float
) -> FloatArray | None:
    """The next point of a course; None where nothing lies ahead within the longest gap."""
    reach = 1.5 * radius
    while reach <= LONGEST_GAP * radius:
        near = points[tree.query_ball_point(place, reach)] - place
        size = np.linalg.norm(near, axis=1)
        near, size = near[size > 0.5 * radius], size[size > 0.5 * radius]
        turn = np.arccos(np.clip(near @ heading / np.maximum(size, 1e-12), -1.0, 1.0))
        weight = np.exp(-0.5 * (turn / TURN) ** 2) * (turn < 3.0 * TURN)
        if weight.sum() > 1e-3:
            # Those closest ahead; further ones may belong to another part of the DLO.
            closest = size < size[weight > 1e-3].min() + radius
            weight = weight * closest
            return np.asarray(place + weight @ near / weight.sum())
        reach *= 1.5
    return None
