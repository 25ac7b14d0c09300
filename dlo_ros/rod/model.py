"""The rod as a set of constant matrices and tables: discretisation, material, mass, loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dlo_ros.parameters import Settings
from dlo_ros.rod.kernels import DOF, Quadrature, Stiffness
from dlo_ros.spline import ORDER, FloatArray, SplineBasis

# Parameters of which sensitivities can be had; all enter by their natural logarithm.
SENSITIVITIES = ("young_modulus", "density", "air_drag", "relaxation_time")


@dataclass(frozen=True)
class RodModel:
    """One discretised rod (paper, eqs. (4) to (9)).

    Args:
        settings: material, damping and gravity.
        basis: the simulation's own spline basis, finer than the published one.
        full_start, full_end: whether the knot span at that end takes the full stretch quadrature;
            an end whose direction is free needs it, a clamped end must not have it (numerics.md).
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
        """Quadrature tables of stretch, and of bending and twist (three points a span)."""
        basis = self.basis
        u, weight = basis.quadrature(3)
        span, b = self._local(u, 0)
        h = basis.span_length
        parts = []
        for e in range(basis.spans):
            full = (e == 0 and self.full_start) or (e == basis.spans - 1 and self.full_end)
            x, w = np.polynomial.legendre.leggauss(ORDER if full else 1)
            parts.append((h * e + 0.5 * h * (x + 1.0), 0.5 * h * w))
        su = np.concatenate([p[0] for p in parts])
        stretch_span, stretch_b1 = self._local(su, 1)
        return Quadrature(
            stretch_span, stretch_b1, np.concatenate([p[1] for p in parts]),
            span, b, self._local(u, 1)[1], self._local(u, 2)[1], weight,
        )  # fmt: skip

    def _local(self, u: FloatArray, derivative: int) -> tuple[FloatArray, FloatArray]:
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

    @cached_property
    def twist_share(self) -> FloatArray:
        """Weight of each bending point in the twist energy, over its quadrature weight, (nb,).

        With a point in every span and one more at both ends there are as many as theta has free
        coefficients, so that the twist of the frame, which is no spline, can relax at every one
        of them: more points would lock, as full quadrature does in stretch. The weights integrate
        the derivatives of all splines of the basis exactly, so a uniform torque is an equilibrium.
        """
        spans = self.basis.spans
        middle = 3 * np.arange(spans) + 1
        if spans > 1:
            keep = np.concatenate([[0, 2], middle[1:-1], [3 * spans - 3, 3 * spans - 1]])
        else:
            keep = np.arange(3)
        slope = self.basis.matrix(self.points[keep], 1)
        ends = self.basis.matrix([0.0, self.basis.length])
        weight = np.linalg.lstsq(slope.T, ends[1] - ends[0], rcond=None)[0]
        share = np.zeros(len(self.points))
        share[keep] = weight / self.rule.weight[keep]
        return share

    @cached_property
    def twist_fit(self) -> FloatArray:
        """Control points 2..n of a spline that starts at 0, from its slope at all points."""
        keep = self.twist_share > 0.0
        result = np.zeros((self.basis.control_points - 1, len(self.points)))
        result[:, keep] = np.linalg.inv(self.basis.matrix(self.points[keep], 1)[:, 1:])
        return result

    @cached_property
    def stiffness(self) -> Stiffness:
        """H of eq. (7) at every quadrature point, with the labels put right (physics.md)."""
        rod = self.settings.rod
        ns, nb = self.rule.stretch_weight.size, self.rule.weight.size
        rest = np.zeros((nb, 3)) if self.rest is None else self.rest(self.points)
        return Stiffness(
            stretch=np.full(ns, rod.young_modulus * rod.area),
            stretch_rest=np.zeros(ns),
            bend=np.full((nb, 2), rod.bending_stiffness),
            bend_rest=np.ascontiguousarray(rest[:, :2]),
            twist=rod.shear_modulus * 2.0 * rod.second_moment * self.twist_share,
            twist_rest=np.ascontiguousarray(rest[:, 2]),
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
