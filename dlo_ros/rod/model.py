# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod as a set of constant matrices and tables: discretisation, material, mass, loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from dlo_ros.effects import Body, Effect, build
from dlo_ros.rod.discretisation import Discretisation, discretisation, lower_band
from dlo_ros.rod.elements.rod_tables import (
    DOF,
    NO_SPRINGS,
    ConstitutiveLaw,
    Quadrature,
    Stiffness,
    Surroundings,
)
from dlo_ros.rod_settings import STANDARD_GRAVITY, RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

CONTACT_PENETRATION = 2e-6  # of L: how deep a contact gives way under all of the DLO's weight
PRESLIDING_DISPLACEMENT = 3e-5  # of L: displacement at which friction acts fully
INACTIVE = 9e5  # [1/m] curvatures that no DLO reaches
UNSEEN = 10.0  # stiffness of a place, over that of the rod, that leaves corrections as they are
# Spans and basis functions of the places where contact is looked for, where there are none.
NO_CONTACT = np.zeros(0, np.int64), np.zeros((0, 4))


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
        section: stiffness over that of the round section, of bending about the first and about
            the second material director, and of twist; a flat DLO differs in them.
    """

    settings: RodSettings
    basis: SplineBasis
    full_start: bool = False
    full_end: bool = False
    rest: Callable[[FloatArray], FloatArray] | None = None
    point_forces: tuple[tuple[float, tuple[float, float, float]], ...] = ()
    section: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: a copy, and another process, compute the rest anew."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def with_settings(self, settings: RodSettings) -> RodModel:
        """The discretisation with other material, damping, gravity or effects."""
        return replace(self, settings=settings)

    def clamped(self) -> RodModel:
        """The rod with clamped ends, which differs from this one in its quadrature rule alone."""
        if not (self.full_start or self.full_end):
            return self
        return replace(self, full_start=False, full_end=False)

    @cached_property
    def discretisation(self) -> Discretisation:
        """Tables of the basis, which rods of other material share."""
        return discretisation(self.basis, self.full_start, self.full_end)

    @property
    def rule(self) -> Quadrature:
        """Quadrature tables: three points a knot span."""
        return self.discretisation.rule

    @property
    def points(self) -> FloatArray:
        """Material coordinates of the bending points [m], shape (nb,)."""
        return self.discretisation.points

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that the parameter file adds."""
        return build(self.settings.effects)

    @cached_property
    def body(self) -> Body:
        """Material, mass and loads before they become matrices, effects included.

        Raises:
            ParameterError: an effect acts on a place that is not on the DLO.
        """
        body = self.settings.body(self.basis, self.section)
        if self.rest is not None:
            rest = self.rest(self.points)
            body.bend_rest += rest[:, :2]
            body.twist_rest += rest[:, 2]
        return body

    @cached_property
    def stiffness(self) -> Stiffness:
        """H of eq. (7) at every quadrature point, with the labels put right (physics.md).

        Where the DLO is longer than the material coordinate says, bending counts more often, and
        stretch and twist are per unit of the true length.
        """
        rod, body = self.settings.rod, self.body
        nb, longer = self.rule.weight.size, body.lengthening
        twist = rod.shear_modulus * 2.0 * rod.second_moment * self.section[2]
        twist *= body.twisting_ratio
        return Stiffness(
            stretch=np.full(nb, rod.young_modulus * rod.area / longer),
            stretch_rest=np.full(nb, longer - 1.0),
            bend=longer * body.bend_matrix,
            bend_rest=body.bend_rest,
            twist=np.full(nb, twist / longer),
            twist_rest=self.discretisation.span_twists(longer * body.twist_rest)
            if body.twist_rest.any()
            else body.twist_rest,
        )

    @cached_property
    def hinge(self) -> FloatArray:
        """Compliance of the grips in that of `stiffness.bend` [1/(N m^2)], shape (nb,)."""
        return np.broadcast_to(self.body.hinge / self.body.lengthening, self.points.shape).copy()

    @cached_property
    def law(self) -> ConstitutiveLaw:
        """The constitutive law of bending."""
        body = self.body
        active = float(body.half_curvature < INACTIVE or body.yield_curvature < INACTIVE)
        relaxing, lasting = body.relaxing or (0.0, 1.0)
        slide, turn = body.inner_friction or (0.0, np.inf)
        # A grip that gives does not soften, yield or rub with the DLO.
        never = np.where(body.hinged, np.inf, np.ones(len(self.points)))
        return ConstitutiveLaw(
            active, body.half_curvature * never, body.yield_curvature * never,
            min(max(body.hardening, 0.0), 1.0), relaxing, lasting, slide * body.lengthening,
            turn * never,
        )  # fmt: skip

    @cached_property
    def plain(self) -> bool:
        """Whether stiffness, mass, drag and loads describe the rod completely.

        Such a rod does not soften, yield, relax or rub within itself, touches nothing, slips
        through no grip, and has no drag that grows with the square of speed.
        """
        body = self.body
        touching = body.friction is not None or bool(body.pegs) or bool(body.walls)
        inner = self.law.relaxing != 0.0 or self.law.slide != 0.0
        return self.law.active == 0.0 and not (
            touching or inner or body.slip or body.quadratic_drag
        )

    @cached_property
    def planar(self) -> bool:
        """Whether rest strains and loads lie in the plane y = 0."""
        stiff = self.stiffness
        return not (
            stiff.bend_rest[:, 1].any()
            or stiff.bend[:, 2].any()
            or stiff.twist_rest.any()
            or self.load[:, 1].any()
        )

    @cached_property
    def surroundings(self) -> Surroundings:
        """Bodies in contact, friction and drag; points of contact only where there is a body."""
        body, rod = self.body, self.settings.rod
        length = self.basis.length
        pegs = np.array(
            [[p.x, p.z, p.radius + 0.5 * rod.diameter] for p in body.pegs], dtype=np.float64
        ).reshape(-1, 3)
        walls = np.array(
            [[w.x, w.z, w.offset + 0.5 * rod.diameter] for w in body.walls], dtype=np.float64
        ).reshape(-1, 3)
        width = self.discretisation.contact_width
        span, b = self.discretisation.contacts if len(pegs) or len(walls) else NO_CONTACT
        # All of the DLO's weight on one point presses it in by very little.
        weight = rod.linear_density * STANDARD_GRAVITY * length
        push = weight + 10.0 * rod.bending_stiffness / length**2
        return Surroundings(
            (body.friction or 0.0) * body.lengthening, PRESLIDING_DISPLACEMENT * length, pegs,
            push / (width * CONTACT_PENETRATION * length), span, b, np.full(len(span), width),
            walls, (body.quadratic_drag or 0.0) * body.lengthening, NO_SPRINGS,
        )  # fmt: skip

    @cached_property
    def remembers(self) -> tuple[int, int, int]:
        """Number of points for which each of the `InternalVariables` is kept."""
        nb, body = self.rule.weight.size, self.body
        inner = body.relaxing is not None or body.inner_friction is not None
        return (
            nb if self.law.active != 0.0 else 0, nb if body.friction is not None else 0,
            nb if inner else 0,
        )  # fmt: skip

    @property
    def gram(self) -> FloatArray:
        """Lower band of the basis' Gram matrix, shape (n, 4) [m]."""
        return self.discretisation.gram

    @cached_property
    def _hung(self) -> tuple[FloatArray, FloatArray]:
        """Fixed point masses: their matrix as a lower band (n, 4) [kg], and its row sums (n,)."""
        n = self.basis.control_points
        if not self.body.masses:
            return np.zeros((n, 4)), np.zeros(n)
        mass = np.array([m for m, _ in self.body.masses])
        b = np.array([self.basis.row(u) for _, u in self.body.masses])
        return lower_band(b.T @ (mass[:, None] * b)), b.T @ mass

    @cached_property
    def spreading(self) -> float:
        """How fast a bend spreads from a clamp, see `Command.corners` [m^2/s].

        A turn of the end of a long beam by an angle has moved it by 0.63 times that angle times
        sqrt(sqrt(B / m) t) after a time t, where most; B is its bending stiffness, m its mass per
        length. Here it is taken to reach twice as far.
        """
        return 4.0 * float(np.sqrt(self.body.bend.max() / self.body.line_density))

    @cached_property
    def line_mass(self) -> FloatArray:
        """Mass matrix of the DLO alone, lower band (n, 4) [kg]."""
        return self.body.line_density * self.body.lengthening * self.gram

    @cached_property
    def mass(self) -> FloatArray:
        """Mass matrix of x, y, z (eq. (5)), lower band (n, 4) [kg]; constant."""
        return self.line_mass + self._hung[0]

    @cached_property
    def spin(self) -> FloatArray:
        """Inertia of theta, density times pi D^4 / 32 (I of eq. (4)), lower band (n, 4)."""
        rod = self.settings.rod
        return rod.density * 2.0 * rod.second_moment * self.body.lengthening * self.gram

    @cached_property
    def drag(self) -> FloatArray:
        """Matrix of the external drag, lower band (n, 4) [N s/m]."""
        return self.body.air_drag * self.body.lengthening * self.gram

    @cached_property
    def line_load(self) -> FloatArray:
        """Generalised weight of the DLO and force per length [N], shape (n, 4)."""
        body = self.body
        share = body.lengthening * self.discretisation.basis.shares
        result = np.zeros((self.basis.control_points, DOF))
        result[:, :3] = share[:, None] * (body.line_density * body.gravity + body.force)
        return result

    @cached_property
    def load(self) -> FloatArray:
        """Generalised dead load, gravity and other forces [N], shape (n, 4)."""
        result = self.line_load.copy()
        result[:, :3] += self._hung[1][:, None] * self.body.gravity
        for u, force in self.point_forces:
            result[:, :3] += self.basis.row(u)[:, None] * np.asarray(force)
        return result

    @cached_property
    def correction_share(self) -> float:
        """How small corrections of the shape must become, over those that suffice for a plain rod.

        What is left of them strains the shortest knot span most, and bends the stiffest place.
        """
        stiffest = float(self.body.bend.max()) / self.settings.rod.bending_stiffness
        return 0.5**self.basis.halvings / max(stiffest / UNSEEN, 1.0)

    @cached_property
    def rate2(self) -> float:
        """Scale of squared frequencies [1/s^2], for the mass shift of the static solver."""
        rod = self.settings.rod
        gravity = float(np.linalg.norm(self.settings.gravity))
        return rod.bending_stiffness / rod.linear_density / rod.length**4 + gravity / rod.length
