# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Quantities in recordings on which the residual of a model may depend: grips, motion, bending."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, NANOSECONDS, START, Motion
from dlo_ros.inference.forecast import motion_of
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import SMALL_SHARE
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

LEAST = 1e-3
"""Smallest variation that counts, in units of the length, of 1, of L/s or of 1/L."""
LATER = (3, 4, 5)
"""Legendre polynomials of the time; a slower function is taken out of each recording anyway."""
FADING = 2.0
"""Time with which the past fades, in units of sqrt(L / g)."""


@dataclass(frozen=True)
class Input:
    """A quantity that varied in recordings.

    Args:
        name: name of the quantity in plain words, to follow "depends on".
        columns: numbers of each recording on which a residual may depend, shape (F, m).
    """

    name: str
    columns: tuple[FloatArray, ...]


def inputs(
    recordings: Sequence[Recording], predicted: Sequence[FloatArray], settings: Settings
) -> tuple[Input, ...]:
    """All quantities that vary in some recording.

    Args:
        predicted: control points per recording [m], shape (F, n, 3 or more), of its last F frames.
        settings: length, gravity, control points.
    """
    length = settings.rod.length
    shapes = [p[:, :, :3] for p in predicted]
    times = [r.times[-len(p) :] for r, p in zip(recordings, shapes, strict=True)]
    grips = [_grip(r, len(p)) for r, p in zip(recordings, shapes, strict=True)]
    labels = sorted({label for g in grips for label in g})
    position, turned, velocity = (
        [_stacked(g, labels, what, len(t)) for g, t in zip(grips, times, strict=True)]
        for what in range(3)
    )
    velocity = [v * np.tile([1.0] * 3 + [0.5 * length] * 3, len(labels)) for v in velocity]
    speed = [np.linalg.norm(v, axis=1, keepdims=True) for v in velocity]
    slow = 0.1 * float(np.sqrt(np.mean(np.concatenate(speed) ** 2)))
    heading = [v / np.sqrt(s**2 + slow**2 + 1e-300) for v, s in zip(velocity, speed, strict=True)]
    gravity = float(np.linalg.norm(settings.gravity)) or 9.81
    fading = FADING * float(np.sqrt(length / gravity))
    main = _principal(velocity, 2)
    past = [_past(m, s, t, fading) for m, s, t in zip(main, speed, times, strict=True)]
    place = [np.column_stack([p, p[:, :1] ** 2 / length]) for p in _principal(position, 2)]
    whole = max(float(t[-1] - t[0]) for t in times)
    found = (
        ("the time since the start", [_clock(t, whole) for t in times], 1.0),
        ("the position of the grip", place, length),
        ("the orientation of the grip to gravity", _principal(turned, 2), 1.0),
        ("the speed of the grip", speed, length),
        ("the velocity of the grip", main, length),
        ("the direction in which the grip moves", _principal(heading, 2), 1.0),
        ("the history of the grip's motion", past, length),
        ("the bending of the DLO", _principal(_bending(shapes, settings), 3), 1.0 / length),
        ("the motion of the DLO", _principal(_motion(shapes, times), 3), length),
    )
    return tuple(
        Input(name, tuple(columns)) for name, columns, unit in found if _varies(columns, unit)
    )


def _varies(columns: Sequence[FloatArray], unit: float) -> bool:
    """Whether the input varies within any recording; differences between them do not count."""
    return any(bool(np.any(np.std(c, axis=0) > LEAST * unit)) for c in columns)


Grip = dict[str, tuple[FloatArray, FloatArray, FloatArray]]


def _grip(recording: Recording, frames: int) -> Grip:
    """Position [m], direction and both velocities of each held place; shape (F, 3), (F, 6)."""
    motion = motion_of(recording.manipulation)
    stamps = [o.stamp for o in recording.manipulation.observations[-frames:]]
    gaps = np.diff(stamps)
    half = int(np.median(gaps)) // 2 if len(gaps) else NANOSECONDS // 50
    labels = sorted({label for s in stamps for label in _held(motion, s)})
    result = {}
    for label in labels:
        states = np.zeros((3, frames, 6))
        for f, stamp in enumerate(stamps):
            here = _held(motion, stamp).get(label)
            if here is None:
                continue
            before, after = (_held(motion, stamp + k * half).get(label, here) for k in (-1, 1))
            states[:, f] = before, here, after
        velocity = (states[2] - states[0]) * NANOSECONDS / max(2 * half, 1)
        result[label] = states[1, :, :3], states[1, :, 3:], velocity
    return result


