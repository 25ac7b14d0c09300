# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A planar discrete elastic rod: the independent truth behind simulated experiments.

It shares nothing with the package's spline rod but the physics. N + 1 nodes in the x-z plane are
joined by N edges. With reference lengths l_i of the edges and v_i = (l_(i-1) + l_i) / 2 of the
vertices, the energy is

    sum over edges    E A / 2 * (|e_i| / l_i - 1)^2 * l_i
    sum over vertices B_i / 2 * (phi_i / v_i - kappa_i)^2 * v_i

where phi_i is the turning angle, so the curvature is angle per reference length, and kappa_i the
rest curvature. A clamp holds the first (last) node and the direction there: its vertex sees half an
edge, which makes the whole scheme second order in the edge length. Every strain is damped after
Kelvin and Voigt (force k (e + t_r de/dt)), every node by drag -c v per length; masses are lumped.

Angles and curvatures are positive from x towards -z (about +y of the board frame). Twist plays no
role in the plane. `rod_simulation` finds equilibria and steps in time. Bending may saturate, yield
or show hysteresis, the board may rub and pegs may press: see `rod_laws`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from dlo_ros.errors import InputError
from dlo_ros.parameters import DampingParameters, RodParameters
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.rod_laws import BendingLaw, Contact, Friction, Wind
from dlo_ros.synthesis.rod_steps import PlanarPotential, evaluate

PENETRATION = 1e-5
"""How deep a force of `DiscreteRod.usual_force` presses the DLO into a peg [m]."""

SLACK = 5e-6
"""How far the DLO is drawn along the board before it slides [m]."""

NO_PEGS = np.zeros((0, 3))


def mesh(length: float, edges: int, nodes_at: Sequence[float] = ()) -> FloatArray:
    """Edge lengths of a nearly uniform mesh that has nodes at given places.

    Args:
        length: L [m].
        edges: wanted number of edges; the result has about as many.
        nodes_at: material coordinates [m] in (0, L) where a node must lie.

    Returns:
        Reference lengths [m], shape (N,).
    """
    breaks = np.unique(np.concatenate([[0.0, length], np.asarray(nodes_at, dtype=np.float64)]))
    parts = []
    for width in np.diff(breaks):
        count = max(int(np.ceil(width / length * edges - 1e-9)), 1)
        parts.append(np.full(count, width / count))
    return np.concatenate(parts)


