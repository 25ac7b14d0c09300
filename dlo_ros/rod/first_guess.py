# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod near an observed shape, from where its first equilibrium is looked for."""

from __future__ import annotations

import logging
from dataclasses import replace

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod.boundary.imposed_motion import Boundary, boundary_of
from dlo_ros.rod.boundary.twist_free_frame import material_frame
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import true_command
from dlo_ros.rod.state import State, refined, rest_state
from dlo_ros.rod.statics import settle
from dlo_ros.spline import DEGREE, FloatArray, SplineBasis

LOG = logging.getLogger(__name__)


def first_guess(
    model: RodModel, boundary: Boundary, command: Command, stamp: int, shape: FloatArray
) -> State:
    """The rod at rest in an observed shape, or, where short spans need that, nearer to rest.

    The observed shape may be far from an equilibrium, so that the first steps overshoot and
    compress the DLO. It buckles in waves as short as its spans then: where those at its ends are
    short, far from the shape. So the equilibrium without short spans is found first.

    Args:
        command: command as it was given; the model's effects are applied to it.
        stamp: instant of the shape [ns].
        shape: control points, published basis, shape (n, 4).
    """
    if model.basis.halvings:
        even = SplineBasis(model.basis.even_spans + DEGREE, model.basis.length)
        coarse = replace(model, basis=even)
        held = boundary_of(boundary.names, even, boundary.published)
        try:
            near = first_guess(coarse, held, command, stamp, shape)
            rest = settle(coarse, held, near, command, stamp, fresh=True).state
            return refined(rest, coarse, model)
        except SimulationError as err:
            LOG.info("without short spans: %s", err)
    frame = material_frame(true_command(model, command), stamp)
    return rest_state(stamp, model.basis.projection(boundary.published) @ shape, model, frame)
