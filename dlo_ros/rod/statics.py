# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Static equilibrium under imposed motion, and its sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError, SimulationError
from dlo_ros.rod.boundary.imposed_motion import NO_DIRECTION_TEXT, Boundary, Held
from dlo_ros.rod.compiled_rod import compiled
from dlo_ros.rod.elements.rod_tables import (
    NO_SPRINGS,
    ConstitutiveLaw,
    InternalVariables,
    Material,
    Surroundings,
)
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import growth_at, rest_state_of, true_command, unchanged
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.sensitivity import sensitive_equilibrium
from dlo_ros.rod.sensitivity.sensitivity_state import SensitivityState
from dlo_ros.rod.solve.generalised_alpha import DONE, NO_DIRECTION
from dlo_ros.rod.state import State, Strains

TOLERANCE = 1e-9
# A rod that is elastic and touches nothing.
LINEAR = ConstitutiveLaw(0.0, np.zeros(0), np.zeros(0), 0.0, 0.0, 1.0, 0.0, np.zeros(0))
FREE = Surroundings(
    0.0, 1.0, np.zeros((0, 3)), 0.0, np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0),
    np.zeros((0, 3)), 0.0, NO_SPRINGS,
)  # fmt: skip
NO_INTERNAL_VARIABLES = InternalVariables(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 6)))


@dataclass(frozen=True)
class Equilibrium:
    """A rod at rest.

    Args:
        state: the state, without velocity.
        stable: whether it is a minimum of the energy, also against moves out of the plane.
        iterations: Newton iterations that it took.
        buckled: whether the DLO left an unstable equilibrium on the way, as one that is pushed
            together does; from a symmetric one it leaves to either side alike.
    """

    state: State
    stable: bool
    iterations: int
    buckled: bool = False


def hold(model: RodModel, boundary: Boundary, state: State, command: Command, stamp: int) -> Held:
    """Degrees of freedom that the command holds at a stamp, for a rod in a given state."""
    true = true_command(model, command)
    time = np.array([(stamp - command.stamp) / NANOSECONDS])
    longer = model.body.lengthening * float(growth_at(model, boundary, command, time)[0])
    return boundary.held(true, stamp, state.q[[0, -1], 3], state.frames, longer)


def settle(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamp: int,
    *,
    fresh: bool = False,
    parameters: Sequence[str] = (),
) -> Equilibrium:
    """Static equilibrium at a stamp, on the branch that leads there from the given state.

    Args:
        fresh: whether the DLO starts there: it has come without friction, and bent but once.
        command: command as it was given; the model's effects are applied to it.
        parameters: parameters whose sensitivities are wanted, see `sensitivity_parameters`.

    Raises:
        SimulationError: no equilibrium was found, for example because the imposed ends are
            further apart than the DLO is long.
        CommandError: the command gives an end no direction.
    """
    true = true_command(model, command)
    flat = in_plane(model, state, true, parameters)
    rod = compiled(model, boundary, command, parameters, flat=flat)
    rest, change = rest_state_of(state), unchanged(state, len(parameters))
    time = (stamp - true.stamp) / NANOSECONDS
    status, iterations, negative, buckled = sensitive_equilibrium.settle(
        rod.prepared, flat, time, model.rate2, TOLERANCE, fresh, rest, change
    )
    if status == NO_DIRECTION:
        raise CommandError(NO_DIRECTION_TEXT)
    if status != DONE:
        reachable(model, hold(model, boundary, state, command, stamp), boundary)
        raise SimulationError(
            f"no static equilibrium found after {iterations} iterations; check that the imposed "
            "ends can be reached and that stiffness and density are of a sensible size"
        )
    q, still = rest.q, np.zeros(rest.q.shape)
    strains = Strains(rest.stretch, rest.other)
    varying = None
    if parameters:
        none, c = np.zeros(change.q.shape), change
        varying = SensitivityState(
            rod.step, rod.moves, rod.rates, rod.kind, c.q, none, none, none, c.reference, c.frames,
            c.stretch, c.stretch, c.other, c.other, c.internal,
        )  # fmt: skip
    new = State(
        stamp, q, still, still, still, rest.reference, rest.frames, strains, strains,
        rest.internal, sensitivity=varying,
    )  # fmt: skip
    pins = boundary.pins_of(q)
    reachable(model, Held(q, pins, rest.frames), boundary)  # stretch reaches any place
    return Equilibrium(new, negative <= 0, iterations, buckled)


def material_at_rest(model: RodModel, internal: InternalVariables) -> Material:
    """The material at rest, for compiled code; what may relax has done so."""
    left = 1.0 - model.law.relaxing
    stiffness = model.stiffness._replace(bend=left * model.stiffness.bend)
    return Material(
        stiffness, left, stiffness.bend_rest, model.law, model.surroundings, internal, 0.0, 0.0
    )


def reachable(model: RodModel, held: Held, boundary: Boundary) -> None:
    """Refuse ends that are further apart than the DLO can span.

    Raises:
        SimulationError: with both distances.
    """
    points = boundary.held_points
    places = [(held.pins if pinned else held.target)[k, :3].tolist() for _, pinned, k in points]
    # Without arrays: they would take longer than a fifth of an equilibrium.
    for (a, b), length in zip(pairwise(places), _lengths_between(model, boundary), strict=True):
        _refuse_beyond(dist(a, b), length)


def reachable_through(
    model: RodModel, boundary: Boundary, command: Command, stamps: Sequence[int]
) -> None:
    """Refuse a motion that leads ends further apart than the DLO can span.

    Args:
        command: command with all effects applied.
        stamps: instants that are looked at [ns].

    Raises:
        SimulationError: with both distances, the first time that it happens.
    """
    places = [boundary.names.index(name) for name in boundary.holding]
    if len(places) > 1:
        times = (np.asarray(stamps, dtype=np.int64) - command.stamp) / NANOSECONDS
        steps = np.diff(command.positions_at(times)[:, places], axis=1)
        lengths = _lengths_between(model, boundary)
        for apart in np.linalg.norm(steps, axis=2).tolist():
            for each, length in zip(apart, lengths, strict=True):
                _refuse_beyond(each, length)


def _lengths_between(model: RodModel, boundary: Boundary) -> list[float]:
    """Lengths of the DLO between neighbouring held points, in its order [m].

    What may slip in through a grip meanwhile counts from the start.
    """
    longer = model.body.lengthening + max(model.body.slip or 0.0, 0.0) / model.basis.length
    return [longer * (b - a) for (a, *_), (b, *_) in pairwise(boundary.held_points)]


def _refuse_beyond(apart: float, length: float) -> None:
    """Refuse two held points that are further apart [m] than the DLO between them is long."""
    if apart > 1.02 * length:
        raise SimulationError(
            f"the command holds two points {apart:.4g} m apart, but the DLO between them is only "
            f"{length:.4g} m long"
        )
