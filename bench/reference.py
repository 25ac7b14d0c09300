# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Reference shapes: the planar elastica as a boundary value problem, and a converged motion.

The elastica is solved with the stretch that the rod has, and without for peers whose links are
rigid. Its energy per reference length is B/2 (angle' / stretch)^2 + E A / 2 (stretch - 1)^2.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from bench.tasks import GRAVITY, Task
from dlo_ros.parameters import DampingParameters
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.discrete_rod import DiscreteRod, centreline
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes

TOLERANCE = 1e-8


@cache
def reference(task: Task, *, stretch: bool = True, drag: bool = False) -> FloatArray:
    """Right shapes of a task, x and z at its quadrature points, shape (instants, points, 2) [m].

    Args:
        task: the simulation that every simulator is asked for.
        stretch: whether the rod can stretch.
        drag: whether a motion is damped by drag, in place of Kelvin-Voigt damping.
    """
    if task.moving:
        return motion(task, drag=drag)
    u, _ = task.quadrature
    x, z = task.rod.length * elastica(task, stretch=stretch)(u / task.rod.length)[2:4]
    return np.stack([x + task.approach, z], axis=1)[None]


def elastica(task: Task, *, stretch: bool) -> Any:
    """Solution of the boundary value problem: angle, moment, x and z over u, without dimension.

    Raises:
        RuntimeError: it was not solved.
    """
    rod = task.rod
    length = rod.length
    # Without dimension: lengths over L, moments over B / L, forces over B / L^2.
    softness = rod.second_moment / (rod.area * length**2) if stretch else 0.0
    weight = rod.linear_density * GRAVITY * length**3 / rod.bending_stiffness

    def slopes(u: FloatArray, y: FloatArray, end: FloatArray, load: float) -> FloatArray:
        # Force that the part beyond u exerts: what holds the end, less the weight in between.
        fx, fz = end[0], end[1] - load * (1.0 - u)
        along = fx * np.cos(y[0]) + fz * np.sin(y[0])
        across = fz * np.cos(y[0]) - fx * np.sin(y[0])
        ratio = (1.0 + softness * along) / (1.0 - softness * y[1] ** 2)
        return np.vstack(
            [y[1] * ratio**2, -across * ratio, np.cos(y[0]) * ratio, np.sin(y[0]) * ratio]
        )

    u = np.linspace(0.0, 1.0, 201)
    # From a load that hardly bends the rod to its weight.
    light = min(weight, 1.0)
    loads = np.geomspace(light, weight, 1 + int(np.ceil(5.0 * np.log(weight / light))))
    if task.both_ends:
        # A sine of the angle spans half the length at an amplitude of 1.52 rad (J0 is 1/2).
        wave = 2.0 * np.pi
        angle = -1.52 * np.sin(wave * u)
        y = np.vstack([
            angle, -1.52 * wave * np.cos(wave * u),
            np.cumsum(np.cos(angle)) / len(u), np.cumsum(np.sin(angle)) / len(u),
        ])  # fmt: skip
        end = np.array([-(wave**2), 0.5 * light])
    else:
        y = np.vstack([0.0 * u, 0.0 * u, u, 0.0 * u])
        end = None
    found: Any = None
    for load in loads:
        if task.both_ends:
            found = solve_bvp(
                lambda u, y, p, load=load: slopes(u, y, p, load),
                lambda a, b, p: np.array(
                    [a[0], a[2], a[3], b[0], b[2] - task.span / length, b[3]]
                ),
                u, y, p=end, tol=TOLERANCE, max_nodes=20_000,
            )  # fmt: skip
            end = found.p
        else:
            found = solve_bvp(
                lambda u, y, load=load: slopes(u, y, np.zeros(2), load),
                lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
                u, y, tol=TOLERANCE, max_nodes=20_000,
            )  # fmt: skip
        _check(found, task)
        y = found.sol(u)
    return found.sol


def _check(found: Any, task: Task) -> None:
    if not found.success:
        raise RuntimeError(f"the elastica of {task.name} was not solved: {found.message}")


def motion(task: Task, *, drag: bool, edges: int = 256, step: float = 2.5e-4) -> FloatArray:
    """The released rod by discrete edges and BDF2, extrapolated in edges and step.

    Both errors are of second order, so a run with half the edges and twice the step gives the
    limit to some 1e-4 of L (3e-4 with drag).
    """
    coarse, fine = (_motion(task, drag, n, h) for n, h in ((edges // 2, 2.0 * step), (edges, step)))
    return fine + (fine - coarse) / 3.0


def _motion(task: Task, drag: bool, edges: int, step: float) -> FloatArray:
    damping = DampingParameters(
        air_drag=task.air_drag or 0.0 if drag else 0.0,
        relaxation_time=0.0 if drag else task.relaxation_time or 0.0,
    )
    rod = DiscreteRod.uniform(task.rod, damping, gravity=(0.0, -GRAVITY), edges=edges)
    x = np.column_stack([rod.u, np.zeros_like(rod.u)])
    held = ImposedNodes({0: np.zeros(2)}, start=0.0)
    simulation = DiscreteRodSimulation(rod, lambda _: held, x, step=step)
    u, _ = task.quadrature
    return np.array([centreline(rod, simulation.advance(t), u)[:, [0, 2]] for t in task.instants])
