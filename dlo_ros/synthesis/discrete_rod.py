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
role in the plane. `rod_simulation` finds equilibria and steps in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from dlo_ros.errors import InputError
from dlo_ros.parameters import DampingParameters, RodParameters
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis import rod_kernels


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
        mass: of the nodes [kg], shape (N + 1,).
        drag: of the nodes [N s/m], shape (N + 1,): force -drag times velocity.
        rest_curvature: of the vertices [1/m], shape (N + 1,).
        force: constant force on the nodes [N], shape (N + 1, 2).
        gravity: x and z [m/s^2], shape (2,).
        relaxation_time: t_r [s] of Kelvin-Voigt damping.
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
        tributary = np.zeros(len(lengths) + 1)
        tributary[:-1] += 0.5 * lengths
        tributary[1:] += 0.5 * lengths
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
        padded = np.concatenate([[0.0], self.lengths, [0.0]])
        return np.asarray(0.5 * (padded[:-1] + padded[1:]))

    @property
    def weight(self) -> FloatArray:
        """Gravity and constant forces on the nodes [N], shape (N + 1, 2)."""
        return self.mass[:, None] * self.gravity + self.force

    def coarsened(self, keep: NDArray[np.int64]) -> DiscreteRod:
        """The same rod on some of its nodes, `keep` in growing order with both ends."""
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
        )

    def softest_stretch(self) -> float:
        """Factor on E A that neither the weight stretches far nor a kink makes an edge collapse."""
        weight = float(np.sum(np.abs(self.weight)))
        kink = float(np.max(self.bending_stiffness) / np.min(self.lengths) ** 2)
        return min(max(1e-3, 10.0 * max(weight, kink) / np.min(self.stretch_stiffness)), 1.0)

    def stiffness(self) -> tuple[FloatArray, FloatArray]:
        """Stiffness [J] of the edges against stretch, (N,), of the vertices against turning."""
        return self.stretch_stiffness * self.lengths, self.bending_stiffness / self.vertex_lengths

    def rest_offsets(self) -> tuple[FloatArray, FloatArray]:
        """Stiffness times rest strain [J], for edges and vertices."""
        return np.zeros(len(self.lengths)), self.bending_stiffness * self.rest_curvature

    def energy(self, x: FloatArray, v: FloatArray, clamps: FloatArray) -> float:
        """Elastic, potential and kinetic energy [J] at nodes x [m] with velocities v [m/s]."""
        stretch, turn = rod_kernels.strains(x, self.lengths, clamps)
        edge, vertex = self.stiffness()
        curving = turn - self.rest_curvature * self.vertex_lengths
        curving[[0, -1]] *= ~np.isnan(clamps)
        elastic = np.sum(edge * stretch**2) + np.sum(vertex * curving**2)
        kinetic = np.sum(self.mass[:, None] * v**2)
        return float(0.5 * elastic + 0.5 * kinetic - np.sum(self.weight * x))


def lay_along(curve: ArrayLike, rod: DiscreteRod) -> FloatArray:
    """Nodes spread along a rough curve in proportion to their material coordinate.

    Args:
        curve: x and z [m], shape (m, 2), m at least 2.

    Returns:
        Nodes [m], shape (N + 1, 2), to be settled.

    Raises:
        InputError: the curve has no length.
    """
    points = np.asarray(curve, dtype=np.float64)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if not s[-1] > 0.0:
        raise InputError("the curve that the rope is laid along has no length")
    at = rod.u / rod.u[-1] * s[-1]
    return np.column_stack([np.interp(at, s, points[:, c]) for c in range(2)])


def centreline(rod: DiscreteRod, x: FloatArray, u: ArrayLike) -> FloatArray:
    """Smooth interpolation of the nodes.

    Args:
        x: nodes [m], shape (N + 1, 2).
        u: material coordinates [m], shape (m,).

    Returns:
        Points in the board frame [m], shape (m, 3), y = 0.
    """
    plane = CubicSpline(rod.u, x)(np.asarray(u, dtype=np.float64))
    return np.column_stack([plane[:, 0], np.zeros(len(plane)), plane[:, 1]])
