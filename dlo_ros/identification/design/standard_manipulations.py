# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Standard manipulations, among which the one is sought that best separates two explanations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, NANOSECONDS, START, Command, Motion
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.measured import Recording
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.spline import FloatArray, SplineBasis

RATE = 20.0  # frames a second
SHORTEST = 0.3  # [s] of a recording that is worth making faster or slower
FIRST = NANOSECONDS  # stamp of the first frame [ns]
PI = float(np.pi)


@dataclass(frozen=True)
class Standard:
    """A manipulation in words and as a command.

    Args:
        words: instruction to the person, an imperative without its full stop.
        command: the imposed motion.
        shape: rough first shape, control points [m], shape (n, 4).
        duration: [s].
    """

    words: str
    command: Command
    shape: FloatArray
    duration: float


Way = Sequence[tuple[float, float, float, float]]  # time [s], x and z over L, angle


def standard(settings: Settings, recordings: Sequence[Recording]) -> list[Standard]:
    """Standard manipulations, and those that were recorded, faster and slower."""
    s = np.linspace(0.0, 1.0, 30)
    hanging = np.column_stack([0.05 * s, -s])
    right = np.column_stack([np.sin(1.5 * s), np.cos(1.5 * s) - 1.0])
    bow = np.column_stack([0.5 * s, -1.5 * s * (1.0 - s)])
    swing: Way = [(0.0, 0.0, 0.0, 0.5 * PI), (0.4, 0.3, 0.0, 0.5 * PI), (2.5, 0.3, 0.0, 0.5 * PI)]
    nod: Way = [(0.0, 0.0, 0.0, 0.0), (0.8, 0.0, 0.0, -0.6), (1.8, 0.0, 0.0, 0.6),
                (2.6, 0.0, 0.0, 0.0)]  # fmt: skip
    other: Way = [(t, -x, z, PI - a) for t, x, z, a in nod]
    still: Way = [(0.0, 0.0, 0.0, 1.2)]
    closing: Way = [(0.0, 0.5, 0.0, -1.2), (1.2, 0.3, 0.0, -1.2), (2.4, 0.5, 0.1, -1.2)]
    mirrored = right * np.array([-1.0, 1.0])
    result = [
        _made(settings, "hang it from one clamp, carry it aside at once and let it swing",
              hanging, {START: swing}),
        _made(settings, "hold it level in one clamp, the other end free, and nod slowly up and "
              "down", right, {START: nod}),
        _made(settings, "hold it level in one clamp turned by 180 degrees, the other end free, and "
              "nod slowly up and down", mirrored, {START: other}),
        _made(settings, "hang it between two clamps as a U and move them together and apart", bow,
              {START: still, END: closing}),
    ]  # fmt: skip
    for recording in recordings:
        for words, factor in (("twice as fast", 0.5), ("at a third of the speed", 3.0)):
            result += _again(recording, words, factor)
    return result


def _made(settings: Settings, words: str, curve: FloatArray, ways: dict[str, Way]) -> Standard:
    n, length = settings.rod.control_points, settings.rod.length
    times = np.arange(0.0, 1.0 + max(w[-1][0] for w in ways.values()), 0.04)
    positions = np.zeros((len(times), len(ways), 3))
    rotations = np.zeros((len(times), len(ways), 4))
    for k, way in enumerate(ways.values()):
        rows = np.array(way)
        share = [np.interp(times, rows[:, 0], rows[:, c]) for c in (1, 2, 3)]
        positions[:, k, 0], positions[:, k, 2] = length * share[0], length * share[1]
        rotations[:, k] = Rotation.from_euler("y", share[2][:, None]).as_quat()
    velocities = np.full(positions.shape, np.nan)
    command = Command(FIRST, tuple(ways), times, positions, rotations, velocities, n)
    way = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    u = np.concatenate([[0.0], np.cumsum(way)])
    u *= length / u[-1]
    points = np.column_stack([curve[:, 0], np.zeros(len(curve)), curve[:, 1]])
    points *= length / float(np.sum(way))
    shape = np.zeros((n, 4))
    shape[:, :3] = SplineBasis(n, length).fit(u, points)
    return Standard(words, command, shape, float(times[-1]))


def _again(recording: Recording, words: str, factor: float) -> list[Standard]:
    """A recording's motion at another speed, where one command imposes it."""
    commands, observations = recording.manipulation.commands, recording.manipulation.observations
    if len(commands) != 1 or recording.times[-1] < SHORTEST:
        return []
    (command,) = commands
    begin = (observations[0].stamp - command.stamp) / NANOSECONDS
    later = FIRST - round(begin * factor * NANOSECONDS)
    velocities = command.velocities / factor
    slower = replace(command, stamp=later, times=command.times * factor, velocities=velocities)
    text = f"repeat {recording.name} {words}"
    duration = min(float(recording.times[-1]) * factor, 6.0)
    return [Standard(text, slower, observations[0].control_points, duration)]


def simulated(made: Standard, settings: Settings) -> Manipulation:
    """A model's prediction in the form of a recording.

    Raises:
        SimulationError: the model cannot be simulated.
    """
    stamps = FIRST + (np.arange(0.0, made.duration, 1.0 / RATE) * NANOSECONDS).astype(np.int64)
    motion = Motion([made.command])
    simulation = simulation_of(settings, motion)
    # The first shape is a guess only, so the DLO starts at rest.
    simulation.start([Observation(int(stamps[0]), made.shape)], int(stamps[-1]))
    predictions = [simulation.prediction()]
    predictions += simulation.advance_through([int(s) for s in stamps[1:]])
    seen = tuple(
        Observation(int(s), p.control_points) for s, p in zip(stamps, predictions, strict=True)
    )
    return Manipulation(made.words, (made.command,), seen)
