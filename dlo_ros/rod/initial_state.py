# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The initial state of a simulation: an equilibrium, or the observed shape."""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

from dlo_ros.errors import InputError
from dlo_ros.observation import Observation
from dlo_ros.rod.boundary.command_timeline import CommandTimeline
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.compiled_rod import compiled
from dlo_ros.rod.first_guess import first_guess
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.motion_validation import possible
from dlo_ros.rod.observed_start import FirstShapes, observed_start
from dlo_ros.rod.packing import true_command
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.state import State
from dlo_ros.rod.statics import settle
from dlo_ros.rod_settings import RodSettings

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class InitialState:
    """The state that a simulation starts from.

    Args:
        state: state of the rod.
        stable: whether the equilibrium is stable; true where it starts from none.
        flat: whether it is an equilibrium in the plane y = 0.
    """

    state: State
    stable: bool = True
    flat: bool = False


def beginning(
    settings: RodSettings,
    timeline: CommandTimeline,
    measurement: MeasurementMap,
    observations: Sequence[Observation],
) -> FirstShapes:
    """The true beginning, from the first observed shapes; the timeline learns when it was.

    Raises:
        InputError: too few observations, a wrong number of control points, no command.
        ParameterError: effects leave no DLO.
    """
    mode = settings.simulation.start
    needed = 2 if mode == "moving" else 1
    if len(observations) < needed:
        shapes = "2 observed shapes" if needed > 1 else "an observed shape"
        raise InputError(f"simulation.start '{mode}' needs {shapes}")
    n = settings.rod.control_points
    for observation in observations[:needed]:
        if len(observation.control_points) != n:
            raise InputError(
                f"the observed spline has {len(observation.control_points)} control points; "
                f"rod.control_points is {n}"
            )
    possible(settings)
    seen = [replace(o, stamp=o.stamp - measurement.later) for o in observations[:needed]]
    timeline.began = seen[0].stamp
    command = timeline.at(seen[-1].stamp, slips=settings.slips)
    return FirstShapes(tuple(seen), command, measurement.true(seen[-1].control_points))


def initial_state(
    model: RodModel,
    boundary: Boundary,
    begin: FirstShapes,
    measurement: MeasurementMap,
    parameters: Sequence[str],
) -> Generator[None, None, InitialState]:
    """The initial state as simulation.start says, in short pieces.

    Args:
        parameters: parameters whose sensitivities are wanted, see `sensitivity_parameters`.

    Raises:
        InputError: the first two observed shapes have the same stamp.
        SimulationError: no equilibrium, or imposed ends out of reach.
    """
    settings, command = model.settings, begin.command
    if settings.simulation.start != "equilibrium":
        yield
        return InitialState(observed_start(model, boundary, begin, measurement, parameters))
    near = first_guess(model, boundary, command, begin.stamp, begin.shape)
    yield
    flat = in_plane(model, near, true_command(model, command), parameters)
    compiled(model, boundary, command, parameters, flat=flat)  # is kept
    yield
    found = settle(model, boundary, near, command, begin.stamp, fresh=True, parameters=parameters)
    if found.buckled:
        LOG.info(
            "the DLO buckles on its way to its first equilibrium; where nothing decides "
            "between two sides, its weight or the camera's first shape should"
        )
    return InitialState(found.state, found.stable, flat)
