# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures that a recording lost and its stamps do not count.

Stamps that were given afterwards, by the number of each picture, do not know of a picture that was
lost. What is held and the whole DLO then move several times as far in one interval as in those
before and after it. A simulation would have to follow the grips at that speed, and its DLO would
swing from a blow that the real one never got. So the time that the lost pictures took is put back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.inference.first_motion import points_along
from dlo_ros.inference.forecast import Manipulation, motion_of
from dlo_ros.inference.lost_time import Gap, Stamps, true_stamps
from dlo_ros.inference.thresholds import MUCH_LARGER
from dlo_ros.spline import FloatArray


def lost_pictures(manipulation: Manipulation) -> tuple[Gap, ...]:
    """The intervals in which pictures were lost that the stamps do not count.

    What is held went about equally fast before and after, and several times as fast in the
    interval; so did the DLO. With the time put back less than half of that is left of both, and in
    no other interval what is held changes its speed half as much. Of the DLO single pictures may be
    wrong.

    Args:
        manipulation: commands that were recorded with the pictures, and observed shapes.
    """
    stamps = np.array([o.stamp for o in manipulation.observations], dtype=np.int64)
    imposed, shapes = _imposed(manipulation), points_along(manipulation.observations)
    if len(stamps) < 5 or imposed is None or shapes is None or np.any(np.diff(stamps) <= 0):
        return ()
    taken = (np.diff(stamps) / NANOSECONDS)[:, None]
    tracks = imposed, shapes.reshape(len(stamps), -1)
    speeds = [np.diff(track, axis=0) / taken for track in tracks]
    here, around = [v[1:-1] for v in speeds], [0.5 * (v[:-2] + v[2:]) for v in speeds]
    longer = [
        np.rint(np.sum(v * e, axis=1) / np.maximum(np.sum(e * e, axis=1), np.finfo(float).tiny))
        for v, e in zip(here, around, strict=True)
    ]
    held = speeds[0]
    steady = _size(held[2:] - held[:-2]) < _size(around[0])
    found = steady & (longer[0] > 1) & (longer[1] > 1)
    # An interval beside one of them has a wrong neighbour.
    apart = ~(found | np.append(found[1:], False) | np.append(False, found[:-1]))
    changes = [_size(v - e) for v, e in zip(here, around, strict=True)]
    found &= changes[0] > MUCH_LARGER * changes[0][apart].max(initial=0.0)
    for v, e, change in zip(here, around, changes, strict=True):
        put_back = v / np.where(found, longer[0], 1.0)[:, None]
        found &= MUCH_LARGER * _size(put_back - e) < change
    return tuple(
        Gap(int(stamps[k + 1]), int(stamps[k + 2]), int(longer[0][k]) - 1)
        for k in np.flatnonzero(found)
    )


def with_lost_time(manipulation: Manipulation, gaps: Sequence[Gap]) -> Manipulation:
    """A manipulation with the time put back that lost pictures took.

    Args:
        gaps: by growing stamp.
    """

    def true(stamps: Sequence[int] | Stamps) -> Stamps:
        return true_stamps(np.asarray(stamps, dtype=np.int64), gaps)

    def later(command: Command) -> Command:
        at = command.stamp + np.rint(command.times * NANOSECONDS).astype(np.int64)
        begin = int(true([command.stamp])[0])
        return replace(command, stamp=begin, times=(true(at) - begin) / NANOSECONDS)

    seen = manipulation.observations
    stamps = true([o.stamp for o in seen])
    return replace(
        manipulation,
        commands=tuple(later(c) for c in manipulation.commands),
        observations=tuple(replace(o, stamp=int(t)) for o, t in zip(seen, stamps, strict=True)),
        wrenches=tuple(replace(w, stamps=true(w.stamps)) for w in manipulation.wrenches),
        gaps=tuple(gaps),
    )


def _imposed(manipulation: Manipulation) -> FloatArray | None:
    """Coordinates of what is held, at each observation [m], shape (F, c); None: not the same."""
    motion = motion_of(manipulation)
    poses = [
        (c.names, c.sample(o.stamp)[0])
        for o in manipulation.observations if (c := motion.at(o.stamp)) is not None
    ]  # fmt: skip
    if len({names for names, _ in poses}) != 1:
        return None
    return np.array([places.ravel() for _, places in poses])


def _size(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1))
