# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Direction of an observed shape: an observer without a command cannot know the DLO's start."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, START, Motion
from dlo_ros.observation import Observation

MISPLACED = 0.05  # of the length: ends that lie nearer to where they are held are not questioned
CLEARLY = 2.0  # so many times nearer the other way round


def runs_backwards(observation: Observation, motion: Motion) -> bool:
    """Whether a shape fits the commanded ends only when it is read from its other end.

    False where nothing can be said: neither end is held, or both lie close together.
    """
    command = motion.at(observation.stamp)
    if command is None:
        return False
    positions, _ = command.sample(observation.stamp)
    shape = observation.control_points[:, :3]
    here, there = 0.0, 0.0  # distance from the held points, as it is and the other way round
    for name, position in zip(command.names, positions, strict=True):
        if name in (START, f"{CONTROL_POINT}1"):
            first, last = shape[0], shape[-1]
        elif name in (END, f"{CONTROL_POINT}{command.control_points}"):
            first, last = shape[-1], shape[0]
        else:
            continue
        here += float(np.linalg.norm(first - position))
        there += float(np.linalg.norm(last - position))
    length = float(np.sum(np.linalg.norm(np.diff(shape, axis=0), axis=1)))
    return here > MISPLACED * length and here > CLEARLY * there


def turned_round(observation: Observation, length: float) -> Observation:
    """The shape read from its other end.

    Args:
        observation: the shape.
        length: length of the DLO [m].
    """
    shape = observation.control_points[::-1].copy()
    shape[:, 3] *= -1.0  # the axis of the twist angle points the other way
    points = observation.points
    if points is not None:
        points = replace(points, u=length - points.u)
    return Observation(observation.stamp, shape, points)


def along(motion: Motion, observation: Observation, length: float) -> Observation:
    """The shape in the direction from the commanded start to the commanded end.

    Args:
        motion: motion of the clamps.
        observation: the shape.
        length: length of the DLO [m].
    """
    return turned_round(observation, length) if runs_backwards(observation, motion) else observation


def all_along(
    motion: Motion, observations: Iterable[Observation], length: float
) -> tuple[Observation, ...]:
    """`along` for several shapes."""
    return tuple(along(motion, o, length) for o in observations)
