# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How a recording begins: at rest and for how long, let go, or in full motion.

A DLO in equilibrium moves as its command does. One that moves much farther has been let go, or has
been in motion before the recording began.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.inference.forecast import Manipulation, motion_of
from dlo_ros.inference.thresholds import FARTHER_THAN_LED, STEADY, TRACKER_ERROR
from dlo_ros.observation import Observation
from dlo_ros.spline import FloatArray, SplineBasis

PICTURES = 5
"""First pictures that tell of a motion: enough to tell it from noise and from a wrong picture."""
POINTS = 33
STILL = 1e-4
"""Distance over L by which a command that holds a DLO still may carry it: a hundredth of a
tracker's largest error."""


def apparent_start(manipulation: Manipulation, length: float) -> str | None:
    """The value of simulation.start of a recording that begins in motion by itself.

    Args:
        length: length of the DLO [m].

    Returns:
        `observed` where it has been let go from rest, `moving` where it was in motion already;
        None: nothing tells that it does not begin in equilibrium.
    """
    seen = manipulation.observations[:PICTURES]
    if len(seen) < PICTURES:
        return None
    r = points_along(seen)
    if r is None:
        return None
    times = np.array([o.stamp - seen[0].stamp for o in seen]) * 1e-9
    steps = np.diff(r, axis=0)
    lengths = np.linalg.norm(steps, axis=2)
    farthest = int(np.argmax(lengths.sum(axis=0)))
    path = float(lengths[:, farthest].sum())
    covered = float(np.linalg.norm(r[-1, farthest] - r[0, farthest]))
    # Both ends of a path may be wrong.
    least = max(2.0 * TRACKER_ERROR * length, FARTHER_THAN_LED * _imposed(manipulation, length))
    if path < least:
        return None
    if covered < STEADY * path or float(lengths[:, farthest].max()) > STEADY * path:
        return None
    if np.any(np.diff(times) <= 0.0):
        return None
    velocity, middle = steps / np.diff(times)[:, None, None], 0.5 * (times[1:] + times[:-1])
    # `observed` leaves out the velocity at first, `moving` what is gained in half an interval.
    gained = (velocity[1] - velocity[0]) * middle[0] / (middle[1] - middle[0])
    return "observed" if _size(velocity[0] - gained) < _size(gained) else "moving"


def points_along(observations: Sequence[Observation]) -> FloatArray | None:
    """Points evenly spaced along u of observed shapes [m], shape (F, POINTS, 3).

    Returns:
        None where their numbers of control points differ.
    """
    shapes = [o.control_points[:, :3] for o in observations]
    if len({len(shape) for shape in shapes}) != 1:
        return None
    values = SplineBasis(len(shapes[0]), 1.0).matrix(np.linspace(0.0, 1.0, POINTS))
    return np.asarray(values @ np.array(shapes))


def frames_at_rest(manipulation: Manipulation, length: float) -> int:
    """Number of the first frames in which the command holds the DLO still.

    Args:
        length: length of the DLO [m].
    """
    moved = _carried(manipulation, manipulation.observations, length) > STILL * length
    return int(np.argmax(moved)) if moved.any() else len(moved)


def _imposed(manipulation: Manipulation, length: float) -> float:
    """Distance by which the command alone carries any point in the first pictures [m]."""
    carried = _carried(manipulation, manipulation.observations[:PICTURES], length)
    return float(carried.max(initial=0.0))


def _carried(
    manipulation: Manipulation, observations: Sequence[Observation], length: float
) -> FloatArray:
    """Distance by which the command alone has carried any point at each observation [m].

    It is infinite where the command holds something else than at first.
    """
    motion = motion_of(manipulation)
    poses = [c.sample(o.stamp) for o in observations if (c := motion.at(o.stamp)) is not None]
    if len({len(places) for places, _ in poses}) != 1:
        return np.full(len(observations), np.inf if poses else 0.0)
    places, turns = (np.array(of_all) for of_all in zip(*poses, strict=True))  # (F, m, 3 and 4)
    cosine = np.abs(np.sum(turns * turns[0], axis=2)).clip(max=1.0)
    moved = np.linalg.norm(places - places[0], axis=2) + 2.0 * np.arccos(cosine) * length
    return np.asarray(moved.max(axis=1, initial=0.0))


def _size(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))
