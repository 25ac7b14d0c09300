# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The necessary resolution: the simulation's own discretisation error, estimated and kept below a
bound.

A spline rod with the message's ten control points is millimetres off (numerics.md), so the
simulation has a basis of its own, whose knots contain the published ones.
"""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod.boundary.imposed_motion import Boundary, boundary_of
from dlo_ros.rod.first_guess import first_guess
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.state import State, refined
from dlo_ros.rod.statics import settle
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import DEGREE, FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

LARGEST = 300  # knot spans
RECHECK_RATIO = 1.5  # change of E/mu after which the resolution is judged anew
SHARP = 800  # knot spans at the ends are halved to at most L over this, where a grip gives
PROBES = 8  # instants of a motion at which the error is estimated


@dataclass(frozen=True)
class Resolution:
    """A number of knot spans and the shape error that it has.

    Args:
        spans: knot spans of the simulation's basis, before those at the ends are halved.
        error: mean distance to the solution with twice the spans, over L, at the worst instant.
    """

    spans: int
    error: float


def build(settings: RodSettings, command: Command, spans: int) -> tuple[RodModel, Boundary]:
    """Model and boundary conditions with the given number of knot spans, before some are halved."""
    rod, halvings = settings.rod, 0
    if settings.gives:
        spans = max(spans, 2)
        halvings = max(int(np.ceil(np.log2(SHARP / spans))), 1)
    basis = SplineBasis(spans + 2 * halvings + DEGREE, rod.length, halvings)
    boundary = boundary_of(command.names, basis, SplineBasis(rod.control_points, rod.length))
    model = RodModel(settings, basis, not boundary.clamped_start, not boundary.clamped_end)
    return model, boundary


def choose(
    settings: RodSettings, command: Command, shape: FloatArray, stamps: Sequence[int]
) -> Resolution:
    """The coarsest nested refinement of the published basis that keeps simulation.tolerance.

    The rod is led quasi-statically through the command. At each instant the equilibrium of the next
    finer resolution is looked for from that of the coarser one, so that both stand on the same
    branch where there are several: another branch is no discretisation error. Where a resolution
    finds no equilibrium, it is compared at the instants before: the motion itself may well be
    simulated.

    Args:
        shape: first control points, published basis, shape (n, 4).
        stamps: instants of interest [ns], growing; at most `PROBES` of them are used.

    Raises:
        SimulationError: the rod has no equilibrium at any resolution.
    """
    pieces = choosing(settings, command, shape, stamps)
    while True:
        try:
            next(pieces)
        except StopIteration as done:
            found: Resolution = done.value
            return found


def choosing(
    settings: RodSettings, command: Command, shape: FloatArray, stamps: Sequence[int]
) -> Generator[None, None, Resolution]:
    """The choice as of `choose`, in short pieces: it yields between equilibria."""
    rod = settings.rod
    published = SplineBasis(rod.control_points, rod.length)
    pick = np.unique(np.linspace(0, len(stamps) - 1, PROBES).round().astype(int))
    probes = [stamps[k] for k in pick]
    spans = published.spans
    u, weight = SplineBasis(4 * spans + DEGREE, rod.length).quadrature()
    failure: SimulationError | None = None
    coarse: _Path | None = None
    error = np.inf
    while spans <= LARGEST:
        try:
            fine = yield from _Path.led(settings, command, shape, probes, spans, coarse)
        except SimulationError as err:
            failure, coarse = err, None
            spans *= 2
            continue
        if coarse is not None:
            both = min(len(fine.states), len(coarse.states))
            apart = np.linalg.norm(fine.shapes(u)[:both] - coarse.shapes(u)[:both], axis=2) @ weight
            error = float(apart.max()) / rod.length**2
            if error <= settings.simulation.tolerance:
                return Resolution(spans // 2, error)
        coarse = fine
        spans *= 2
    if coarse is None:
        raise failure or SimulationError("no static equilibrium found at any resolution")
    spans //= 2
    LOG.warning(
        "the simulation keeps an error of %.2g L with %d control points; simulation.tolerance "
        "asks for %.2g", error, spans + DEGREE, settings.simulation.tolerance,
    )  # fmt: skip
    return Resolution(spans, error)


@dataclass(frozen=True)
class _Path:
    """Equilibria of one resolution at some instants."""

    model: RodModel
    states: tuple[State, ...]

    @classmethod
    def led(
        cls, settings: RodSettings, command: Command, shape: FloatArray, stamps: Sequence[int],
        spans: int, near: _Path | None,
    ) -> Generator[None, None, _Path]:  # fmt: skip
        """Equilibria, each from the one before or from a coarser path `near` at its instant, up to
        the first instant that has none.

        Raises:
            SimulationError: there is none at the first instant.
        """
        model, boundary = build(settings, command, spans)
        # What bending and friction remember has no counterpart in another basis.
        lift = near is not None and not any(model.remembers)
        yield
        states: list[State] = []
        for k, stamp in enumerate(stamps):
            if lift and near is not None:
                if k == len(near.states):
                    break
                state = refined(near.states[k], near.model, model)
            elif k == 0:
                state = first_guess(model, boundary, command, stamp, shape)
            try:
                state = settle(model, boundary, state, command, stamp, fresh=k == 0).state
            except SimulationError as err:
                if not states:
                    raise
                LOG.info("the resolution is judged without what follows: %s", err)
                break
            states.append(state)
            yield
        return cls(model, tuple(states))

    def shapes(self, u: FloatArray) -> FloatArray:
        """Points at material coordinates u [m], shape (instants, points, 3)."""
        return np.array([self.model.basis.evaluate(s.q[:, :3], u) for s in self.states])
