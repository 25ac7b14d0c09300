# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The planar elastica as a boundary value problem: an answer that owes nothing to the spline rod.

A rod clamped at u = 0 carries a dead force per length and a dead force at its free end. With the
energy per reference length that physics.md gives,

    B/2 (angle' / stretch)^2 + E A / 2 (stretch - 1)^2,

the angle, the moment and the position follow from four ordinary differential equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from dlo_ros.parameters import RodParameters
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class Elastica:
    """Angle [rad], moment [N m], x and z [m] as functions of u [m]: `solution(u)` is (4, m)."""

    solution: Callable[[FloatArray], FloatArray]
    length: float

    def points(self, u: FloatArray) -> FloatArray:
        """The centreline in space, shape (m, 3) [m]."""
        _, _, x, z = self.solution(u)
        return np.column_stack([x, np.zeros_like(x), z])

    def distance(self, model: RodModel, state: State) -> float:
        """Mean distance of a simulated rod to this one at equal u, over L."""
        u, weight = model.basis.quadrature(6)
        apart = model.basis.evaluate(state.q[:, :3], u) - self.points(u)
        return float(weight @ np.linalg.norm(apart, axis=1)) / self.length**2


def cantilever(
    rod: RodParameters,
    weight: float = 0.0,
    tip_force: float = 0.0,
    angle: float = 0.0,
    guess: Elastica | None = None,
) -> Elastica:
    """A rod clamped at the origin, in the plane of x and z.

    Args:
        rod: material and geometry.
        weight: load per length, downwards [N/m].
        tip_force: load at the free end, downwards [N].
        angle: angle of the clamp against x, upwards [rad].
        guess: a solution close by; default: the load grows from a weak one, then the clamp turns.

    Raises:
        RuntimeError: the boundary value problem was not solved.
    """
    bend, stretch, length = rod.bending_stiffness, rod.young_modulus * rod.area, rod.length

    def slopes(u: FloatArray, y: FloatArray, share: float) -> FloatArray:
        load = -share * (weight * (length - u) + tip_force)  # what the rod beyond u hangs on it
        along, across = load * np.sin(y[0]), load * np.cos(y[0])
        ratio = (stretch + along) / (stretch - y[1] ** 2 / bend)
        return np.vstack(
            [y[1] / bend * ratio**2, -across * ratio, np.cos(y[0]) * ratio, np.sin(y[0]) * ratio]
        )

    def solve(u: FloatArray, y: FloatArray, share: float, angle: float, tol: float) -> Any:
        found = solve_bvp(
            lambda u, y: slopes(u, y, share),
            lambda a, b: np.array([a[0] - angle, b[1], a[2], a[3]]),
            u, y, tol=tol, max_nodes=100_000,
        )  # fmt: skip
        if not found.success:
            raise RuntimeError(f"the elastica was not solved: {found.message}")
        return found

    u = np.linspace(0.0, length, 200)
    if guess is not None:
        found = solve(u, guess.solution(u * guess.length / length), 1.0, angle, 1e-9)
        return Elastica(found.sol, length)
    strongest = (weight * length + tip_force) * length**2 / bend
    first = min(1.0, 1.0 / max(strongest, 1e-12))
    loads = np.geomspace(first, 1.0, 1 + int(np.ceil(2.0 * np.log(1.0 / first))))
    turns = np.linspace(0.0, angle, 1 + int(np.ceil(abs(angle) / 0.2)))
    y = np.vstack([0.0 * u, 0.0 * u, u, 0.0 * u])
    for share, turn in [(share, 0.0) for share in loads] + [(1.0, turn) for turn in turns[1:]]:
        found = solve(u, y, share, turn, 1e-4)
        u, y = found.x, found.y
    return Elastica(solve(u, y, 1.0, angle, 1e-9).sol, length)
