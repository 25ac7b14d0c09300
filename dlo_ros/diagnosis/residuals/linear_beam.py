# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod as a linear beam under tension about a shape: its response to small loads.

The beam has bending stiffness (in space in both directions, without the part of twist), tension,
and hardly any stretch. It has more knot spans than what was observed: a load beside a clamp bends a
short piece, and too few spans would make it stiffer than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dlo_ros.command import Command
from dlo_ros.parameters import Settings
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.spline import DEGREE, FloatArray, SplineBasis

FINER = 2
"""Knot spans of the beam over those of the observed spline."""
STRETCH = 1e4
"""Stretching stiffness over B / L^2: stiff, but no cause of rounding errors."""
PIN = 100.0
"""Stiffness of what holds a point, over the largest of the beam."""
LEAST_TENSION = -8.0
"""Least tension over B / L^2: a little less would make the linear beam buckle."""


@dataclass(frozen=True)
class Beam:
    """Stiffness, inertia and drag of a rod about shapes of its motion.

    Args:
        settings: parameters of the rod.
        commands: imposed motions of the held places.
        axes: coordinates in which it moves; x and z in the plane.
    """

    settings: Settings
    commands: Sequence[Command]
    axes: Sequence[int]

    @cached_property
    def seen(self) -> SplineBasis:
        """Spline basis of the observed shapes."""
        rod = self.settings.rod
        return SplineBasis(rod.control_points, rod.length)

    @cached_property
    def basis(self) -> SplineBasis:
        """Finer spline basis of the beam."""
        return SplineBasis(FINER * self.seen.spans + DEGREE, self.seen.length)

    @cached_property
    def lift(self) -> FloatArray:
        """Matrix from observed control points to those of the beam, shape (N, n)."""
        return self.basis.projection(self.seen)

    @cached_property
    def projection(self) -> FloatArray:
        """Matrix from the beam's displacement to the observed one, shape (d n, d N)."""
        return np.asarray(np.kron(self.seen.projection(self.basis), np.eye(len(self.axes))))

    @cached_property
    def _boundary(self) -> Boundary:
        names = tuple(dict.fromkeys(n for c in self.commands for n in c.names))
        return Boundary(names, self.basis, self.seen)

    @cached_property
    def _fixed(self) -> np.ndarray:
        """Mask of the imposed coordinates, shape (N, d)."""
        fixed = self._boundary.fixed.reshape(len(self.basis.greville), -1)
        return np.asarray(fixed[:, list(self.axes)])

    @property
    def free(self) -> np.ndarray:
        """Mask of the coordinates that nothing imposes, shape (d N,)."""
        return ~self._fixed.ravel()

    @cached_property
    def places(self) -> list[float]:
        """Held places along the DLO [m]."""
        places = [0.0] if self._fixed[0].any() else []
        places += sorted(self._boundary.pin_abscissae.tolist())
        return places + ([self.seen.length] if self._fixed[-1].any() else [])

    @cached_property
    def _rule(self) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
        """Quadrature points, their weights, and the basis there with its first two derivatives."""
        u, weight = self.basis.quadrature()
        return u, weight, [self.basis.matrix(u, order) for order in range(3)]

    def load(self, density: FloatArray) -> FloatArray:
        """Forces on the control points [N] from loads per length at the quadrature points [N/m].

        Args:
            density: load per length, the same in each direction, shape (Q, M).

        Returns:
            Shape (d N, d M), coordinates interleaved.
        """
        _, weight, (values, *_) = self._rule
        each = values.T @ (weight[:, None] * density)
        return np.asarray(np.kron(each, np.eye(len(self.axes))))

    @cached_property
    def inertia(self) -> FloatArray:
        """Mass matrix, shape (d N, d N) [kg]."""
        each = self.settings.rod.linear_density * self.basis.gram
        return np.asarray(np.kron(each, np.eye(len(self.axes))))

    def stiffness(
        self, shape: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Stiffness and damping about a shape, coordinates interleaved.

        Args:
            shape, acceleration: control points of the beam [m], [m/s^2], shape (N, d).

        Returns:
            [N/m] and [N s/m], each of shape (d N, d N).
        """
        rod, basis = self.settings.rod, self.basis
        _, weight, (_, slopes, bends) = self._rule
        tangent = self._tangent(shape)
        b = rod.bending_stiffness
        ways = shape.shape[1]

        def along(rows: FloatArray, direction: FloatArray, scale: FloatArray | float) -> FloatArray:
            j = _projected(rows, direction)
            result: FloatArray = j.T @ ((weight * scale)[:, None] * j)
            return result

        stretch = self._stretch
        tension = self._tension(shape, acceleration, tangent)
        tension = np.maximum(tension, LEAST_TENSION * b / rod.length**2)
        even = np.asarray(np.kron(basis.gram, np.eye(ways)))
        result = along(slopes, tangent, stretch) + 1e-9 * stretch * even
        damping = self.settings.damping
        lost = damping.air_drag * even
        for across in _normals(tangent):
            bending = along(bends, across, b)
            result += bending + along(slopes, across, tension)
            lost += damping.relaxation_time * bending
        pin = PIN * float(np.abs(result).max())
        rows = basis.matrix(self._boundary.pin_abscissae)
        result += pin * np.kron(rows.T @ rows, np.eye(ways))
        return result, lost

    def lengthening(self, shape: FloatArray) -> FloatArray:
        """Forces on the control points [N] that strain the beam by one, as much everywhere.

        Args:
            shape: control points of the beam [m], shape (N, d).

        Returns:
            Shape (d N,), coordinates interleaved.
        """
        _, weight, (_, slopes, _) = self._rule
        return np.asarray(self._stretch * weight @ _projected(slopes, self._tangent(shape)))

    def displaced_ends(self, shape: FloatArray, offset: float, angle: float) -> FloatArray:
        """Displacements of control points that are held, where an end is held elsewhere.

        Args:
            shape: control points of the beam [m], shape (N, d).
            offset: displacement of a held end along each axis [m].
            angle: turn of an end whose direction is held, about each axis [rad].

        Returns:
            [m], a column for each displacement and turn, shape (d N, H), coordinates interleaved.
        """
        ways = shape.shape[1]
        columns = []
        for first, second in ((0, 1), (-1, -2)):
            arm = shape[second] - shape[first]
            for move in offset * np.eye(ways):
                columns.append(np.zeros(shape.shape))
                columns[-1][[first, second]] = move
            for turn in [arm[::-1] * (1.0, -1.0)] if ways < 3 else np.cross(np.eye(3), arm):
                columns.append(np.zeros(shape.shape))
                columns[-1][second] = angle * turn
        held = np.stack([c * self._fixed for c in columns], axis=-1).reshape(shape.size, -1)
        return np.asarray(held[:, held.any(axis=0)])

    @property
    def _stretch(self) -> float:
        """Stretching stiffness [N]."""
        return STRETCH * self.settings.rod.bending_stiffness / self.settings.rod.length**2

    def _tangent(self, shape: FloatArray) -> FloatArray:
        """Unit tangents at the quadrature points, shape (Q, d)."""
        tangent = self._rule[2][1] @ shape
        return np.asarray(
            tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        )

    def _tension(
        self, shape: FloatArray, acceleration: FloatArray, tangent: FloatArray
    ) -> FloatArray:
        """Tension at the quadrature points [N], from weight, inertia and the slope of the moment.

        The grips carry the rod's weight, and it is unknown how they share it: the shares are chosen
        such that the shear forces fit the moments best.
        """
        rod = self.settings.rod
        u, weight, (values, _, bends) = self._rule
        gravity = np.array(self.settings.gravity)[list(self.axes)]
        each = weight[:, None] * (values @ acceleration - gravity) * rod.linear_density
        force = np.cumsum(each, axis=0) - 0.5 * each
        places = self.places
        if not places:
            return np.asarray(np.sum(force * tangent, axis=1))
        # The last of them takes what the others leave.
        last = (u > places[-1])[:, None]
        force = force - last * each.sum(axis=0)
        if len(places) > 1:
            bend = bends @ shape
            bend -= np.sum(bend * tangent, axis=1, keepdims=True) * tangent
            shear = -rod.bending_stiffness * np.gradient(bend, u, axis=0) - force
            between = np.column_stack([(u > p).astype(float) - last[:, 0] for p in places[:-1]])
            normals = _normals(tangent)
            rows = [between[:, :, None] * a[:, None, :] for a in normals]
            right = [np.sum(shear * a, axis=1) for a in normals]
            taken, *_ = np.linalg.lstsq(
                np.concatenate(rows).reshape(len(normals) * len(u), -1),
                np.concatenate(right), rcond=None,
            )  # fmt: skip
            force = force + between @ taken.reshape(len(places) - 1, -1)
        return np.asarray(np.sum(force * tangent, axis=1))


def _projected(rows: FloatArray, direction: FloatArray) -> FloatArray:
    """Matrix from control points to a component of what rows (Q, N) make of them, shape (Q, d N).

    Args:
        direction: unit vectors, shape (Q, d).
    """
    return (rows[:, :, None] * direction[:, None, :]).reshape(len(rows), -1)


def _normals(tangent: FloatArray) -> list[FloatArray]:
    """Unit vectors across the DLO, one in the plane, two in space, each of shape (Q, d)."""
    if tangent.shape[1] == 2:
        return [np.column_stack([-tangent[:, 1], tangent[:, 0]])]
    # Away from the axis that the tangent follows least; stiffness is alike in all directions.
    axis = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    first = np.cross(tangent, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return [first, np.cross(tangent, first)]
