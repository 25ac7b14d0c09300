# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Delay between the commands and the observed ends of the DLO, as where two clocks differ.

The held ends move as their commands do, whatever the DLO's material is, so that the delay by which
they do so best is that of the clocks. A constant offset of a place, as of a grip or of the camera,
is not counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, NANOSECONDS, START
from dlo_ros.inference.forecast import Manipulation, motion_of
from dlo_ros.inference.thresholds import LEAST_DELAY, TRACKER_ERROR, UNEXPLAINED_MOTION
from dlo_ros.observation import Observation
from dlo_ros.spline import FloatArray

LEVER = 0.25
"""Distance from the clamp, over L, at which its direction counts as a place."""
SHAPES, DELAYS = 300, 1500
"""Most shapes and delays that are compared: a tenth of a second of work."""


@dataclass(frozen=True)
class ApparentDelay:
    """A delay of the observed ends behind the commands.

    Args:
        seconds: the delay [s], positive where the DLO moves later.
        explained: share of the ends' motion that the command so much later explains.
        undelayed: share that the command explains as it is; negative where it contradicts.
    """

    seconds: float
    explained: float
    undelayed: float


def apparent_delay(manipulation: Manipulation, length: float) -> ApparentDelay | None:
    """The delay at which the observed ends follow the commands, where it is not small.

    Args:
        manipulation: commands and observed shapes.
        length: length of the DLO [m].

    Returns:
        The delay; None where the ends say nothing of it, or that it is below `LEAST_DELAY`.
    """
    shapes = manipulation.observations[:: -(-len(manipulation.observations) // SHAPES)]
    commands = motion_of(manipulation).commands
    if len(shapes) < 2 or not commands:
        return None
    begin, end = commands[0].stamp, max(c.end_stamp for c in commands)
    span = (end - begin) / NANOSECONDS
    at = np.array([(o.stamp - begin) / NANOSECONDS for o in shapes])
    times = np.linspace(0.0, span, DELAYS)
    seen, path = _ends(shapes, manipulation, begin, times, length)
    total = float(np.sum((seen - seen.mean(axis=0)) ** 2))
    if total < len(shapes) * (TRACKER_ERROR * length) ** 2:
        return None

    def left(delay: float) -> float:
        own = [np.interp(at - delay, times, column) for column in path.T]
        apart = seen - np.transpose(own)
        return float(np.sum((apart - apart.mean(axis=0)) ** 2))

    delays = np.linspace(at[0] - span, at[-1], DELAYS)
    found = min(delays, key=left)
    found = float(min(found + np.linspace(-1.0, 1.0, 41) * (delays[1] - delays[0]), key=left))
    rest, now = left(found), left(0.0)
    if abs(found) < LEAST_DELAY or rest > UNEXPLAINED_MOTION * min(total, now):
        return None
    return ApparentDelay(found, 1.0 - rest / total, 1.0 - now / total)


def _ends(
    shapes: Sequence[Observation], manipulation: Manipulation, begin: int, times: FloatArray,
    length: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Places of the ends that are held all the time, and of points before clamps.

    Args:
        begin: stamp of the first command [ns].
        times: instants of the commands from there [s], shape (k,).

    Returns:
        Coordinates [m] as observed, shape (m, c), and as imposed at those instants, shape (k, c).
    """
    motion, n = motion_of(manipulation), len(shapes[0].control_points)
    seen: list[FloatArray] = [np.zeros((len(shapes), 0))]
    imposed: list[FloatArray] = [np.zeros((len(times), 0))]
    stamps = [begin + round(t * NANOSECONDS) for t in times.tolist()]
    ruling = [(c, stamp) for stamp in stamps if (c := motion.at(stamp)) is not None]
    poses = [command.sample(stamp) for command, stamp in ruling]
    for end, tip, inner in ((START, 0, 1), (END, -1, -2)):
        held = [k for command, _ in ruling if (k := command.held(end, n)) is not None]
        if len(held) < len(times):
            continue
        ends = np.array([o.control_points[tip, :3] for o in shapes])
        seen.append(ends)
        imposed.append(np.array([places[k] for (places, _), k in zip(poses, held, strict=True)]))
        if all(end in command.names for command, _ in ruling):
            turns = [turned[k] for (_, turned), k in zip(poses, held, strict=True)]
            along = np.array([o.control_points[inner, :3] for o in shapes]) - ends
            along *= 1.0 if end == START else -1.0
            along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
            seen.append(LEVER * length * along)
            imposed.append(LEVER * length * Rotation.from_quat(turns).as_matrix()[:, :, 0])
    return np.hstack(seen), np.hstack(imposed)
