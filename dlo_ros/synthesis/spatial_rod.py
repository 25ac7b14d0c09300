# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A discrete elastic rod in space: the independent truth behind experiments that leave the plane.

N + 1 nodes are joined by N edges, each with a material frame: two directors d1, d2 across it. The
curvature at a vertex is the integrated curvature binormal kb = 2 t x t' / (1 + t . t') of its two
edges (Bergou, Wardetzky, Robinson, Audoly and Grinspun, Discrete elastic rods, 2008), by its
components along the mean directors of both; the twist is the angle from the director that is
carried from the first edge to the second the short way, to the second's own. With v the reference
length of a vertex the energy is

    sum over edges    E A / 2 (|e| / l - 1)^2 l
    sum over vertices 1 / (2 v) (k - k0)^T B (k - k0) + C / (2 v) (m - m0)^2

A clamp is an edge without length beyond the end, with a direction and directors of its own; its
vertex sees half an edge. Curvature counts by reference length. All else is as in `discrete_rod`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dlo_ros.parameters import RodParameters
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.discrete_rod import DiscreteRod

STEEP = 0.9
"""Component along y of a tangent from which on the first director begins along z, not y."""


@dataclass
class SpatialRod(DiscreteRod):
    """Properties of the rod in space; `gravity` has shape (3,), `force` (N + 1, 3).

    `rest_curvature` and `kink` are about the first director, the y axis of the clamp at the start.

    Args:
        twist_stiffness: C of the vertices [N m^2], shape (N + 1,).
        spin_inertia: moments of inertia of the edges about their axis [kg m^2], shape (N,).
        second_curvature: curvature at rest about the second director [1/m], shape (N + 1,).
        section: bending stiffness of the vertices over `bending_stiffness` in the material frame,
            shape (N + 1, 2, 2); empty: they bend alike about all axes.
    """

    twist_stiffness: FloatArray = field(default_factory=lambda: np.zeros(0))
    spin_inertia: FloatArray = field(default_factory=lambda: np.zeros(0))
    second_curvature: FloatArray = field(default_factory=lambda: np.zeros(0))
    section: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.second_curvature):
            self.second_curvature = np.zeros(len(self.mass))
        if not len(self.section):
            self.section = np.tile(np.eye(2), (len(self.mass), 1, 1))

    @property
    def rest_strain(self) -> FloatArray:
        """Integrated curvatures and twist of the vertices at rest [rad], shape (N + 1, 3)."""
        second = self.second_curvature * self.vertex_lengths
        return np.column_stack([self.rest_turn, second, np.zeros_like(second)])

    def vertex_stiffness(self) -> FloatArray:
        """Stiffness against integrated curvature and twist [J], shape (N + 1, 3, 3)."""
        result = np.zeros((len(self.mass), 3, 3))
        result[:, :2, :2] = self.bending_stiffness[:, None, None] * self.section
        result[:, 2, 2] = self.twist_stiffness
        return result / self.vertex_lengths[:, None, None]

    def coarsened(self, keep: NDArray[np.int64]) -> SpatialRod:
        """The rod on some of its nodes, `keep` in growing order with both ends."""
        coarse = super().coarsened(keep)
        assert isinstance(coarse, SpatialRod)
        return replace(
            coarse,
            twist_stiffness=self.twist_stiffness[keep],
            spin_inertia=np.add.reduceat(self.spin_inertia, keep[:-1]),
            second_curvature=self.second_curvature[keep],
            section=self.section[keep],
        )


def in_space(rod: DiscreteRod, material: RodParameters, gravity: FloatArray) -> SpatialRod:
    """A planar rod as one in space, with the twist of a round section of the same material.

    Args:
        rod: properties of the rod in the plane; where it is stiffer against bending, it is against
            twist.
        material: material of the rod.
        gravity: x, y and z [m/s^2], shape (3,).
    """
    own = {name: getattr(rod, name) for name in DiscreteRod.__dataclass_fields__}
    plane = own | {
        "gravity": np.asarray(gravity, dtype=np.float64),
        "force": np.column_stack([rod.force[:, 0], np.zeros(len(rod.mass)), rod.force[:, 1]]),
    }
    polar = 2.0 * material.second_moment
    return SpatialRod(
        **plane,
        twist_stiffness=np.full(len(rod.mass), material.shear_modulus * polar),
        spin_inertia=material.density * polar * rod.lengths,
    )


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products of vectors (n, 3), shape (n,)."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector products of vectors (n, 3); for these `numpy.cross` is slow."""
    result = np.empty_like(a)
    result[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    result[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    result[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return result


def edges_of(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit tangents (N, 3) and sizes [m], shape (N,), of the edges between nodes (N + 1, 3)."""
    edge = x[1:] - x[:-1]
    size = np.sqrt(dot(edge, edge))
    return edge / size[:, None], size


def cleaned(director: FloatArray, tangent: FloatArray) -> FloatArray:
    """Directors made unit and normal to unit tangents, each (n, 3)."""
    director = director - dot(director, tangent)[:, None] * tangent
    return np.asarray(director / np.sqrt(dot(director, director))[:, None])


def carried(director: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """A director turned the short way from unit tangent `before` to `after`, each (3,)."""
    ratio = director @ after / (1.0 + before @ after)
    turned = director - ratio * (before + after)
    return np.asarray(cleaned(turned[None], after[None])[0])


def turned_about(director: FloatArray, tangent: FloatArray, angle: float) -> FloatArray:
    """Directors turned about unit tangents by an angle [rad], shapes (n, 3)."""
    return np.asarray(np.cos(angle) * director + np.sin(angle) * cross(tangent, director))


def first_director(tangent: FloatArray) -> FloatArray:
    """The material director of a rod without a clamp: y, or z, made normal to a tangent (3,)."""
    axis = np.eye(3)[1] if abs(tangent[1]) < STEEP else np.eye(3)[2]
    return np.asarray(cleaned(axis[None], tangent[None])[0])


def twist_free(tangents: FloatArray, director: FloatArray) -> FloatArray:
    """Directors carried along unit tangents (N, 3) without twist, from the first one (3,)."""
    result = np.empty_like(tangents)
    result[0] = director
    for i in range(len(tangents) - 1):
        result[i + 1] = carried(result[i], tangents[i], tangents[i + 1])
    return result


def laid(
    tangents: FloatArray,
    start: FloatArray | None,
    clamps: tuple[FloatArray | None, FloatArray | None],
) -> FloatArray:
    """Directors of a rod that lies without twist in its clamps.

    Args:
        tangents: unit tangents of the edges, shape (N, 3).
        start: imposed direction at the start, shape (3,); None: it is free.
        clamps: rotation matrices of the clamps at start and end, see `SpatialBoundary.turns`.

    Returns:
        Shape (N, 3).
    """
    first, last = clamps
    if first is None and last is not None:
        return twist_free(tangents[::-1], carried(last[:, 1], last[:, 0], tangents[-1]))[::-1]
    start = tangents[0] if start is None else start
    own = first_director(start) if first is None else first[:, 1]
    return twist_free(tangents, carried(own, start, tangents[0]))


def angle_between(first: FloatArray, second: FloatArray, tangent: FloatArray) -> FloatArray:
    """Angle about unit tangents from directors to others [rad], -pi to pi, shape (n,)."""
    return np.arctan2(dot(cross(first, second), tangent), dot(first, second))
