"""The rod as a set of constant matrices and tables: discretisation, material, mass, loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dlo_ros.parameters import Settings
from dlo_ros.rod.kernels import span_twist
from dlo_ros.rod.tables import DOF, Quadrature, Stiffness
from dlo_ros.spline import FloatArray, SplineBasis

# Parameters of which sensitivities can be had; all enter by their natural logarithm.
SENSITIVITIES = ("young_modulus", "density", "air_drag", "relaxation_time")


@dataclass(frozen=True)
class RodModel:
    """One discretised rod (paper, eqs. (4) to (9)).

    Args:
        settings: material, damping and gravity.
        basis: the simulation's own spline basis, finer than the published one.
        full_start, full_end: whether the stretch of the knot span at that end counts by its
            straight line; an end whose direction is free needs it, a clamped one must not have it.
        rest: strain memory eps_0 of eq. (7) as a function of u (m,) [m]: rest curvatures about the
            two material directors and rest twist, shape (m, 3) [1/m]; None: straight at rest.
        point_forces: dead forces, each as its place u [m] and its components [N].
    """

    settings: Settings
    basis: SplineBasis
    full_start: bool = False
    full_end: bool = False
    rest: Callable[[FloatArray], FloatArray] | None = None
    point_forces: tuple[tuple[float, tuple[float, float, float]], ...] = ()

    def with_settings(self, settings: Settings) -> RodModel:
        """The same discretisation with other material, damping or gravity."""
        return replace(self, settings=settings)

    @cached_property
    def rule(self) -> Quadrature:
        """Quadrature tables: three points a knot span.

        Stretch counts by its value in the middle of a span: at every point it would lock
        (numerics.md). Where the direction of an end is free its straight line counts, or a mode
        without energy would be left over. Twist counts by its mean, since the frame's twist is no
        spline that theta could relax: means make the twist between the ends exact, and the lines
        at both ends give as many numbers as theta has coefficients.
        """
        basis = self.basis
        u, weight = basis.quadrature(3)
        span, b = self._local(u, 0)
        stretch, twist = np.zeros(basis.spans, np.bool_), np.zeros(basis.spans, np.bool_)
        stretch[0] |= self.full_start
        stretch[-1] |= self.full_end
        twist[[0, -1]] = True
        return Quadrature(
            span, b, self._local(u, 1)[1], self._local(u, 2)[1], weight, stretch, twist
        )

    def _local(self, u: FloatArray, derivative: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Knot span of each u and the four basis functions (or derivatives) that live there."""
        full = self.basis.matrix(u, derivative)
        span = np.minimum((u / self.basis.span_length).astype(np.int64), self.basis.spans - 1)
        rows = np.arange(len(u))[:, None]
        return span, np.ascontiguousarray(full[rows, span[:, None] + np.arange(4)])

    @cached_property
    def points(self) -> FloatArray:
        """Material coordinates of the bending points [m], shape (nb,)."""
        return self.basis.quadrature(3)[0]

    @cached_property
    def basis_slope(self) -> FloatArray:
        """First derivatives of the basis at the bending points, shape (nb, n)."""
        return self.basis.matrix(self.points, 1)

    @cached_property
    def basis_curvature(self) -> FloatArray:
        """Second derivatives of the basis at the bending points, shape (nb, n)."""
        return self.basis.matrix(self.points, 2)

    def span_twists(self, values: FloatArray) -> FloatArray:
        """Twists at the points (nb, ...) as those of whole spans."""
        result = np.array(values, dtype=np.float64)
        for e in range(self.basis.spans):
            for column in result[3 * e : 3 * e + 3].reshape(3, -1).T:
                span_twist(column, self.rule.twist_linear[e])
        return result

    @cached_property
    def twist_fit(self) -> FloatArray:
        """Control points 2..n of a spline that starts at 0, from its slope over the spans."""
        slope = self.span_twists(self.basis_slope[:, 1:])
        return np.asarray(np.linalg.pinv(slope))

    @cached_property
    def stiffness(self) -> Stiffness:
        """H of eq. (7) at every quadrature point, with the labels put right (physics.md)."""
        rod = self.settings.rod
        nb = self.rule.weight.size
        rest = np.zeros((nb, 3)) if self.rest is None else self.rest(self.points)
        return Stiffness(
            stretch=np.full(nb, rod.young_modulus * rod.area),
            stretch_rest=np.zeros(nb),
            bend=np.full((nb, 2), rod.bending_stiffness),
            bend_rest=np.ascontiguousarray(rest[:, :2]),
            twist=np.full(nb, rod.shear_modulus * 2.0 * rod.second_moment),
            twist_rest=self.span_twists(rest[:, 2]),
        )

    @cached_property
    def gram(self) -> FloatArray:
        """Lower band of the basis' Gram matrix, shape (n, 4) [m]."""
        n = self.basis.control_points
        full, band = self.basis.gram, np.zeros((n, 4))
        for k in range(4):
            band[3 - k :, k] = np.diagonal(full, k - 3)
        return band

    @property
    def mass(self) -> FloatArray:
        """Mass matrix of x, y, z (eq. (5)), lower band (n, 4) [kg]; constant."""
        return self.settings.rod.linear_density * self.gram

    @property
    def spin(self) -> FloatArray:
        """Inertia of theta, density times pi D^4 / 32 (I of eq. (4)), lower band (n, 4)."""
        rod = self.settings.rod
        return rod.density * 2.0 * rod.second_moment * self.gram

    @property
    def drag(self) -> FloatArray:
        """Matrix of the external drag, lower band (n, 4) [N s/m]."""
        return self.settings.damping.air_drag * self.gram

    @property
    def weight(self) -> FloatArray:
        """Generalised force of gravity [N], shape (n, 4)."""
        result = np.zeros((self.basis.control_points, DOF))
        mass = self.settings.rod.linear_density * self.basis.gram.sum(axis=1)
        result[:, :3] = mass[:, None] * np.asarray(self.settings.gravity)
        return result

    @property
    def load(self) -> FloatArray:
        """Generalised dead load, gravity and point forces [N], shape (n, 4)."""
        result = self.weight
        for u, force in self.point_forces:
            result[:, :3] += self.basis.matrix([u])[0][:, None] * np.asarray(force)
        return result

    @property
    def rate2(self) -> float:
        """Scale of squared frequencies [1/s^2], for the mass shift of the static solver."""
        rod = self.settings.rod
        gravity = float(np.linalg.norm(self.settings.gravity))
        return rod.bending_stiffness / rod.linear_density / rod.length**4 + gravity / rod.length