def _held(motion: Motion, stamp: int) -> dict[str, FloatArray]:
    """Position and direction of each held place at a stamp, shape (6,); no direction: zeros."""
    command = motion.at(stamp)
    if command is None:
        return {}
    n = command.control_points
    position, rotation = command.sample(stamp)
    at = dict(zip(command.names, position, strict=True))
    result = {}
    for name, p, (x, y, z, w) in zip(command.names, position, rotation, strict=True):
        direction = np.zeros(3)
        label, neighbour = name, ""
        if name in (START, END):  # the rotation's x axis
            direction = np.array(
                [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
            )
        elif name == f"{CONTROL_POINT}1":
            label, neighbour = START, f"{CONTROL_POINT}2"
        elif name == f"{CONTROL_POINT}{n}":
            label, neighbour = END, f"{CONTROL_POINT}{n - 1}"
        elif (name == f"{CONTROL_POINT}2" and f"{CONTROL_POINT}1" in at) or (
            name == f"{CONTROL_POINT}{n - 1}" and f"{CONTROL_POINT}{n}" in at
        ):
            continue  # it gives the direction of its end
        if neighbour in at:
            direction = (at[neighbour] - p) * (1.0 if label == START else -1.0)
            direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
        result[label] = np.concatenate([p, direction])
    return result


def _stacked(grip: Grip, labels: Sequence[str], what: int, frames: int) -> FloatArray:
    """One of a grip's arrays for all labels, zero where a recording does not hold that place."""
    width = 6 if what == 2 else 3
    parts = [grip[k][what] if k in grip else np.zeros((frames, width)) for k in labels]
    return np.concatenate(parts, axis=1)


def _principal(columns: Sequence[FloatArray], most: int) -> list[FloatArray]:
    """Principal components over all recordings, each about its own mean, shape (F, m)."""
    centred = [c - c.mean(axis=0) for c in columns]
    _, sizes, directions = np.linalg.svd(np.concatenate(centred), full_matrices=False)
    count = max(int(np.sum(sizes[:most] > SMALL_SHARE * sizes[0])), 1)
    return [c @ directions[:count].T for c in centred]


def _past(velocity: FloatArray, speed: FloatArray, times: FloatArray, fading: float) -> FloatArray:
    """Velocity with an exponentially fading memory, and the path travelled, shape (F, m)."""
    steps = np.diff(times, prepend=times[0])
    faded = np.zeros_like(velocity)
    for f in range(1, len(times)):
        share = np.exp(-steps[f] / fading)
        faded[f] = share * faded[f - 1] + (1.0 - share) * velocity[f]
    way = np.cumsum(speed[:, 0] * steps) / fading
    return np.column_stack([faded, way])


def _clock(times: FloatArray, whole: float) -> FloatArray:
    """Smooth functions of the time since the start, shape (F, m)."""
    share = 2.0 * (times - times[0]) / max(whole, 1e-12) - 1.0
    return np.asarray(np.polynomial.legendre.legvander(share, max(LATER))[:, LATER])


def _bending(shapes: Sequence[FloatArray], settings: Settings) -> list[FloatArray]:
    """Curvature along the DLO in the board's plane and out of it [1/m], shape (F, 2 Q)."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    u, weight = basis.quadrature(2)
    first, second = basis.matrix(u, 1), basis.matrix(u, 2)
    result = []
    for points in shapes:
        tangent, bend = first @ points, second @ points
        tangent /= np.maximum(np.linalg.norm(tangent, axis=2, keepdims=True), 1e-12)
        turn = np.cross(tangent, bend) * np.sqrt(weight / basis.length)[:, None]
        result.append(turn.reshape(len(points), -1))
    return result


def _motion(shapes: Sequence[FloatArray], times: Sequence[FloatArray]) -> list[FloatArray]:
    """Velocities of the control points [m/s], root mean squares over them, shape (F, 3 n)."""
    result = []
    for points, t in zip(shapes, times, strict=True):
        flat = points.reshape(len(points), -1) / np.sqrt(points.shape[1])
        result.append(np.gradient(flat, t, axis=0) if len(t) > 1 else np.zeros_like(flat))
    return result
