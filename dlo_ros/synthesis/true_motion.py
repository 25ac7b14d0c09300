# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The true motion of an experiment's rope, by the discrete elastic rod."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from dlo_ros.command import CONTROL_POINT, END, NANOSECONDS, START
from dlo_ros.errors import InputError
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.synthesis.discrete_rod import DiscreteRod, centreline, lay_along
from dlo_ros.synthesis.experiment import START_STAMP, Experiment
from dlo_ros.synthesis.hidden_rod import build_rod, build_spatial_rod, change
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes
from dlo_ros.synthesis.spatial_boundary import SpatialBoundary
from dlo_ros.synthesis.spatial_simulation import SpatialSimulation

EDGES = 300
STEP = 5e-4  # [s]
# Together they leave 2 to 7 micrometres of mean error in the bundled experiments.
SPATIAL_EDGES = 150
SPATIAL_STEP = 1e-3  # [s]


@dataclass(frozen=True)
class Truth:
    """The rope at the stamps of the images.

    Args:
        stamps: [ns], T of them.
        rod: the discrete rod, whose nodes these are, as it is at the start.
        u: material coordinates of the nodes in the configured length [m], shape (N + 1,).
        nodes: x and z [m], shape (T, N + 1, 2); in space x, y and z, shape (T, N + 1, 3).
        velocities: velocities of the nodes [m/s], likewise.
        twist: angle against the twist-free frame at the nodes [rad], shape (T, N + 1); None in the
            plane.
    """

    stamps: tuple[int, ...]
    rod: DiscreteRod
    u: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    twist: FloatArray | None = None

    def centreline(self, index: int, u: FloatArray, later: float = 0.0) -> FloatArray:
        """Points of the rope's axis in the board frame.

        Args:
            index: index of the image.
            u: material coordinates [m], shape (m,).
            later: instant within the exposure, after the stamp [s].

        Returns:
            Points [m], shape (m, 3), y = 0 in the plane.
        """
        return centreline(self.u, self.nodes[index] + later * self.velocities[index], u)

    def twist_angle(self, index: int, u: FloatArray) -> FloatArray:
        """Twist angle of image `index` [rad] at material coordinates [m], shape (m,)."""
        if self.twist is None:
            return np.zeros(len(u))
        return np.asarray(CubicSpline(self.u, self.twist[index])(u))

    def control_points(self, index: int, basis: SplineBasis) -> FloatArray:
        """Least-squares projection onto a published basis, both ends kept.

        Returns:
            x, y, z [m], shape (n, 3), and in space the twist angle [rad] beside them, (n, 4).
        """
        if self.twist is None:
            return project(basis, lambda u: self.centreline(index, u))
        return project(
            basis,
            lambda u: np.column_stack([self.centreline(index, u), self.twist_angle(index, u)]),
        )


