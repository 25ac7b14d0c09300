# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The true motion of an experiment's rope, by the discrete elastic rod."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from dlo_ros.command import CONTROL_POINT, END, NANOSECONDS, START
from dlo_ros.errors import InputError
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.synthesis.discrete_rod import DiscreteRod, centreline, lay_along
from dlo_ros.synthesis.experiment import START_STAMP, Experiment
from dlo_ros.synthesis.hidden_rod import build_rod, change
from dlo_ros.synthesis.rod_simulation import Boundary, Simulation

EDGES = 300
STEP = 5e-4  # [s]
# Together they leave 2 to 7 micrometres of mean error in the bundled experiments.


@dataclass(frozen=True)
class Truth:
    """The rope at the stamps of the images.

    Args:
        stamps: [ns], T of them.
        rod: the discrete rod, whose nodes these are, as it is at the start.
        u: material coordinates of the nodes in the configured length [m], shape (N + 1,).
        nodes: x and z [m], shape (T, N + 1, 2).
        velocities: of the nodes [m/s], shape (T, N + 1, 2).
    """

    stamps: tuple[int, ...]
    rod: DiscreteRod
    u: FloatArray
    nodes: FloatArray
    velocities: FloatArray

    def centreline(self, index: int, u: FloatArray, later: float = 0.0) -> FloatArray:
        """Points of the rope's axis in the board frame.

        Args:
            index: of the image.
            u: material coordinates [m], shape (m,).
            later: instant within the exposure, after the stamp [s].

        Returns:
            Points [m], shape (m, 3), y = 0.
        """
        return centreline(self.u, self.nodes[index] + later * self.velocities[index], u)

    def control_points(self, index: int, basis: SplineBasis) -> FloatArray:
        """Least-squares projection onto a published basis, both ends kept, shape (n, 3)."""
        return project(basis, lambda u: self.centreline(index, u))


