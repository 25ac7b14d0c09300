# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Equilibria and motion of the discrete elastic rod in space.

As `rod_simulation` for the plane: BDF2, each step a minimum of its potential. A step's unknowns are
the nodes and how far each edge spins about itself; directors follow the edges the short way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from dlo_ros.errors import SimulationError
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.rod_simulation import Change, equal_steps
from dlo_ros.synthesis.spatial_boundary import SpatialBoundary
from dlo_ros.synthesis.spatial_descent import (
    fallen,
    minimise,
    turn_until_none_is_left,
)
from dlo_ros.synthesis.spatial_energy import (
    Drag,
    EndFrames,
    Frames,
    SpatialPotential,
    evaluate,
    moved,
    strains,
)
from dlo_ros.synthesis.spatial_rod import (
    SpatialRod,
    angle_between,
    carried,
    cleaned,
    edges_of,
    first_director,
    laid,
    turned_about,
)
from dlo_ros.synthesis.spatial_rod_kernels import DOF


class SpatialSimulation:
    """The rod in time; arguments and methods are those of `rod_simulation.DiscreteRodSimulation`.

    Args:
        rod: properties of the rod.
        boundary: function that returns the imposed values at a time [s].
        x: nodes [m] at the start, shape (N + 1, 3), at rest and free of twist.
        step: largest time step [s].
        time: start [s].
        change: function that returns the rod's properties at a time; None: they do not change.
    """

    def __init__(
        self,
        rod: SpatialRod,
        boundary: Callable[[float], SpatialBoundary],
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
        self._lay(self.boundary(time))
        self._rest()

    def rod_at(self, time: float) -> SpatialRod:
        """The rod at a time [s]."""
        rod: DiscreteRod = self.rod if self.change is None else self.change(self.rod, time)
        assert isinstance(rod, SpatialRod)
        return rod

    def _lay(self, boundary: SpatialBoundary) -> None:
        """Directors without twist along the nodes, and clamps that hold them."""
        tangent, _ = edges_of(self.x)
        self.director = laid(tangent, boundary.directions[0], boundary.turns)
        self._turns = boundary.turns
        tangents, directors = np.full((2, 3), np.nan), np.full((2, 3), np.nan)
        for end, k in enumerate((0, -1)):
            direction = boundary.directions[end]
            if direction is not None:
                tangents[end] = direction
                directors[end] = carried(self.director[k], tangent[k], direction)
        self.ends = EndFrames(tangents, directors)
        self.turned = np.zeros(2)  # how far each clamp has turned about the rod [rad]

    def _rest(self) -> None:
        """Make the history that of a rod which has been at rest."""
        self.v = np.zeros_like(self.x)
        self._x_before, self._v_before = self.x.copy(), np.zeros_like(self.x)
        edges = len(self.director)
        self._spun, self._spin, self._spin_before = (np.zeros(edges) for _ in range(3))
        self._used_step = 0.0
        rod = self.rod_at(self.time)
        self._strains = strains(self._shape, rod.lengths, self.ends)
        self._strains_before = self._strains
        self._potential: SpatialPotential | None = None
        # What relaxes has flowed as far as the rod is bent.
        self._flow = self._flow_before = self._strains[1] - rod.rest_strain

    @property
    def _shape(self) -> Frames:
        return Frames(self.x, self.director)

    @property
    def last(self) -> tuple[Frames, FloatArray, SpatialPotential]:
        """The present shape, the spins that led to it, and the potential that they minimise."""
        if self._potential is not None:
            return self._shape, self._spun, self._potential
        rod, boundary = self.rod_at(self.time), self.boundary(self.time)
        return self._shape, self._spun, self._at_rest(rod.relaxed(), boundary)

    @property
    def twist(self) -> FloatArray:
        """Twist angle at the nodes against the twist-free frame [rad], shape (N + 1,).

        It begins with what the clamp at the start has turned about the rod.
        """
        steps = self._strains[1][:, 2]
        edges = self.turned[0] + np.cumsum(steps[:-1])
        inner = 0.5 * (edges[:-1] + edges[1:])
        return np.concatenate([[self.turned[0]], inner, [edges[-1] + steps[-1]]])

    def settle(self) -> FloatArray:
        """Bring the rod to the stable equilibrium under the present boundary, downhill from here.

        What may relax has done so. A clamped end takes the rod as it comes: without twist between
        both ends.

        Returns:
            The nodes [m], shape (N + 1, 3).

        Raises:
            SimulationError: no stable equilibrium was reached.
        """
        boundary = self.boundary(self.time)
        boundary.impose(self.x)
        full = self.rod_at(self.time)
        edges = len(full.lengths)
        # As in the plane: a coarse rod, soft in stretch at first, buckles in long waves.
        for every in (max(edges // 20, 1), max(edges // 60, 1), 1):
            keep = np.union1d(np.arange(0, edges, every), [*boundary.positions, edges])
            rod = full.coarsened(keep).relaxed()
            where = {int(np.searchsorted(keep, i)): p for i, p in boundary.positions.items()}
            local = replace(boundary, positions=where)
            coarse = SpatialSimulation(rod, partial(_always, local), self.x[keep], time=self.time)
            softest = rod.softest_stretch() if every > 1 else 1.0
            for factor in np.geomspace(softest, 1.0, 3 if softest < 1.0 else 1):
                coarse._fall(replace(rod, stretch_stiffness=factor * rod.stretch_stiffness), local)
            if every == 1:
                coarse._lie_as_laid(rod, local)
            self.x = CubicSpline(rod.u, coarse.x)(full.u)
            boundary.impose(self.x)
            self.director, self.ends = coarse.director, coarse.ends
        self._turns, self.turned = boundary.turns, np.zeros(2)
        self._rest()
        return self.x

    def _lie_as_laid(self, rod: SpatialRod, boundary: SpatialBoundary) -> None:
        """Come to rest without twist between both clamps, or, where no clamp holds the rod, with
        the first director of a rod that is laid in this direction.

        While a rod falls, its first edge changes its direction without spin.
        """

        def between() -> float:
            _, strain = strains(self._shape, rod.lengths, self.ends)
            return -float(np.sum(strain[:, 2]))

        def turn_end(angle: float) -> None:
            director = self.ends.director.copy()
            director[1:] = turned_about(director[1:], self.ends.tangent[1:], angle)
            self.ends = self.ends._replace(director=director)
            self._fall(rod, boundary)

        def from_first() -> float:
            tangent, _ = edges_of(self.x[:2])
            first = first_director(tangent[0])
            return float(angle_between(self.director[:1], first[None], tangent)[0])

        def turn(angle: float) -> None:
            self.director = turned_about(self.director, edges_of(self.x)[0], angle)
            self._fall(rod, boundary)

        if self.ends.held.all():
            turn_until_none_is_left(between, turn_end)
        elif not self.ends.held.any():
            turn_until_none_is_left(from_first, turn)

    def settle_here(self) -> FloatArray:
        """Come to rest under the present boundary and twist, downhill from here.

        Returns:
            The nodes [m], shape (N + 1, 3).

        Raises:
            SimulationError: no stable equilibrium was reached.
        """
        self._fall(self.rod_at(self.time).relaxed(), self.boundary(self.time))
        self._rest()
        return self.x

    @property
    def energy(self) -> float:
        """Elastic, potential and kinetic energy [J]."""
        rod = self.rod_at(self.time)
        potential = self._at_rest(rod, self.boundary(self.time))
        stored, _, _ = evaluate(self._shape, np.zeros(len(rod.lengths)), potential, slopes=False)
        moving = float(np.sum(rod.mass[:, None] * self.v**2))
        return stored + 0.5 * (moving + float(np.sum(rod.spin_inertia * self._spin**2)))

    def _at_rest(self, rod: SpatialRod, boundary: SpatialBoundary) -> SpatialPotential:
        """The function that an equilibrium minimises."""
        none = np.zeros(len(rod.lengths))
        return SpatialPotential(
            free=boundary.free(len(rod.mass)), lengths=rod.lengths, ends=self.ends,
            stretch=(rod.stretch_stiffness * rod.lengths, none), **_bending(rod, self.ends),
            spring=(np.zeros(len(rod.mass)), none), load=(rod.weight, none),
            contact=rod.contact(), drag=None,
        )  # fmt: skip

    def _fall(self, rod: SpatialRod, boundary: SpatialBoundary) -> None:
        """Follow the potential downhill to where the rod rests."""
        self.x, self.director = fallen(self._shape, self._at_rest(rod, boundary), rod)

    def advance(self, until: float) -> FloatArray:
        """Step to a later time [s].

        Returns:
            The nodes [m], shape (N + 1, 3).

        Raises:
            SimulationError: a step did not converge.
        """
        for time, h in equal_steps(self.time, until, self.step):
            self._advance_one(time, h)
        return self.x

    def _grip(self, boundary: SpatialBoundary) -> EndFrames:
        """The clamps at the end of a step; their turn about the rod is added up."""
        tangents, directors = self.ends.tangent.copy(), self.ends.director.copy()
        for end in range(2):
            direction, turn, before = (
                boundary.directions[end],
                boundary.turns[end],
                self._turns[end],
            )
            if direction is None:
                continue
            still = carried(directors[end], tangents[end], direction)
            if turn is not None and before is not None:
                held = (turn @ before.T @ directors[end])[None]
                held = cleaned(held, direction[None])
                self.turned[end] += angle_between(still[None], held, direction[None])[0]
                directors[end] = held[0]
            else:
                directors[end] = still
            tangents[end] = direction
        self._turns = boundary.turns
        return EndFrames(tangents, directors)

    def _advance_one(self, time: float, h: float) -> None:
        rod = self.rod_at(time)
        # BDF2 for a step h after a step g: dy/dt = c0 y_new - c1 y + c2 y_before.
        g = self._used_step or h
        c0, c1, c2 = (2.0 * h + g) / (h * (h + g)), (h + g) / (h * g), h / (g * (h + g))
        past_x = c2 * self._x_before - c1 * self.x
        past_v = c2 * self._v_before - c1 * self.v
        # Spins count from the present frames: it is 0 now and was -_spun a step ago.
        past_spin = -c2 * self._spun
        past_rate = c2 * self._spin_before - c1 * self._spin
        boundary = self.boundary(time)
        self.ends = self._grip(boundary)
        edge = rod.stretch_stiffness * rod.lengths
        lag = rod.relaxation_time
        pulled = edge * lag * (c2 * self._strains_before[0] - c1 * self._strains[0])
        bending = _bending(rod, self.ends)
        stiff = bending["stiffness"]
        history = c2 * self._strains_before[1] - c1 * self._strains[1]
        damped = bending["stiffness"] + lag * c0 * stiff
        held_back = bending["offset"] - lag * np.einsum("nab,nb->na", stiff, history)
        # Creep `relaxing` times w beside the spring's strain: tau dw/dt = (k - k0) - w.
        flowing = 1.0 + c0 * rod.lasting
        behind = rod.rest_strain + rod.lasting * (c2 * self._flow_before - c1 * self._flow)
        softening = bending["softening"]
        if rod.relaxing:
            crept = rod.relaxing / flowing
            weaker = stiff * crept
            weaker[:, 2] = 0.0  # bending alone relaxes
            damped, held_back = (
                damped - weaker,
                held_back - np.einsum("nab,nb->na", weaker, behind),
            )
            if softening is not None:
                spring, rest, half = softening
                rest = rest + crept / (1.0 - crept) * (rest - behind)
                softening = ((1.0 - crept) * spring, rest, half / (1.0 - crept))
        drag = None
        if np.any(rod.quadratic_drag > 0.0):
            there = np.gradient(self.x + h * self.v, rod.u, axis=0)
            along = there / np.linalg.norm(there, axis=1, keepdims=True)
            drag = Drag(rod.quadratic_drag, along, past_x, c0)
        potential = SpatialPotential(
            free=boundary.free(len(self.x)), lengths=rod.lengths, ends=self.ends,
            stretch=(edge * (1.0 + lag * c0), -pulled), stiffness=damped, offset=held_back,
            softening=softening,
            spring=(rod.mass * c0**2 + rod.drag * c0, rod.spin_inertia * c0**2),
            load=(
                rod.weight
                - rod.mass[:, None] * (c0 * past_x + past_v)
                - rod.drag[:, None] * past_x,
                -rod.spin_inertia * (c0 * past_spin + past_rate),
            ),
            contact=rod.contact(), drag=drag,
        )  # fmt: skip
        x = self.x + h * self.v
        boundary.impose(x)
        guess = np.zeros((len(x), DOF))
        guess[:, :3], guess[:-1, 3] = x - self.x, h * self._spin
        guess.reshape(-1)[~potential.free & (np.arange(guess.size) % DOF == DOF - 1)] = 0.0
        shape, spin = minimise(moved(self._shape, guess.ravel()), guess[:-1, 3], potential)
        if shape is None or not np.all(np.isfinite(shape.x)):
            raise SimulationError(f"the discrete rod's step at {time:.4f} s did not converge")
        self._x_before, self.x, self.director = self.x, shape.x, shape.director
        self._v_before, self.v = self.v, c0 * self.x + past_x
        self._spun, self._spin_before = spin, self._spin
        self._spin = c0 * spin + past_spin
        self._strains_before = self._strains
        self._strains = strains(shape, rod.lengths, self.ends)
        self._flow_before, self._flow = self._flow, (self._strains[1] - behind) / flowing
        self._used_step, self._potential = h, potential
        self.time = time


def _always(boundary: SpatialBoundary, _: float) -> SpatialBoundary:
    """The same at every time."""
    return boundary


def _bending(rod: SpatialRod, ends: EndFrames) -> dict[str, Any]:
    """Stiffness, offset and softening of a potential without damping; a free end has none."""
    stiffness = rod.vertex_stiffness()
    stiffness[[0, -1]] *= ends.held[:, None, None]
    rest = rod.rest_strain
    softening = None
    if np.isfinite(rod.half_curvature):
        softening = (stiffness, rest, rod.half_curvature * rod.vertex_lengths)
    return {
        "stiffness": stiffness,
        "offset": np.einsum("nab,nb->na", stiffness, rest),
        "softening": softening,
    }
