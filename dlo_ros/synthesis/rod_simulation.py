# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Equilibria and motion of the planar discrete elastic rod.

Time stepping is BDF2 with Newton's method on the exact Hessian of each step's potential; strain
rates are differenced in the same way, so that the Hessian stays symmetric.

All properties of the rod are arrays and may be changed between two calls of
`DiscreteRodSimulation.advance`;
what changes in time by itself (a gust, a rope that slips) is given as a function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.interpolate import CubicSpline

from dlo_ros.errors import SimulationError
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis import rod_kernels
from dlo_ros.synthesis.discrete_rod import SLACK, DiscreteRod, no_friction, no_wind
from dlo_ros.synthesis.rod_laws import BendingLaw, Contact, Friction, Wind, pull_anchors, yield_to
from dlo_ros.synthesis.rod_steps import PlanarPotential, descend, minimise

Change = Callable[[DiscreteRod, float], DiscreteRod]
"""The rod at a time [s], made of the rod as it is without any change."""


@dataclass(frozen=True)
class ImposedNodes:
    """Imposed positions and directions at one instant.

    Args:
        positions: x and z [m] of imposed nodes by their index.
        start, end: imposed direction of growing u at that end [rad]; None leaves it free.
    """

    positions: Mapping[int, FloatArray]
    start: float | None = None
    end: float | None = None

    @property
    def clamps(self) -> FloatArray:
        """Directions with NaN where free, shape (2,)."""
        return np.array([np.nan if a is None else a for a in (self.start, self.end)])

    def held(self, nodes: int) -> FloatArray:
        """1 where a node is imposed, else 0, shape (N + 1,)."""
        result = np.zeros(nodes)
        result[list(self.positions)] = 1.0
        return result

    def impose(self, x: FloatArray) -> None:
        """Write the imposed positions into nodes x, shape (N + 1, 2)."""
        for node, position in self.positions.items():
            x[node] = position


def equal_steps(start: float, until: float, longest: float) -> list[tuple[float, float]]:
    """Ends and sizes [s] of equal steps, one at least, from a start to a later time [s]."""
    span = until - start
    count = max(int(np.ceil(span / longest - 1e-9)), 1)
    return [(start + span * (k + 1) / count, span / count) for k in range(count)]


class _Terms(NamedTuple):
    """Terms of a step that are the same for as long as the rod's properties are.

    Args:
        rod: the rod.
        elastic: of the edges and of the vertices: stiffness, and that times rest strain, both zero
            where the law of bending stands for them, and the stiffness of the dampers of Kelvin and
            Voigt [J].
        rest_turn: turning angle of the vertices at rest [rad], shape (N + 1,).
        weight: constant forces on the nodes [N], shape (N + 1, 2).
        law: law of bending, without a history.
        contact: contact with pegs and a wall.
        rubs: whether the board rubs.
        blown: whether any drag grows with the square of speed.
    """

    rod: DiscreteRod
    elastic: tuple[tuple[FloatArray, FloatArray], ...]
    rest_turn: FloatArray
    weight: FloatArray
    law: BendingLaw
    contact: Contact
    rubs: bool
    blown: bool

    @classmethod
    def of(cls, rod: DiscreteRod) -> Self:
        """The terms of a rod as it is now."""
        stiffness = rod.stiffness()
        dampers = (stiffness[0], rod.bending_stiffness / rod.vertex_lengths)
        return cls(
            rod=rod,
            elastic=(stiffness, rod.rest_offsets(), dampers),
            rest_turn=rod.rest_turn,
            weight=rod.weight,
            law=rod.bending_law(),
            contact=rod.contact(),
            rubs=bool(np.any(rod.friction > 0.0)),
            blown=bool(np.any(rod.quadratic_drag > 0.0)),
        )


