# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""PyElastica: its Cosserat rod with the position Verlet scheme and its own linear damping.

It clamps whole elements, so the rod is made longer by half an element at each clamp, which lies
in the middle of the clamped element: without that its error is of first order.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import elastica
import numpy as np
from scipy.interpolate import CubicSpline

from bench.contender import Contender, Failure, Prepared, Setting
from bench.tasks import GRAVITY, Task
from dlo_ros.spline import FloatArray


class _Simulator(
    elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping
):
    """Rods with clamps, gravity and damping."""


class MovingClamp(elastica.ConstraintBase):
    """One end's element, horizontal, led along x.

    Args:
        at: 0 or -1, which end.
        travel: distance by which it moves within the first second [m].
    """

    def __init__(self, *args: Any, at: int, travel: float, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.at, self.travel = at, travel
        self.nodes = slice(0, 2) if at == 0 else slice(-2, None)
        self.place = self._system.position_collection[:, self.nodes].copy()
        self.director = self._system.director_collection[..., at].copy()
        self.forward = np.array([[1.0], [0.0], [0.0]])

    def constrain_values(self, system: Any, time: float) -> None:
        """Place and direction."""
        moved = self.place + self.forward * (self.travel * min(time, 1.0))
        system.position_collection[:, self.nodes] = moved
        system.director_collection[..., self.at] = self.director

    def constrain_rates(self, system: Any, time: float) -> None:
        """Velocity of the clamp, no rotation."""
        speed = self.travel if time < 1.0 else 0.0
        system.velocity_collection[:, self.nodes] = self.forward * speed
        system.omega_collection[:, self.at] = 0.0


class PyElastica(Contender):
    """The Cosserat rod with `elements` elements and the largest steps that are stable."""

    size = "elements"
    drag = True

    def __init__(self) -> None:
        self.name = "PyElastica"

    def settings(self, task: Task) -> Iterable[list[Setting]]:
        """See the base class."""
        rod = task.rod
        elements = (8, 10, 12, 15, 20, 25, 32, 40, 52, 64)
        if task.moving:
            assert task.air_drag is not None
            rates = [task.air_drag / rod.linear_density]
        else:
            # Somewhat more than critical damping of the slowest motion.
            rates = [f * np.sqrt(GRAVITY / rod.length) for f in (2.5,)]
        for rate, share in itertools.product(rates, (0.95,)):
            yield [{"elements": n, "rate": float(rate), "share": share} for n in elements]

    def prepare(self, task: Task, setting: Setting) -> Prepared:
        """See the base class."""
        # A share of the largest stable step: the fastest waves are shear with the rotation of the
        # sections, stretch and bending.
        material, n = task.rod, setting["elements"]
        speed = np.sqrt(material.young_modulus / material.density)
        shear = np.sqrt(4.0 / 3.0 * material.shear_modulus / material.density)
        fastest = np.hypot(4.0 * shear / material.diameter, 2.8 * speed * n / material.length)
        steps = int(np.ceil(task.instants[-1] * fastest / (2.0 * setting["share"])))
        step = task.instants[-1] / steps
        count = [round(t / step) for t in task.instants]

        def run() -> list[FloatArray]:
            simulator, rod = _build(task, n, step, setting["rate"])
            stepper = elastica.PositionVerlet()
            time, done, shapes = np.float64(0.0), 0, []
            for mark in count:
                for k in range(done, mark):
                    time = stepper.step(simulator, time, step)
                    if k % 100 == 0 and not abs(rod.position_collection[2]).max() < 2.0:
                        raise Failure("PyElastica blew up")
                done = mark
                shapes.append(rod.position_collection.copy())
            return shapes

        def curves(shapes: list[FloatArray]) -> FloatArray:
            u, _ = task.quadrature
            nodes = _nodes(task, n)
            x = np.array(shapes)[:, [0, 2]]  # (S, 2, N + 1)
            if not np.all(np.isfinite(x)):
                raise Failure("PyElastica blew up")
            return np.moveaxis(CubicSpline(nodes, x, axis=2)(u), 1, 2)

        return Prepared(run, curves)


def _nodes(task: Task, elements: int) -> FloatArray:
    """Material coordinates of the nodes [m]; those of clamped elements lie around the clamps."""
    h = task.rod.length / (elements - (1.0 if task.both_ends else 0.5))
    nodes: FloatArray = h * (np.arange(elements + 1) - 0.5)
    return nodes


def _build(task: Task, elements: int, step: float, rate: float) -> tuple[Any, Any]:
    rod = task.rod
    nodes = _nodes(task, elements)
    simulator = _Simulator()
    body = elastica.CosseratRod.straight_rod(
        elements, np.array([nodes[0], 0.0, 0.0]), np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 1.0, 0.0]), nodes[-1] - nodes[0], 0.5 * rod.diameter, rod.density,
        youngs_modulus=rod.young_modulus, shear_modulus=rod.shear_modulus,
    )  # fmt: skip
    simulator.append(body)
    ends = [(0, task.approach)]
    if task.both_ends:
        ends.append((-1, -task.approach))
    for at, travel in ends:
        simulator.constrain(body).using(
            MovingClamp, constrained_position_idx=(at,), constrained_director_idx=(at,), at=at,
            travel=travel,
        )  # fmt: skip
    simulator.add_forcing_to(body).using(
        elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -GRAVITY])
    )
    simulator.dampen(body).using(
        elastica.AnalyticalLinearDamper, uniform_damping_constant=rate, time_step=step
    )
    simulator.finalize()
    return simulator, body
