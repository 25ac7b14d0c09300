# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Quantities in recordings on which the residual of a model may depend: grips, motion, bending."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, START
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.thresholds import SMALL_SHARE
from dlo_ros.parameters import STANDARD_GRAVITY, Settings
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
    grips = [_grips(*one, settings) for one in zip(recordings, shapes, times, strict=True)]
    position, turned, velocity = (list(parts) for parts in zip(*grips, strict=True))
    speed = [np.linalg.norm(v, axis=1, keepdims=True) for v in velocity]
    slow = 0.1 * float(np.sqrt(np.mean(np.concatenate(speed) ** 2)))
    heading = [v / np.sqrt(s**2 + slow**2 + 1e-300) for v, s in zip(velocity, speed, strict=True)]
    gravity = float(np.linalg.norm(settings.gravity)) or STANDARD_GRAVITY
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
    # It must vary within a recording: differences between recordings do not count.
    return tuple(
        Input(name, tuple(columns)) for name, columns, unit in found
        if any(np.any(np.std(c, axis=0) > LEAST * unit) for c in columns)
    )  # fmt: skip


def _grips(
    recording: Recording, shapes: FloatArray, times: FloatArray, settings: Settings
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions [m], directions and both velocities of held places, as a simulation has them.

    They are zero where nothing is held.

    Returns:
        Shapes (F, 3 n), (F, 6) and (F, 3 n + 6); a turning counts at half the length [m/s].
    """
    names = imposed_names([recording.manipulation])
    view = scene(settings, names, [shapes])
    n = shapes.shape[1]
    pins = {f"{CONTROL_POINT}{k + 1}" for k in range(2, n - 2)}.intersection(names)
    held = [0] * (START in view.held) + [n - 1] * (END in view.held)
    held += [int(name.removeprefix(CONTROL_POINT)) - 1 for name in pins]
    positions = np.zeros_like(shapes)
    positions[:, held] = shapes[:, held]
    directions = np.zeros((len(shapes), 2, 3))
    for k, (end, tip, inner) in enumerate(((START, 0, 1), (END, n - 1, n - 2))):
        if end in view.clamps:
            along = shapes[:, inner] - shapes[:, tip]
            directions[:, k] = along / np.linalg.norm(along, axis=1, keepdims=True)
    places, turns = positions.reshape(len(shapes), -1), directions.reshape(len(shapes), -1)
    moves = np.concatenate([places, 0.5 * settings.rod.length * turns], axis=1)
    return places, turns, _velocity(moves, times)


def _velocity(values: FloatArray, times: FloatArray) -> FloatArray:
    """Derivative over time, shape (F, m)."""
    return np.gradient(values, times, axis=0) if len(times) > 1 else np.zeros_like(values)


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
    return [
        _velocity(p.reshape(len(p), -1) / np.sqrt(p.shape[1]), t)
        for p, t in zip(shapes, times, strict=True)
    ]
