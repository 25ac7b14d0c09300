# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Static equilibrium under imposed motion, and its sensitivities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError, SimulationError
from dlo_ros.rod.boundary.imposed_motion import NO_DIRECTION_TEXT, Boundary, Held
from dlo_ros.rod.elements.rod_tables import (
    DOF,
    ConstitutiveLaw,
    InternalVariables,
    Material,
    Reference,
    Surroundings,
)
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import moving_of, nothing_varies, state_of, true_command
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.sensitivity import sensitive_equilibrium
from dlo_ros.rod.sensitivity_parameters import compiled
from dlo_ros.rod.solve import equilibrium_continuation, newton_iteration
from dlo_ros.rod.solve.generalised_alpha import DONE, NO_DIRECTION
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray

TOLERANCE = 1e-9
# A rod that is elastic and touches nothing.
LINEAR = ConstitutiveLaw(0.0, np.inf, np.inf, 0.0, 0.0, 1.0, 0.0, np.inf)
FREE = Surroundings(
    0.0, 1.0, np.zeros((0, 3)), 0.0, np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0),
    np.zeros((0, 3)), 0.0, np.zeros((0, 3)),
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
    return boundary.held(true, stamp, state.q[[0, -1], 3], state.frames, model.body.lengthening)


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
    before, rest = (moving_of(state, true, flat=flat) for _ in range(2))
    time = (stamp - true.stamp) / NANOSECONDS
    asked = rod.system, rod.imposed, before, time, model.rate2, TOLERANCE, fresh, rest
    varying = None
    if parameters:
        varying = nothing_varies(state, len(parameters), flat=flat, rates=rod.rates)
        varying = rod.mark(varying)
        found = sensitive_equilibrium.settle(*asked, varying)
    else:
        found = equilibrium_continuation.settle(*asked)
    status, iterations, negative, buckled = found
    if status == NO_DIRECTION:
        raise CommandError(NO_DIRECTION_TEXT)
    if status != DONE:
        reachable(model, hold(model, boundary, state, command, stamp), boundary)
        raise SimulationError(
            f"no static equilibrium found after {iterations} iterations; check that the imposed "
            "ends can be reached and that stiffness and density are of a sensible size"
        )
    new = state_of(model, state, rest, stamp, varying, still=True)
    pins = (boundary.pin_rows @ new.q.ravel()).reshape(-1, 3)
    reachable(model, Held(new.q, pins, new.frames), boundary)  # stretch reaches any place
    if flat:
        negative = max(negative, _unstable_directions(model, boundary, new.q, new.reference))
    return Equilibrium(new, negative <= 0, iterations, buckled)


def _unstable_directions(
    model: RodModel, boundary: Boundary, q: FloatArray, reference: Reference
) -> int:
    """Negative eigenvalues of the stiffness in space."""
    matter = material_at_rest(model, NO_INTERNAL_VARIABLES)._replace(law=LINEAR, around=FREE)
    return int(
        newton_iteration.negative_modes(
            q,
            boundary.fixed,
            boundary.pins,
            model.rule,
            matter,
            reference,
            model.mass,
            model.spin,
            model.rate2,
        )
    )


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
    fixed = boundary.fixed.reshape(-1, DOF)
    points = [(model.basis.greville[k], held.target[k, :3]) for k in (0, -1) if fixed[k, 0]]
    points += list(zip(boundary.pin_abscissae, held.pins, strict=True))
    points.sort(key=lambda p: float(p[0]))
    # What may slip in through a grip meanwhile counts from the start.
    longer = model.body.lengthening + max(model.body.slip or 0.0, 0.0) / model.basis.length
    for (u0, r0), (u1, r1) in pairwise(points):
        apart, length = math.dist(r0, r1), longer * float(u1 - u0)
        if apart > 1.02 * length:
            raise SimulationError(
                f"the command holds two points {apart:.4g} m apart, but the DLO between them is "
                f"only {length:.4g} m long"
            )
