# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What the examples share: one rod, what holds it, and how it is led to an equilibrium."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.parameters import DampingParameters, RodParameters, Settings
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.state import State, rest_state
from dlo_ros.rod.statics import Equilibrium, settle
from dlo_ros.spline import FloatArray

# Length, diameter, E and density of the paper's Table III.
ROPE = Settings(rod=RodParameters(0.4, 0.004, 5e7, 2500.0))
WEIGHTLESS = replace(ROPE, gravity=(0.0, 0.0, 0.0))
NO_DAMPING = DampingParameters(air_drag=0.0, relaxation_time=0.0)


def hold(
    names: Sequence[str],
    positions: object,
    rotations: FloatArray | None = None,
    velocities: FloatArray | None = None,
    times: FloatArray | None = None,
) -> Command:
    """A command for T instants and K names.

    Args:
        names: names of the K held positions and directions.
        positions: [m], shape (T, K, 3).
        rotations: quaternions x y z w, shape (T, K, 4); default: the clamps point along x.
        velocities: [m/s], shape (T, K, 3); default: none given.
        times: [s], shape (T,); default: one instant a second.
    """
    places = np.asarray(positions, dtype=np.float64)
    frames = np.tile([0.0, 0.0, 0.0, 1.0], (*places.shape[:2], 1))
    return Command(
        0,
        tuple(names),
        np.arange(float(len(places))) if times is None else times,
        places,
        frames if rotations is None else rotations,
        np.full(places.shape, np.nan) if velocities is None else velocities,
        ROPE.rod.control_points,
    )


def clamp() -> Command:
    """The start is held at the origin and points along x; the other end is free."""
    return hold(["start"], [[[0.0, 0.0, 0.0]]])


def turned(axis: Sequence[float], angles: FloatArray) -> FloatArray:
    """Quaternions (T, 4) of rotations about a unit axis by angles (T,) [rad]."""
    half = 0.5 * np.asarray(angles)[:, None]
    return np.hstack([np.sin(half) * np.asarray(axis), np.cos(half)])


def straight(model: RodModel, direction: Sequence[float] = (1.0, 0.0, 0.0)) -> State:
    """A straight rod at rest that starts at the origin."""
    q = np.zeros((model.basis.control_points, 4))
    q[:, :3] = model.basis.greville[:, None] * np.asarray(direction)
    return rest_state(0, q, model)


def lead(model: RodModel, boundary: Boundary, state: State, command: Command) -> list[Equilibrium]:
    """The equilibria at all instants of a command, each reached from the one before."""
    path = []
    for t in command.times:
        path.append(settle(model, boundary, state, command, round(t * NANOSECONDS)))
        state = path[-1].state
    return path


def onset(stable: Callable[[float], bool], low: float, high: float) -> float:
    """The load at which a rod loses its stability, by bisection to a millionth.

    Raises:
        ValueError: the rod is not stable at the low load, or not unstable at the high one.
    """
    if not stable(low) or stable(high):
        raise ValueError(f"stability is not lost between {low:g} and {high:g}")
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return 0.5 * (low + high)
