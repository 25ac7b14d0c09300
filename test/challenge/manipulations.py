# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Manipulations of about three seconds, drawn at random: initial shapes and imposed motion.

Lengths are in units of the rope's; angles are those of growing u, positive from x towards -z.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

DURATION = 3.0
SPACING = 0.04  # [s] of the command's points
PI = np.pi
CONTROL_POINTS = 10

Way = list[tuple[float, float, float, float]]  # time [s], x, z, angle


@dataclass(frozen=True)
class Manipulation:
    """One recording's motion.

    Args:
        name: kind of the manipulation.
        initial_shape: rough curve, x and z over L, shape (m, 2).
        ways: motion of each imposed name.
    """

    name: str
    initial_shape: np.ndarray
    ways: dict[str, Way]

    @property
    def clamps_end(self) -> bool:
        return "end" in self.ways

    @property
    def clamps_start(self) -> bool:
        return "start" in self.ways

    def mirrored(self) -> "Manipulation":
        ways = {k: [(t, -x, z, PI - a) for t, x, z, a in way] for k, way in self.ways.items()}
        return Manipulation(self.name, self.initial_shape * [-1.0, 1.0], ways)

    def tree(self, length: float) -> dict:
        """The blocks `initial_shape` and `motion` of an experiment file."""
        motion = {}
        for name, way in self.ways.items():
            rows = []
            for t, x, z, a in smooth_rows(way):
                row = {"time": t, "position": [x * length, 0.0, z * length]}
                rows.append(row | {"angle": a} if name in ("start", "end") else row)
            motion[name] = rows
        return {"initial_shape": (length * self.initial_shape).tolist(), "motion": motion}


