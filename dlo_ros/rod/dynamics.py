# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Motion of the rod: generalised-alpha steps with Kelvin-Voigt damping and error control.

The equations M q'' + C q' + elastic forces = loads (paper, eq. (9)) hold exactly at the end of
every step; the generalised-alpha method relates q'' to an auxiliary acceleration. The strain rate
is a second-order backward difference, so a step minimises an incremental potential: the elastic
energy with another stiffness and other rest strains. The compiled steps are in
`batch.simd_integration` for rods that vector lanes know, one or many, with or without
sensitivities, and in `adaptive_integration` for all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod.batch.layout import Layout
from dlo_ros.rod.batch.parameter_sets import ParameterSets
from dlo_ros.rod.batch.sensitivity_lanes import SensitivityLanes
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.integration import Track, integrate
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import moving_of, state_of, true_command, varying_in_space
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.sensitivity.sensitivity_state import LINEAR
from dlo_ros.rod.sensitivity_parameters import Compiled, compiled
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
) -> Track:
    """Integrate through stamps with steps that keep the error within simulation.tolerance.

    Args:
        stamps: [ns], growing, none before the state's.
        command: command as it was given; the model's effects are applied to it.
        parameters: parameters whose sensitivities are wanted, see `sensitivity_parameters`; those
            of the state are propagated.
        speeds: whether the velocities at the stamps are wanted.

    Raises:
        SimulationError: a step does not converge however small it is.
        CommandError: the command gives an end no direction.
    """
    true = true_command(model, command)
    flat = in_plane(model, state, true, parameters)
    if in_lanes(model, boundary):
        track = _in_lanes(model, boundary, state, command, stamps, parameters, flat, speeds)
        if track is not None:
            return track
    return integrate(model, boundary, state, command, stamps, parameters, flat=flat)


def _in_lanes(
    model: RodModel,
    boundary: Boundary,
    state: State,
    command: Command,
    stamps: Sequence[int],
    parameters: Sequence[str],
    flat: bool,
    speeds: bool,
) -> Track | None:
    """The motion by the vectorised engine; None where it does not know the sensitivities.

    Args:
        flat: whether the rod stays in the plane y = 0.
        speeds: whether the velocities are wanted; with parameters they are given anyway.
        The others: see `follow`.

    Raises:
        SimulationError, CommandError: see `follow`.
    """
    sets, lanes = sets_of(model, boundary), None
    if parameters:
        rod = compiled(model, boundary, command, parameters, flat=flat)
        if rod.kind != LINEAR or rod.rates.stiffness.bend[:, :, 2].any():
            return None
        lanes = sensitivities_of(model, rod, sets.layout(flat=flat))
        lanes.begin(state)
    tracks = sets.follow(
        [state], command, stamps, flat=flat, speeds=speeds or bool(parameters), sensitivities=lanes
    )
    if tracks.failures:
        raise SimulationError(tracks.failures[0])
    shapes, end = tracks.shapes[0], tracks.state(0)
    velocities = tracks.speeds[0] if tracks.speeds.shape[1] else np.zeros_like(shapes)
    twists = np.zeros((0, 0)) if flat else tracks.twists[0]
    if lanes is None or tracks.derivatives is None:
        none = np.zeros((len(stamps), 0, *state.q.shape))
        return Track(end, shapes, velocities, twists, none, tracks.steps[0])
    if 0 in tracks.ends.alone:  # the scalar engine has done it, without sensitivities
        return None
    end = replace(end, sensitivity=varying_in_space(lanes.end(), end.q))
    return Track(end, shapes, velocities, twists, tracks.derivatives, tracks.steps[0])


def in_lanes(model: RodModel, boundary: Boundary) -> bool:
    """Whether the vectorised engine knows this rod; for one alone it is the fastest, too."""
    return model.plain and not len(boundary.pins) and not model.stiffness.bend[:, 2].any()


def sets_of(model: RodModel, boundary: Boundary) -> ParameterSets:
    """A rod as the only one of its sets, kept with the model."""
    cache: dict[Boundary, ParameterSets] = model.__dict__.setdefault("_alone", {})
    if boundary not in cache:
        cache[boundary] = ParameterSets([model], boundary)
    return cache[boundary]


def sensitivities_of(model: RodModel, rod: Compiled, layout: Layout) -> SensitivityLanes:
    """The sensitivities of a rod in lanes, kept with the rod."""
    kept: list[SensitivityLanes] = rod.__dict__.setdefault("_lanes", [])
    if not kept:
        kept.append(SensitivityLanes(model, rod, layout))
    return kept[0]


def with_consistent_acceleration(
    model: RodModel, boundary: Boundary, state: State, command: Command
) -> State:
    """The state with the acceleration that its forces cause, imposed points not accelerated."""
    true = true_command(model, command)
    flat = in_plane(model, state, true)
    moving = moving_of(state, true, flat=flat)
    rod = compiled(model, boundary, command, (), flat=flat)
    start = np.asarray(starting_acceleration(rod.system, rod.imposed, moving))
    moving = moving._replace(acceleration=start, auxiliary=start)
    return state_of(model, state, moving, state.stamp, state.sensitivity)