class DiscreteRodSimulation:
    """The rod in time.

    Args:
        rod: properties of the rod.
        boundary: function that returns the imposed values at a time [s].
        x: nodes [m] at the start, shape (N + 1, 2), at rest.
        step: largest time step [s].
        time: start [s].
        change: function that returns the rod's properties at a time; None: they do not change.
    """

    def __init__(
        self,
        rod: DiscreteRod,
        boundary: Callable[[float], ImposedNodes],
        x: FloatArray,
        *,
        step: float = 1e-3,
        time: float = 0.0,
        change: Change | None = None,
    ) -> None:
        self.rod = rod
        self.change = change
        self.boundary = boundary
        self.step = step
        self.time = time
        self.x: FloatArray = np.array(x, dtype=np.float64)
        self.v: FloatArray = np.zeros_like(self.x)
        self._rest()

    def _rest(self) -> None:
        """Make the history that of a rod which has been at rest."""
        self.v = np.zeros_like(self.x)
        self._x_before = self.x.copy()
        self._v_before = np.zeros_like(self.x)
        self._used_step = 0.0
        clamps = self.boundary(self.time).clamps
        rod = self.rod_at(self.time)
        self._strains = rod_kernels.strains(self.x, rod.lengths, clamps)
        self._strains_before = self._strains
        self._law = rod.relaxed().bending_law()
        # What relaxes has flowed as far as the rod is bent beyond its set.
        self._flow = self._strains[1] - rod.rest_turn
        if self._law.active:
            # What yields on the way into the first shape stays; hysteresis begins with it.
            yield_to(self._law._replace(drag=np.zeros_like(rod.mass)), self._strains[1])
            self._flow = self._flow - self._law.plastic
        self._flow_before = self._flow
        self._anchor = self.x.copy()
        self._potential: PlanarPotential | None = None

    @property
    def potential(self) -> PlanarPotential:
        """The function that the last step has minimised; at rest, the one that an equilibrium
        minimises.
        """
        if self._potential is not None:
            return self._potential
        boundary, rod = self.boundary(self.time), self.rod_at(self.time)
        return rod.relaxed().potential(boundary.held(len(rod.mass)), boundary.clamps)

    def rod_at(self, time: float) -> DiscreteRod:
        """The rod at a time [s]."""
        return self.rod if self.change is None else self.change(self.rod, time)

    def settle(self) -> FloatArray:
        """Bring the rod to the stable equilibrium under the present boundary, downhill from here.

        It comes without friction and hysteresis, whose forces begin with the motion, and what may
        relax has done so. Bending beyond
        the yield is taken as one steady path from the straight rod to the first shape.

        Returns:
            The nodes [m], shape (N + 1, 2).

        Raises:
            SimulationError: no stable equilibrium was reached.
        """
        boundary = self.boundary(self.time)
        boundary.impose(self.x)
        # A rough curve has kinks and the wrong length here and there, at which a fine rod would
        # crumple. A coarse one, soft in stretch at first, buckles in long waves instead.
        full = self.rod_at(self.time)
        edges = len(full.lengths)
        for every in (max(edges // 20, 1), max(edges // 60, 1), 1):
            keep = np.union1d(np.arange(0, edges, every), [*boundary.positions, edges])
            rod = full.coarsened(keep)
            rod = replace(rod.relaxed(), hysteresis=0.0, friction_moment=0.0)
            where = {int(np.searchsorted(keep, i)): p for i, p in boundary.positions.items()}
            x = self.x[keep]
            softest = rod.softest_stretch() if every > 1 else 1.0
            for factor in np.geomspace(softest, 1.0, 3 if softest < 1.0 else 1):
                soft = replace(rod, stretch_stiffness=factor * rod.stretch_stiffness)
                x = _descend(soft, replace(boundary, positions=where), x)
            self.x = CubicSpline(rod.u, x)(full.u)
            boundary.impose(self.x)
        self._rest()
        return self.x

    def advance(self, until: float) -> FloatArray:
        """Step to a later time [s].

        Returns:
            The nodes [m], shape (N + 1, 2).

        Raises:
            SimulationError: a step did not converge.
        """
        constant = None if self.change else _Terms.of(self.rod)
        for time, h in equal_steps(self.time, until, self.step):
            self._advance_one(time, h, constant or _Terms.of(self.rod_at(time)))
        return self.x

    def _advance_one(self, time: float, h: float, terms: _Terms) -> None:
        rod = terms.rod
        # BDF2 for a step h after a step g: dy/dt = c0 y_new - c1 y + c2 y_before.
        g = self._used_step or h
        c0 = (2.0 * h + g) / (h * (h + g))
        c1 = (h + g) / (h * g)
        c2 = h / (g * (h + g))
        past_x = c2 * self._x_before - c1 * self.x
        past_v = c2 * self._v_before - c1 * self.v
        elastic, offsets, dampers = terms.elastic
        damped, held_back = [], []
        for k, f, d, now, before in zip(
            elastic, offsets, dampers, self._strains, self._strains_before, strict=True
        ):
            damped.append(k + d * rod.relaxation_time * c0)
            held_back.append(f - d * rod.relaxation_time * (c2 * before - c1 * now))
        # Creep `relaxing` times v beside the spring's angle: tau dv/dt = (turn - rest - set) - v.
        flowing = 1.0 + c0 * rod.lasting
        rest_turn = terms.rest_turn
        behind = rest_turn + rod.lasting * (c2 * self._flow_before - c1 * self._flow)
        crept = rod.relaxing / flowing
        law = terms.law
        if law.active:
            then = self._law
            law = law._replace(
                stiffness=(1.0 - crept) * law.stiffness,
                rest=rest_turn + crept / (1.0 - crept) * (rest_turn - behind),
                half=law.half / (1.0 - crept),
                plastic=then.plastic, drag_state=then.drag_state, turn=then.turn,
            )  # fmt: skip
        elif rod.relaxing:
            weaker = dampers[1] * crept
            damped[1], held_back[1] = damped[1] - weaker, held_back[1] - weaker * behind
        boundary = self.boundary(time)
        friction = no_friction()
        if terms.rubs:
            friction = Friction(True, rod.friction, self._anchor, SLACK)
        wind = no_wind()
        if terms.blown:
            there = np.gradient(self.x + h * self.v, rod.u, axis=0)
            along = there / np.linalg.norm(there, axis=1, keepdims=True)
            wind = Wind(True, rod.quadratic_drag, along, past_x, c0)
        self._potential = potential = PlanarPotential(
            held=boundary.held(len(rod.mass)),
            lengths=rod.lengths,
            clamps=boundary.clamps,
            stiffness=(damped[0], damped[1]),
            offsets=(held_back[0], held_back[1]),
            spring=rod.mass * c0**2 + rod.drag * c0,
            load=terms.weight
            - rod.mass[:, None] * (c0 * past_x + past_v)
            - rod.drag[:, None] * past_x,
            law=law,
            friction=friction,
            contact=terms.contact,
            wind=wind,
        )
        x = self.x + h * self.v
        boundary.impose(x)
        iterations = minimise(x, potential, 1e-10)
        if iterations < 0 or not np.all(np.isfinite(x)):
            raise SimulationError(f"the discrete rod's step at {time:.4f} s did not converge")
        self._x_before, self.x = self.x, x
        self._v_before, self.v = self.v, c0 * x + past_x
        self._strains_before = self._strains
        self._strains = rod_kernels.strains(x, rod.lengths, boundary.clamps)
        self._law, bent = law, self._strains[1] - behind
        if law.active:
            yield_to(law, self._strains[1])
            bent = bent - law.plastic
        self._flow_before, self._flow = self._flow, bent / flowing
        if friction.active:
            pull_anchors(friction, x)
        self._used_step = h
        self.time = time


def _descend(rod: DiscreteRod, boundary: ImposedNodes, x: FloatArray) -> FloatArray:
    """The equilibrium downhill of nodes x, which are imposed where they are held."""
    potential = rod.potential(boundary.held(len(rod.mass)), boundary.clamps)
    rounding = 1e-12 * float(np.sum(np.abs(rod.weight))) * rod.u[-1] + 1e-16
    settled = np.array(x)
    if not descend(settled, potential, rod.mass, rounding):
        raise SimulationError(
            "the rope found no stable equilibrium from its initial shape; give a shape that sags"
        )
    return settled