def project(basis: SplineBasis, curve: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Least-squares spline of a curve given as a function of u, both ends kept, shape (n, k)."""
    u, w = SplineBasis(basis.spans * 4 + 3, basis.length).quadrature()
    b, points = basis.matrix(u), curve(u)
    ends = curve(np.array([0.0, basis.length]))
    rest = points - b[:, [0]] * ends[0] - b[:, [-1]] * ends[1]
    inner = b[:, 1:-1]
    normal = cho_factor(inner.T @ (w[:, None] * inner))
    middle = cho_solve(normal, inner.T @ (w[:, None] * rest))
    return np.vstack([ends[:1], middle, ends[1:]])


class Grips:
    """The motion that an experiment's command imposes on the nodes of a discrete rod."""

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
        self._frames = {m: k for k, m in enumerate(self._command.names) if m in (START, END)}
        self._pins = [m for m in self._command.names if m not in self._pairs.values()]
        self._nodes: dict[str, int] = {}
        hidden = self._hidden = experiment.hidden
        self._delay = hidden.number("command_delay", "delay")
        self._turned = {
            end: Rotation.from_rotvec(hidden.turn("clamp_angle", end)).as_matrix()
            for end in (START, END)
        }
        self._offset = {
            name: hidden.vector("clamp_offset", end)
            for end, tip in ((START, f"{CONTROL_POINT}1"), (END, f"{CONTROL_POINT}{n}"))
            for name in (end, tip)
        }
        self._tilted = {
            end: Rotation.from_rotvec(hidden.tilt("grip_angle", end)).as_matrix()
            for end in (START, END)
        }
        steps = np.linalg.norm(np.diff(self._command.positions, axis=0), axis=2).sum(axis=1)
        self._way = np.concatenate([[0.0], np.cumsum(steps)])

    def travelled(self, time: float) -> float:
        """Fraction of the imposed points' path until a time [s]; 0 without any path."""
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

    def _imposed(self, time: float) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Positions [m] by name, and rotation matrices of the clamps, at a time [s]."""
        stamp = START_STAMP + round((time - self._delay) * NANOSECONDS)
        values, rotations = self._command.sample(stamp)
        at = dict(zip(self._command.names, values, strict=True))
        turned: dict[str, FloatArray] = {}
        if not self._frames:
            return at, turned
        # Matrices, since SciPy's rotations take ten times as long for one at a time.
        hands = Rotation.from_quat(rotations[list(self._frames.values())]).as_matrix()
        for name, hand in zip(self._frames, hands, strict=True):
            at[name] = at[name] + self._hidden.in_hand("grip_offset", name, hand)
            turned[name] = self._turned[name] @ hand @ self._tilted[name]
        return at, turned

    def _directions(
        self, at: Mapping[str, FloatArray], turned: Mapping[str, FloatArray]
    ) -> dict[str, FloatArray]:
        """Unit vectors along growing u at the ends whose direction is imposed, shape (3,)."""
        result = {name: rotation[:, 0] for name, rotation in turned.items()}
        for end, second in self._pairs.items():
            outward = end == f"{CONTROL_POINT}1"
            d = (at[second] - at[end]) * (1.0 if outward else -1.0)
            size = np.linalg.norm(d)
            if not size > 0.0:
                raise InputError(f"motion: {end} and {second} coincide; they give a direction")
            name = START if outward else END
            result[name] = self._turned[name] @ (d / size)
        return result

    def _positions(self, at: Mapping[str, FloatArray]) -> dict[int, FloatArray]:
        """True positions [m] of the imposed nodes, shape (3,) each."""
        return {
            self._nodes[name]: at[name] + self._offset.get(name, np.zeros(3)) for name in self._pins
        }

    def boundary(self, time: float) -> ImposedNodes:
        """Imposed values in the plane at a time [s] since the start of the recording."""
        at, turned = self._imposed(time)
        angles = {
            n: float(np.arctan2(-d[2], d[0])) for n, d in self._directions(at, turned).items()
        }
        positions = {node: p[[0, 2]] for node, p in self._positions(at).items()}
        return ImposedNodes(positions, start=angles.get(START), end=angles.get(END))

    def spatial_boundary(self, time: float) -> SpatialBoundary:
        """Imposed values in space at a time [s] since the start of the recording."""
        at, turned = self._imposed(time)
        directions = self._directions(at, turned)
        return SpatialBoundary(
            self._positions(at),
            (directions.get(START), directions.get(END)),
            (turned.get(START), turned.get(END)),
        )


def build_simulation(
    experiment: Experiment,
    *,
    edges: int | None = None,
    step: float | None = None,
    space: bool | None = None,
) -> tuple[DiscreteRodSimulation | SpatialSimulation, Grips]:
    """The rope of an experiment, settled under the first imposed values.

    Args:
        edges: number of edges of the discrete rod; default `EDGES`, in space `SPATIAL_EDGES`.
        step: largest time step [s]; default `STEP`, in space `SPATIAL_STEP`.
        space: whether it moves in space; default: where the experiment leaves the plane.

    Raises:
        SimulationError: it finds no stable equilibrium.
    """
    grips = Grips(experiment)
    settings, hidden = experiment.truth, experiment.hidden
    if experiment.spatial if space is None else space:
        return _build_spatial(experiment, grips, edges or SPATIAL_EDGES, step or SPATIAL_STEP)
    rod = build_rod(settings, hidden, edges=edges or EDGES, pins=grips.nodes_at)
    grips.attach(rod)
    curve = experiment.initial_shape
    x = lay_along(curve if curve.shape[1] == 2 else curve[:, [0, 2]], rod)
    changes = change(settings, hidden, grips.travelled)
    simulation = DiscreteRodSimulation(rod, grips.boundary, x, step=step or STEP, change=changes)
    simulation.settle()
    return simulation, grips


def _build_spatial(
    experiment: Experiment, grips: Grips, edges: int, step: float
) -> tuple[SpatialSimulation, Grips]:
    settings, hidden = experiment.truth, experiment.hidden
    rod = build_spatial_rod(settings, hidden, edges=edges, pins=grips.nodes_at)
    grips.attach(rod)
    curve = experiment.initial_shape
    if curve.shape[1] == 2:
        curve = np.column_stack([curve[:, 0], np.zeros(len(curve)), curve[:, 1]])
    changes = change(settings, hidden, grips.travelled, axes=3)
    x = lay_along(curve, rod)
    simulation = SpatialSimulation(rod, grips.spatial_boundary, x, step=step, change=changes)
    simulation.settle()
    return simulation, grips


def simulate(
    simulation: DiscreteRodSimulation | SpatialSimulation,
    stamps: Iterable[int],
    length: float | None = None,
    reached: Callable[[int], None] = lambda stamp: None,
) -> Truth:
    """Run a settled simulation over growing stamps [ns].

    Args:
        simulation: settled.
        stamps: [ns].
        length: configured length [m], by which the material coordinate counts; None where that is
            the rod's.
        reached: function that is called with each stamp when the simulation has reached it.

    Raises:
        SimulationError: a step did not converge.
    """
    stamps = tuple(stamps)
    nodes, velocities, twist = [], [], []
    for stamp in stamps:
        time = (stamp - START_STAMP) / NANOSECONDS
        if time > simulation.time:
            simulation.advance(time)
        reached(stamp)
        nodes.append(simulation.x)
        velocities.append(simulation.v)
        if isinstance(simulation, SpatialSimulation):
            twist.append(simulation.twist)
    rod = simulation.rod
    u = rod.u if length is None else rod.u * (length / rod.u[-1])
    angles = np.array(twist) if twist else None
    return Truth(stamps, rod, u, np.array(nodes), np.array(velocities), angles)