def smooth_rows(way: Sequence[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Points of a motion that starts and stops gently at every waypoint (minimum jerk).

    Args:
        way: waypoints: time [s] and any further numbers.
    """
    rows = np.array(way, dtype=float)
    result = [rows[0]]
    for a, b in pairwise(rows):
        count = max(int(np.ceil((b[0] - a[0]) / SPACING)), 1)
        if np.allclose(a[1:], b[1:]):
            count = 1
        for t in np.arange(1, count + 1) / count:
            share = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
            result.append(np.array([a[0] + t * (b[0] - a[0]), *(a[1:] + share * (b[1:] - a[1:]))]))
    return [tuple(round(float(v), 6) for v in row) for row in result]


def _along(angle: float, bend: float = 0.25) -> np.ndarray:
    """A rope that leaves the origin at an angle and sags."""
    s = np.linspace(0.0, 1.0, 9)
    a = angle + bend * s * (PI / 2 - angle)
    steps = np.column_stack([np.cos(a), -np.sin(a)])
    return np.cumsum(steps * np.diff(s, prepend=0.0)[:, None], axis=0)


def swing(rng: np.random.Generator) -> Manipulation:
    """A clamped start turns fast, the rope swings freely."""
    a, turn = rng.uniform(-0.4, 0.2), rng.uniform(0.5, 1.1)
    fast, wait = rng.uniform(0.3, 0.6), rng.uniform(0.6, 1.0)
    way = [(0.0, 0.0, 0.0, a), (fast, 0.05, 0.0, a + turn)]
    way += [(fast + wait, 0.05, 0.0, a + turn), (2 * fast + wait, 0.0, 0.1, a + 0.2 * turn)]
    return Manipulation("swing", _along(a), {"start": way})


def carry(rng: np.random.Generator) -> Manipulation:
    """A rope that hangs from a clamp is carried to and fro."""
    a, far, fast = rng.uniform(0.9, 1.5), rng.uniform(0.25, 0.45), rng.uniform(0.5, 0.9)
    way = [(0.0, 0.0, 0.0, a), (fast, far, 0.0, a), (fast + 0.5, far, 0.0, a)]
    way.append((2 * fast + 0.5, 0.0, 0.05, a))
    return Manipulation("carry", _along(a), {"start": way})


def pendulum(rng: np.random.Generator) -> Manipulation:
    """A rope that hangs from a point, free to turn there, is carried away and stopped."""
    far, fast = rng.uniform(0.3, 0.5), rng.uniform(0.4, 0.8)
    way = [(0.0, 0.0, 0.0, 0.0), (fast, far, 0.0, 0.0), (1.6, far, 0.0, 0.0)]
    way.append((1.6 + fast, 0.6 * far, 0.1, 0.0))
    return Manipulation("pendulum", _along(1.3), {"control_point_1": way})


def wave(rng: np.random.Generator) -> Manipulation:
    """A clamped start turns up and down slowly: the bend comes and goes."""
    a, turn = rng.uniform(-0.2, 0.3), rng.uniform(0.6, 1.0)
    way = [(0.0, 0.0, 0.0, a), (0.9, 0.0, 0.05, a - turn), (1.9, 0.0, -0.05, a + 0.8 * turn)]
    way.append((2.7, 0.0, 0.0, a))
    return Manipulation("wave", _along(a), {"start": way})


def u_shape(rng: np.random.Generator) -> Manipulation:
    """A U between two clamps that come closer and part."""
    wide, near, up = rng.uniform(0.5, 0.6), rng.uniform(0.25, 0.35), rng.uniform(-0.1, 0.1)
    a = rng.uniform(1.1, 1.6)
    end = [(0.0, wide, 0.0, -a), (1.2, near, up, -a), (1.5, near, up, -a), (2.6, wide, up, -a)]
    shape = np.array([[0, 0], [0.04, -0.2], [0.5 * wide, -0.34], [wide - 0.04, -0.2], [wide, 0]])
    return Manipulation("u_shape", shape, {"start": [(0.0, 0.0, 0.0, a)], "end": end})


def approach(rng: np.random.Generator) -> Manipulation:
    """Both ends, free to turn, approach each other."""
    wide, near = rng.uniform(0.75, 0.85), rng.uniform(0.3, 0.45)
    last = [(0.0, wide, 0.0, 0.0), (1.3, near, 0.1, 0.0), (1.7, near, 0.1, 0.0)]
    last.append((2.7, 0.5 * (near + wide), 0.0, 0.0))
    shape = np.array([[0, 0], [0.5 * wide, -0.26], [wide, 0]])
    first = [(0.0, 0.0, 0.0, 0.0)]
    ways = {"control_point_1": first, f"control_point_{CONTROL_POINTS}": last}
    return Manipulation("approach", shape, ways)


def c_shape(rng: np.random.Generator) -> Manipulation:
    """One end goes above the other: a C that only the stiffness holds up."""
    x, z, t = rng.uniform(0.55, 0.7), rng.uniform(0.3, 0.42), rng.uniform(1.2, 1.6)
    last = [(0.0, -0.7, 0.0, 0.0), (t, x - 0.7, z, 0.0)]
    last += [(t + 0.4, x - 0.7, z, 0.0), (2.9, x - 0.8, 0.7 * z, 0.0)]
    shape = np.array([[0, 0], [-0.25, -0.05], [-0.42, -0.3], [-0.65, -0.05], [-0.7, 0]])
    ways = {"start": [(0.0, 0.0, 0.0, PI)], f"control_point_{CONTROL_POINTS}": last}
    return Manipulation("c_shape", shape, ways)


def push(rng: np.random.Generator) -> Manipulation:
    """The end is pushed towards a clamped start and drawn back."""
    a, wide, near = rng.uniform(0.2, 0.6), rng.uniform(0.8, 0.88), rng.uniform(0.5, 0.6)
    last = [(0.0, wide, -0.1, 0.0), (1.2, near, -0.05, 0.0), (1.5, near, -0.05, 0.0)]
    last.append((2.6, 0.5 * (wide + near), -0.2, 0.0))
    shape = np.array([[0, 0], [0.2, -0.12], [0.5, -0.3], [wide, -0.1]])
    ways = {"start": [(0.0, 0.0, 0.0, a)], f"control_point_{CONTROL_POINTS}": last}
    return Manipulation("push", shape, ways)


def turn(rng: np.random.Generator) -> Manipulation:
    """Both ends clamped, one of them turns to and fro."""
    wide, a, b = rng.uniform(0.6, 0.75), rng.uniform(0.3, 0.8), rng.uniform(0.6, 1.0)
    end = [(0.0, wide, 0.0, -a), (0.9, wide, 0.0, b - a), (1.9, wide, 0.05, -b - a)]
    end.append((2.7, wide, 0.0, -a))
    shape = np.array([[0, 0], [0.1, -0.12], [0.5 * wide, -0.28], [wide - 0.1, -0.12], [wide, 0]])
    return Manipulation("turn", shape, {"start": [(0.0, 0.0, 0.0, a)], "end": end})


FREE: tuple[Callable[[np.random.Generator], Manipulation], ...] = (swing, carry, wave, pendulum)
HELD: tuple[Callable[[np.random.Generator], Manipulation], ...] = (
    u_shape,
    approach,
    c_shape,
    push,
    turn,
)


def choose(rng: np.random.Generator, count: int) -> list[Manipulation]:
    """Different manipulations, at least one with a clamp and a free end and one with both held."""
    kinds = [FREE[rng.integers(len(FREE) - 1)], HELD[rng.integers(len(HELD))]]
    others = [k for k in (*FREE, *HELD) if k not in kinds]
    kinds += [others[i] for i in rng.permutation(len(others))[: count - 2]]
    result = [kinds[i](rng) for i in rng.permutation(len(kinds))]
    return [m.mirrored() if rng.random() < 0.5 else m for m in result]
