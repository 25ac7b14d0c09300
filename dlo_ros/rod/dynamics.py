# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Motion of the rod: generalised-alpha steps with Kelvin-Voigt damping and error control.

The equations M q'' + C q' + elastic forces = loads (paper, eq. (9)) hold exactly at the end of
every step; the generalised-alpha method relates q'' to an auxiliary acceleration. The strain rate
is a second-order backward difference, so a step minimises an incremental potential: the elastic
energy with another stiffness and other rest strains. The compiled steps are in `batch.single_rod`
for rods that vector lanes know, with or without sensitivities, and in `adaptive_integration` for
all others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod.batch.rod_in_lanes import RodInLanes
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.compiled_rod import Compiled, compiled
from dlo_ros.rod.integration import Track, integrate
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.motion_validation import in_order
from dlo_ros.rod.packing import moving_of, state_of, true_command
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.sensitivity.sensitivity_state import LINEAR
from dlo_ros.rod.solve.generalised_alpha import starting_acceleration
from dlo_ros.rod.state import State


def advance(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamp: int,
    parameters: Sequence[str] = (),
) -> State:
    """Integrate to one stamp [ns]; see `follow`."""
    return follow(model, boundary, state, command, [stamp], parameters).state


def follow(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamps: Sequence[int],
    parameters: Sequence[str] = (),
    *,
    speeds: bool = False,
    stepwise: bool = False,
) -> Track:
    """Integrate through stamps with steps that keep the error within simulation.tolerance.

    Args:
        stamps: [ns], growing, none before the state's.
        command: command as it was given; the model's effects are applied to it.
        parameters: parameters whose sensitivities are wanted, see `sensitivity_parameters`; those
            of the state are propagated.
        speeds: whether the velocities at the stamps are wanted.
        stepwise: whether every stamp ends a step, as accelerations from velocities need; else the
            motion is interpolated within longer steps.

    Raises:
        InputError: stamps do not grow from the state's on.
        SimulationError: a step does not converge however small it is.
        CommandError: the command gives an end no direction.
    """
    in_order(state.stamp, stamps)
    true = true_command(model, command)
    flat = in_plane(model, state, true, parameters)
    rod = rod_in_lanes(model, boundary, command, parameters, flat=flat)
    track = (
        None if rod is None else rod.follow(state, true, stamps, speeds=speeds, stepwise=stepwise)
    )
    if track is not None:
        return track
    try:
        return integrate(
            model, boundary, state, command, stamps, parameters, flat=flat, stepwise=stepwise
        )
    except ZeroDivisionError as err:  # coinciding points
        raise SimulationError(str(err)) from err


def in_lanes(model: RodModel, boundary: Boundary) -> bool:
    """Whether the vectorised engine knows this rod; for one alone it is the fastest, too."""
    return model.plain and not len(boundary.pins) and not model.stiffness.bend[:, 2].any()


def rod_in_lanes(
    model: RodModel, boundary: Boundary, command: Command, parameters: Sequence[str], *, flat: bool
) -> RodInLanes | None:
    """The rod for the vectorised engine, kept; None where that does not know it.

    Args:
        command, parameters: see `follow`.
        flat: whether the rod stays in the plane y = 0.
    """
    if not in_lanes(model, boundary):
        return None
    rod, kept = None, model.__dict__
    if parameters:
        rod = compiled(model, boundary, command, parameters, flat=flat)
        if rod.kind != LINEAR or rod.coupled:
            return None
        kept = rod.__dict__
    cache: dict[tuple[Boundary, bool], RodInLanes] = kept.setdefault("_lanes", {})
    if (boundary, flat) not in cache:
        cache[boundary, flat] = RodInLanes(model, boundary, rod, flat=flat)
    return cache[boundary, flat]


def with_consistent_acceleration(
    model: RodModel, boundary: Boundary, state: State, command: Command
) -> State:
    """The state with the acceleration that its forces cause, imposed points not accelerated."""
    true = true_command(model, command)
    flat = in_plane(model, state, true)
    rod = compiled(model, boundary, command, (), flat=flat)
    return accelerated(model, rod, state, true, flat=flat)


def accelerated(
    model: RodModel, rod: Compiled, state: State, command: Command, variant: int = 0, *, flat: bool
) -> State:
    """`with_consistent_acceleration` of one of the variants of a rod.

    Args:
        command: command with all effects applied.
        variant: number of the variant, see `System`; default: the rod itself.
        flat: whether the rod is compiled in its planar form.
    """
    moving = moving_of(state, command, flat=flat)
    start = np.asarray(starting_acceleration(rod.prepared, np.int64(variant), moving))
    moving = moving._replace(acceleration=start, auxiliary=start)
    return state_of(model, state, moving, state.stamp, state.sensitivity)