def project(basis: SplineBasis, curve: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Least-squares spline of a curve given as a function of u, both ends kept, shape (n, 3)."""
    u, w = SplineBasis(basis.spans * 4 + 3, basis.length).quadrature()
    b, points = basis.matrix(u), curve(u)
    ends = curve(np.array([0.0, basis.length]))
    rest = points - b[:, [0]] * ends[0] - b[:, [-1]] * ends[1]
    inner = b[:, 1:-1]
    normal = cho_factor(inner.T @ (w[:, None] * inner))
    middle = cho_solve(normal, inner.T @ (w[:, None] * rest))
    return np.vstack([ends[:1], middle, ends[1:]])


class Grips:
    """What an experiment's command imposes on the nodes of a discrete rod."""

    def __init__(self, experiment: Experiment) -> None:
        self._command = experiment.command
        rod = experiment.truth.rod
        n = rod.control_points
        greville = SplineBasis(n, rod.length).greville
        self._place = {START: 0.0, END: rod.length}
        self._direction: dict[str, str | None] = {}
        for name in self._command.names:
            if name.startswith(CONTROL_POINT):
                self._place[name] = float(greville[int(name.removeprefix(CONTROL_POINT)) - 1])
        # A second control point gives the direction at its end; everything else is a pin.
        self._pairs = {
            end: second
            for end, second in (
                (f"{CONTROL_POINT}1", f"{CONTROL_POINT}2"),
                (f"{CONTROL_POINT}{n}", f"{CONTROL_POINT}{n - 1}"),
            )
            if second in self._command.names
        }
        self._pins = [m for m in self._command.names if m not in self._pairs.values()]
        self._nodes: dict[str, int] = {}
        hidden = experiment.hidden
        self._delay = hidden.number("command_delay", "delay")
        self._turned = {
            START: hidden.number("clamp_angle", "start"),
            END: hidden.number("clamp_angle", "end"),
        }
        self._offset = {
            name: hidden.vector("clamp_offset", end)
            for end, tip in ((START, f"{CONTROL_POINT}1"), (END, f"{CONTROL_POINT}{n}"))
            for name in (end, tip)
        }
        steps = np.linalg.norm(np.diff(self._command.positions, axis=0), axis=2).sum(axis=1)
        self._way = np.concatenate([[0.0], np.cumsum(steps)])

    def travelled(self, time: float) -> float:
        """Fraction of the imposed points' way that is behind them at a time [s]; 0 without any."""
        way = float(np.interp(time - self._delay, self._command.times, self._way))
        return way / float(self._way[-1]) if self._way[-1] > 0.0 else 0.0

    @property
    def places(self) -> FloatArray:
        """Material coordinates [m] where the rope is seen to be held."""
        return np.array([self._place[name] for name in self._command.names])

    @property
    def nodes_at(self) -> Sequence[float]:
        """Material coordinates [m] within the rope where a node is needed."""
        length = self._place[END]
        inner = [self._place[name] for name in self._pins]
        return [u for u in inner if 1e-9 * length < u < (1.0 - 1e-9) * length]

    def attach(self, rod: DiscreteRod) -> None:
        """Find the nodes of a rod whose mesh has `nodes_at`."""
        u = rod.u * (self._place[END] / rod.u[-1])
        self._nodes = {name: int(np.argmin(np.abs(u - self._place[name]))) for name in self._pins}

    def boundary(self, time: float) -> Boundary:
        """What is imposed at a time [s] since the start of the recording."""
        stamp = START_STAMP + round((time - self._delay) * NANOSECONDS)
        values, rotations = self._command.sample(stamp)
        at = dict(zip(self._command.names, values, strict=True))
        turned = dict(zip(self._command.names, rotations, strict=True))
        directions: dict[str, float] = {}
        for name in (START, END):
            if name in turned:
                directions[name] = 2.0 * float(np.arctan2(turned[name][1], turned[name][3]))
        for end, second in self._pairs.items():
            outward = end == f"{CONTROL_POINT}1"
            d = (at[second] - at[end]) * (1.0 if outward else -1.0)
            if not np.linalg.norm(d) > 0.0:
                raise InputError(f"motion: {end} and {second} coincide; they give a direction")
            directions[START if outward else END] = float(np.arctan2(-d[2], d[0]))
        directions = {end: angle + self._turned[end] for end, angle in directions.items()}
        return Boundary(
            positions={
                self._nodes[name]: at[name][[0, 2]] + self._offset.get(name, 0.0)
                for name in self._pins
            },
            start=directions.get(START),
            end=directions.get(END),
        )


def build_simulation(
    experiment: Experiment, *, edges: int = EDGES, step: float = STEP
) -> tuple[Simulation, Grips]:
    """The rope of an experiment, settled under the first imposed values.

    Args:
        edges: of the discrete rod.
        step: largest time step [s].

    Raises:
        SimulationError: it finds no stable equilibrium.
    """
    grips = Grips(experiment)
    settings, hidden = experiment.truth, experiment.hidden
    rod = build_rod(settings, hidden, edges=edges, pins=grips.nodes_at)
    grips.attach(rod)
    x = lay_along(experiment.initial_shape, rod)
    changes = change(settings, hidden, grips.travelled)
    simulation = Simulation(rod, grips.boundary, x, step=step, change=changes)
    simulation.settle()
    return simulation, grips


def simulate(simulation: Simulation, stamps: Iterable[int], length: float | None = None) -> Truth:
    """Run a settled simulation over growing stamps [ns].

    Args:
        simulation: settled.
        stamps: [ns].
        length: configured length [m], by which the material coordinate counts; None where that is
            the rod's.

    Raises:
        SimulationError: a step did not converge.
    """
    stamps = tuple(stamps)
    nodes, velocities = [], []
    for stamp in stamps:
        time = (stamp - START_STAMP) / NANOSECONDS
        if time > simulation.time:
            simulation.advance(time)
        nodes.append(simulation.x)
        velocities.append(simulation.v)
    rod = simulation.rod
    u = rod.u if length is None else rod.u * (length / rod.u[-1])
    return Truth(stamps, rod, u, np.array(nodes), np.array(velocities))