@dataclass
class DiscreteRod:
    """Properties of the rod, one value for each edge (N), node or vertex (N + 1); SI units.

    Args:
        lengths: reference length of the edges [m], shape (N,).
        stretch_stiffness: E A of the edges [N], shape (N,).
        bending_stiffness: B of the vertices [N m^2], shape (N + 1,); the ends count where clamped.
        mass: masses of the nodes [kg], shape (N + 1,).
        drag: drag coefficients of the nodes [N s/m], shape (N + 1,): force -drag times velocity.
        rest_curvature: curvatures at rest at the vertices [1/m], shape (N + 1,).
        force: constant force on the nodes [N], shape (N + 1, 2).
        gravity: x and z [m/s^2], shape (2,).
        relaxation_time: t_r [s] of Kelvin-Voigt damping.
        kink: turning angle at rest beside that of `rest_curvature` [rad], shape (N + 1,).
        half_curvature: curvature at which the tangent bending stiffness has fallen to one half
            [1/m].
        yield_curvature: elastic curvature beyond which the rest curvature follows [1/m].
        hardening: tangent stiffness past the yield, over that before it, 0 to 1.
        hysteresis: largest moment of a hysteretic bending element, over B [1/m].
        friction_moment: largest moment of that element in all vertices alike, added to it [N m].
        relaxing: share of the bending stiffness that relaxes: a Kelvin-Voigt element in series with
            the spring and the slider.
        lasting: time in which it does [s].
        hysteresis_width: change of curvature over which that moment turns round [1/m].
        hinged: whether the spring at the start and at the end is that of a grip, which is linear.
        friction: largest friction with the board of the nodes [N], shape (N + 1,).
        pegs: x, z [m] and the distance of the DLO's axis at contact [m], shape (m, 3).
        wall: unit normal x, z and where along it the DLO's axis touches [m], shape (3,), or none.
        quadratic_drag: quadratic drag of the nodes, force over the square of the velocity across
            the DLO [N s^2/m^2], shape (N + 1,).
    """

    lengths: FloatArray
    stretch_stiffness: FloatArray
    bending_stiffness: FloatArray
    mass: FloatArray
    drag: FloatArray
    rest_curvature: FloatArray
    force: FloatArray
    gravity: FloatArray = field(default_factory=lambda: np.array([0.0, -9.81]))
    relaxation_time: float = 0.0
    kink: FloatArray = field(default_factory=lambda: np.zeros(0))
    half_curvature: float = np.inf
    yield_curvature: float = np.inf
    hardening: float = 0.0
    hysteresis: float = 0.0
    friction_moment: float = 0.0
    relaxing: float = 0.0
    lasting: float = 1.0
    hysteresis_width: float = 1.0
    hinged: tuple[bool, bool] = (False, False)
    friction: FloatArray = field(default_factory=lambda: np.zeros(0))
    pegs: FloatArray = field(default_factory=lambda: NO_PEGS)
    wall: FloatArray = field(default_factory=lambda: np.zeros(0))
    quadratic_drag: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name in ("kink", "friction", "quadratic_drag"):
            if not len(getattr(self, name)):
                setattr(self, name, np.zeros(len(self.mass)))

    @classmethod
    def uniform(
        cls,
        rod: RodParameters,
        damping: DampingParameters,
        *,
        gravity: ArrayLike = (0.0, -9.81),
        edges: int = 160,
        nodes_at: Sequence[float] = (),
    ) -> DiscreteRod:
        """A straight rod of the same properties everywhere.

        Args:
            rod: material and geometry.
            damping: air drag and relaxation time.
            gravity: x and z [m/s^2], shape (2,).
            edges: wanted number of edges.
            nodes_at: material coordinates [m] where a node must lie (pins).
        """
        lengths = mesh(rod.length, edges, nodes_at)
        tributary = tributary_lengths(lengths)
        return cls(
            lengths=lengths,
            stretch_stiffness=np.full(len(lengths), rod.young_modulus * rod.area),
            bending_stiffness=np.full(len(tributary), rod.bending_stiffness),
            mass=rod.linear_density * tributary,
            drag=damping.air_drag * tributary,
            rest_curvature=np.zeros(len(tributary)),
            force=np.zeros((len(tributary), 2)),
            gravity=np.asarray(gravity, dtype=np.float64),
            relaxation_time=damping.relaxation_time,
        )

    @property
    def u(self) -> FloatArray:
        """Material coordinate of the nodes [m], shape (N + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)])

    @property
    def vertex_lengths(self) -> FloatArray:
        """Reference length that belongs to each vertex's turning angle [m], shape (N + 1,)."""
        return tributary_lengths(self.lengths)

    @property
    def weight(self) -> FloatArray:
        """Gravity and constant forces on the nodes [N], shape (N + 1, 2)."""
        return self.mass[:, None] * self.gravity + self.force

    def coarsened(self, keep: NDArray[np.int64]) -> DiscreteRod:
        """The rod on some of its nodes, `keep` in growing order with both ends."""
        u = self.u
        at, starts = u[keep], keep[:-1]
        spread = np.array([np.interp(u, at, row) for row in np.eye(len(keep))])  # (kept, N + 1)
        stiffness = np.add.reduceat(self.stretch_stiffness * self.lengths, starts)
        return replace(
            self,
            lengths=np.diff(at),
            stretch_stiffness=stiffness / np.diff(at),
            bending_stiffness=self.bending_stiffness[keep],
            mass=spread @ self.mass,
            drag=spread @ self.drag,
            rest_curvature=self.rest_curvature[keep],
            force=spread @ self.force,
            kink=spread @ self.kink,
            friction=spread @ self.friction,
            quadratic_drag=spread @ self.quadratic_drag,
        )

    def softest_stretch(self) -> float:
        """Factor on E A that neither the weight stretches far nor a kink makes an edge collapse."""
        weight = float(np.sum(np.abs(self.weight)))
        kink = float(np.max(self.bending_stiffness) / np.min(self.lengths) ** 2)
        return min(max(1e-3, 10.0 * max(weight, kink) / np.min(self.stretch_stiffness)), 1.0)

    @property
    def linear(self) -> bool:
        """Whether moment and curvature are proportional, without any history."""
        bounds = np.array([self.half_curvature, self.yield_curvature])
        return bool(np.all(np.isinf(bounds))) and not (self.hysteresis or self.friction_moment)

    @property
    def usual_force(self) -> float:
        """A force that is large for this rod [N]: ten times its weight and its buckling load."""
        bend = float(np.max(self.bending_stiffness)) * (2.0 * np.pi / float(self.u[-1])) ** 2
        return 10.0 * (float(np.sum(np.abs(self.weight))) + bend)

    def stiffness(self) -> tuple[FloatArray, FloatArray]:
        """Linear stiffness [J] of the edges against stretch, (N,), of the vertices against turning.

        The vertices have none where `bending_law` stands for it.
        """
        edge = self.stretch_stiffness * self.lengths
        if not self.linear:
            return edge, np.zeros(len(self.bending_stiffness))
        return edge, self.bending_stiffness / self.vertex_lengths

    def rest_offsets(self) -> tuple[FloatArray, FloatArray]:
        """Linear stiffness times rest strain [J], for edges and vertices."""
        _, vertex = self.stiffness()
        return np.zeros(len(self.lengths)), vertex * self.rest_turn

    @property
    def rest_turn(self) -> FloatArray:
        """Turning angle of the vertices at rest [rad], shape (N + 1,)."""
        return np.asarray(self.rest_curvature * self.vertex_lengths + self.kink)

    def relaxed(self) -> Self:
        """The rod as it is in the end, when all has relaxed that may."""
        held = 1.0 - self.relaxing
        # The spring carries `held` of the curvature; the slider's moments stay what they are.
        hardening = self.hardening / (self.hardening + (1.0 - self.hardening) * held)
        return replace(
            self, relaxing=0.0, bending_stiffness=held * self.bending_stiffness,
            half_curvature=self.half_curvature / held, yield_curvature=self.yield_curvature / held,
            hardening=hardening,
        )  # fmt: skip

    def bending_law(self) -> BendingLaw:
        """Moment against turning angle, without a history."""
        v = self.vertex_lengths
        none = np.zeros(0)
        if self.linear:
            return BendingLaw(False, *([none] * 10))
        k, hinged = self.bending_stiffness / v, np.zeros(len(v), dtype=bool)
        hinged[[0, -1]] = self.hinged
        share = min(self.hardening, 1.0 - 1e-12)
        yields = self.yield_curvature if self.hardening < 1.0 else np.inf
        return BendingLaw(
            active=True,
            stiffness=k,
            rest=self.rest_turn,
            half=np.where(hinged, np.inf, self.half_curvature * v),
            limit=np.where(hinged, np.inf, k * yields * v),
            hardening=k * share / (1.0 - share),
            plastic=np.zeros_like(v),
            drag=np.where(
                hinged, 0.0, self.hysteresis * self.bending_stiffness + self.friction_moment
            ),
            width=self.hysteresis_width * v,
            drag_state=np.zeros_like(v),
            turn=np.zeros_like(v),
        )

    def contact(self) -> Contact:
        """Pegs and a wall, so stiff that `usual_force` on one point presses in by `PENETRATION`."""
        along = float(np.mean(self.lengths))
        if not len(self.pegs):
            stiffness = self.usual_force / (along * PENETRATION) if len(self.wall) else 0.0
            return Contact(bool(len(self.wall)), NO_PEGS, stiffness, 1.0, self.wall)
        # A straight DLO that penetrates by d touches along 2 sqrt(2 r d); the mean depth is 2 d/3.
        patch = np.sqrt(2.0 * float(np.min(self.pegs[:, 2])) * PENETRATION)
        stiffness = self.usual_force / (4.0 / 3.0 * patch * PENETRATION)
        return Contact(True, self.pegs, float(stiffness), float(0.5 * patch), self.wall)

    def potential(
        self,
        held: FloatArray,
        clamps: FloatArray,
        *,
        law: BendingLaw | None = None,
    ) -> PlanarPotential:
        """The function that an equilibrium minimises: no inertia, no friction.

        Args:
            held: 1 where a node is imposed, 0 where it is free, shape (N + 1,).
            clamps: imposed directions [rad], NaN where free, shape (2,).
            law: bending law with its history; None: linear bending.
        """
        return PlanarPotential(
            held=held,
            lengths=self.lengths,
            clamps=clamps,
            stiffness=self.stiffness(),
            offsets=self.rest_offsets(),
            spring=np.zeros_like(self.mass),
            load=self.weight,
            law=self.bending_law() if law is None else law,
            friction=no_friction(),
            contact=self.contact(),
            wind=no_wind(),
        )

    def energy(self, x: FloatArray, v: FloatArray, clamps: FloatArray) -> float:
        """Elastic, potential and kinetic energy [J] at nodes x [m] with velocities v [m/s]."""
        potential = self.potential(np.zeros_like(self.mass), clamps)
        value = evaluate(x, potential, np.empty_like(x), np.empty((6, 2 * len(x))))
        return float(value) + float(0.5 * np.sum(self.mass[:, None] * v**2))


