"""What is right: the planar elastica as a boundary value problem, and a converged motion.

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
from dlo_ros.synthesis.rod_simulation import Boundary, Simulation

TOLERANCE = 1e-8
RIGID = 1e6  # E A of a rod that does not stretch, over its own


@cache
def reference(task: Task, *, stretch: bool = True, drag: bool = False) -> FloatArray:
    """Right shapes of a task, x and z at its quadrature points, shape (instants, points, 2) [m].

    Args:
        task: what is asked.
        stretch: whether the rod can stretch.
        drag: whether a motion is damped by drag, in place of Kelvin-Voigt damping.
    """
    if task.moving:
        return motion(task, drag=drag)
    u, _ = task.quadrature
    return elastica(task, stretch=stretch).sol(u)[None, 2:4].transpose(0, 2, 1)


def elastica(task: Task, *, stretch: bool) -> Any:
    """Solution of the boundary value problem: angle, moment, x and z over u.

    Raises:
        RuntimeError: it was not solved.
    """
    rod = task.rod
    length, bend = rod.length, rod.bending_stiffness
    axial = rod.young_modulus * rod.area * (1.0 if stretch else RIGID)
    weight = rod.linear_density * GRAVITY

    def slopes(u: FloatArray, y: FloatArray, end: FloatArray, load: float) -> FloatArray:
        # Force that the part beyond u exerts: what holds the end, less the weight in between.
        fx, fz = end[0], end[1] - load * (length - u)
        along = fx * np.cos(y[0]) + fz * np.sin(y[0])
        across = fz * np.cos(y[0]) - fx * np.sin(y[0])
        ratio = (axial + along) / (axial - y[1] ** 2 / bend)
        return np.vstack(
            [y[1] / bend * ratio**2, -across * ratio, np.cos(y[0]) * ratio, np.sin(y[0]) * ratio]
        )

    u = np.linspace(0.0, length, 201)
    # From a load that hardly bends the rod to its weight.
    light = min(weight, bend / length**3)
    loads = np.geomspace(light, weight, 1 + int(np.ceil(2.5 * np.log(weight / light))))
    found: Any = None
    if not task.both_ends:
        y = np.vstack([0.0 * u, 0.0 * u, u, 0.0 * u])
        none = np.zeros(2)
        for load in loads:
            found = solve_bvp(
                lambda u, y, load=load: slopes(u, y, none, load),
                lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
                u, y, tol=TOLERANCE, max_nodes=100_000,
            )  # fmt: skip
            _check(found, task)
            u, y = found.x, found.y
        return found
    # A sine of the angle spans half the length at an amplitude of 1.52 rad (Bessel's J0 is 1/2).
    wave = 2.0 * np.pi / length
    angle = -1.52 * np.sin(wave * u)
    step = np.gradient(u)
    y = np.vstack([
        angle, -1.52 * bend * wave * np.cos(wave * u),
        np.cumsum(np.cos(angle) * step), np.cumsum(np.sin(angle) * step),
    ])  # fmt: skip
    end = np.array([-bend * wave**2, 0.5 * light * length])
    for load in loads:
        found = solve_bvp(
            lambda u, y, p, load=load: slopes(u, y, p, load),
            lambda a, b, p: np.array([a[0], a[2], a[3], b[0], b[2] - task.span, b[3]]),
            u, y, p=end, tol=TOLERANCE, max_nodes=100_000,
        )  # fmt: skip
        _check(found, task)
        u, y, end = found.x, found.y, found.p
    found_sol = found.sol
    found.sol = lambda u: found_sol(u) + np.array([[0.0], [0.0], [task.approach], [0.0]])
    return found


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
    held = Boundary({0: np.zeros(2)}, start=0.0)
    simulation = Simulation(rod, lambda _: held, x, step=step)
    u, _ = task.quadrature
    return np.array([centreline(rod, simulation.advance(t), u)[:, [0, 2]] for t in task.instants])
