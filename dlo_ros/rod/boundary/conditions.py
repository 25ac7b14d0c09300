# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled sampling of an imposed motion: where the held degrees of freedom are at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.interpolation import sample
from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.strains import carry
from dlo_ros.rod.simd.vector_algebra import cross, dot, mix, mix3, row
from dlo_ros.spline import FloatArray

# What an imposed thing is (columns of `Imposed`).
START_CLAMP, END_CLAMP, START_TIP, START_SECOND, END_TIP, END_SECOND, PIN = range(7)

# Layout of the frame of an end.
# tangent and first director of the reference frame, the material director in the clamp's own
# coordinates, whether a clamp holds it, and the twist angle [rad], accumulated over full turns.
TANGENT, DIRECTOR, BODY, HELD, THETA, FRAME = 0, 3, 6, 9, 10, 11

NO_STEP = np.array([0.0, 0.0, 1.0])  # of `Imposed.slip_step`


class Imposed(NamedTuple):
    """A command for compiled code; see `dlo_ros.command.Command`."""

    times: FloatArray  # (T,) [s] from the command's start
    positions: FloatArray  # (T, K, 3) [m]
    rotations: FloatArray  # (T, K, 4) unit quaternions x y z w
    velocities: FloatArray  # (T, K, 3) [m/s], NaN where a point carries none
    kinds: FloatArray  # (K,) integers
    gain: FloatArray  # (T,) free length slipped in through a grip until then, of L
    slip_step: FloatArray  # (3,) what slips in by a smooth step, of L, from when on, how long [s]


@njit(from_python=False)
def _column(q, column):
    """A column of the rotation matrix of a unit quaternion."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    if column == 0:
        return 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    if column == 1:
        return 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)
    return 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)


@linked()
def _follow(frame, tangent):
    """Transport the reference frame of an end to a new tangent, a vector as a tuple."""
    director = carry(_vector(frame, DIRECTOR), _vector(frame, TANGENT), tangent)
    for c in range(3):
        frame[TANGENT + c], frame[DIRECTOR + c] = tangent[c], director[c]


@njit(from_python=False)
def _vector(frame, at):
    """A vector of the frame of an end, which begins there."""
    return frame[at], frame[at + 1], frame[at + 2]


@linked()
def _turn(frame, quaternion):
    """Follow a clamp to a new orientation: the twist angle that it imposes goes to the frame."""
    tangent = _column(quaternion, 0)
    _follow(frame, tangent)
    director = _vector(frame, DIRECTOR)
    second = cross(tangent, director)
    if frame[HELD] == 0.0:
        material = mix(np.cos(frame[THETA]), director, np.sin(frame[THETA]), second)
        for c in range(3):
            frame[BODY + c] = dot(_column(quaternion, c), material)
        frame[HELD] = 1.0
    material = mix3(
        frame[BODY], tangent, frame[BODY + 1], _column(quaternion, 1),
        frame[BODY + 2], _column(quaternion, 2),
    )  # fmt: skip
    angle = np.arctan2(dot(material, second), dot(material, director))
    change = (angle - frame[THETA] + np.pi) % (2.0 * np.pi) - np.pi
    frame[THETA] += change


@linked()
def align(frame, base):
    """Express the frame of an end against that of another run, carried to its tangent.

    An end's frame comes from the first shape the short way; two runs whose clamps differ come there
    by two ways, between which frames turn about the tangent.

    Args:
        frame: (FRAME,), changed.
        base: frame of the other run, (FRAME,).

    Returns:
        By how much the twist angle grows [rad].
    """
    tangent, own = _vector(frame, TANGENT), _vector(frame, DIRECTOR)
    director = carry(_vector(base, DIRECTOR), _vector(base, TANGENT), tangent)
    angle = np.arctan2(dot(own, cross(tangent, director)), dot(own, director))
    for c in range(3):
        frame[DIRECTOR + c] = director[c]
    frame[THETA] += angle
    return angle


@njit(from_python=False)
def _find(kinds, kind):
    """Index of the imposed thing of a kind; -1: none."""
    for k in range(kinds.size):
        if kinds[k] == kind:
            return k
    return -1


@linked(from_python=True)
def impose(imposed, time, theta, reach, frames, target, pins):
    """Values of the held degrees of freedom at a time.

    Args:
        theta: twist angles at both ends now, which stay where no clamp turns them [rad].
        reach: distance of the second control point from the end [m].
        frames: frames of both ends, (2, FRAME), carried along.
        target: output, (n, 4) or (n, 2); only rows that are held mean anything.
        pins: output, positions of the pinned points, (k, 3).

    Returns:
        Whether it is usable: control points that shall give a direction must not coincide.
    """
    count = imposed.kinds.size
    position, rotation = np.empty((count, 3)), np.empty((count, 4))
    sample(
        imposed.times, imposed.positions, imposed.rotations, imposed.velocities, time, position,
        rotation,
    )  # fmt: skip
    pinned = 0
    for k in range(count):
        if imposed.kinds[k] == PIN:
            for c in range(3):
                pins[pinned, c] = position[k, c]
            pinned += 1
    last = target.shape[0] - 1
    for end in range(2):
        outer, inner, sign = (0, 1, 1.0) if end == 0 else (last, last - 1, -1.0)
        clamp = _find(imposed.kinds, START_CLAMP if end == 0 else END_CLAMP)
        second = _find(imposed.kinds, START_SECOND if end == 0 else END_SECOND)
        at = _find(imposed.kinds, START_TIP if end == 0 else END_TIP) if clamp < 0 else clamp
        frames[end, THETA] = theta[end]
        directed = False
        if clamp >= 0:
            if end == 1 and frames[1, HELD] == 0.0:
                # It takes the DLO free of twist, as the clamp at the start has turned it.
                frames[1, THETA] += frames[0, THETA] - theta[0]
            _turn(frames[end], rotation[clamp])
            directed = True
        elif second >= 0:
            chord = mix(sign, row(position, second), -sign, row(position, at))
            size = np.sqrt(dot(chord, chord))
            if size < 1e-9 * reach:
                return False
            _follow(frames[end], (chord[0] / size, chord[1] / size, chord[2] / size))
            directed = True
        if at >= 0:
            for c in range(3):
                if target.shape[1] == 4:
                    target[outer, c] = position[at, c]
                elif c != 1:
                    target[outer, c // 2] = position[at, c]
                if directed:
                    value = position[at, c] + sign * reach * frames[end, TANGENT + c]
                    if target.shape[1] == 4:
                        target[inner, c] = value
                    elif c != 1:
                        target[inner, c // 2] = value
        if target.shape[1] == 4:
            target[outer, 3] = frames[end, THETA]
    return True