def no_friction() -> Friction:
    """A board that does not rub."""
    return Friction(False, np.zeros(0), np.zeros((0, 2)), 1.0)


def no_wind() -> Wind:
    """No drag but the linear one."""
    return Wind(False, np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), 0.0)


def tributary_lengths(lengths: FloatArray) -> FloatArray:
    """Half of the edges beside each node [m], shape (N + 1,), of edges of shape (N,)."""
    padded = np.concatenate([[0.0], lengths, [0.0]])
    return np.asarray(0.5 * (padded[:-1] + padded[1:]))


def lay_along(curve: ArrayLike, rod: DiscreteRod) -> FloatArray:
    """Nodes spread along a rough curve in proportion to their material coordinate.

    Args:
        curve: x and z [m], shape (m, 2), m at least 2; in space x, y and z, shape (m, 3).

    Returns:
        Nodes [m], shape (N + 1, 2) or (N + 1, 3), to be settled.

    Raises:
        InputError: the curve has no length.
    """
    points = np.asarray(curve, dtype=np.float64)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if not s[-1] > 0.0:
        raise InputError("the curve that the rope is laid along has no length")
    at = rod.u / rod.u[-1] * s[-1]
    return np.column_stack([np.interp(at, s, column) for column in points.T])


def centreline(rod: DiscreteRod | FloatArray, x: FloatArray, u: ArrayLike) -> FloatArray:
    """Smooth interpolation of the nodes.

    Args:
        rod: the rod, or material coordinates of its nodes [m], shape (N + 1,).
        x: nodes [m], shape (N + 1, 2), or (N + 1, 3) in space.
        u: material coordinates [m], shape (m,).

    Returns:
        Points in the board frame [m], shape (m, 3), y = 0 in the plane.
    """
    nodes = rod.u if isinstance(rod, DiscreteRod) else rod
    plane = CubicSpline(nodes, x)(np.asarray(u, dtype=np.float64))
    if plane.shape[1] == 3:
        return np.asarray(plane)
    return np.column_stack([plane[:, 0], np.zeros(len(plane)), plane[:, 1]])
