# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulation of a recording in pieces of a few pictures, for callers that must not wait."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.identification.cooperative_tasks import SHORT, Pieces
from dlo_ros.inference.forecast import motion_of, predictions_at
from dlo_ros.inference.joint import Simulated, as_fine, field
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.rod.prediction import Prediction


def simulated(
    model: ParametricModel, recording: Recording, names: Sequence[str], at_once: int = 1
) -> Pieces[Simulated]:
    """Simulation of one recording as by `dlo_ros.inference.joint.simulate`, with the root mean
    square distance of each picture as ERR.

    Args:
        names: parameters of which derivatives are wanted.
        at_once: pictures in a piece of work.

    Raises:
        SimulationError: it cannot be simulated.
    """
    past, settings = recording.manipulation, as_fine(model.settings, recording)
    simulation = simulation_of(settings, motion_of(past), parameters=names, spans=recording.spans)
    yield from simulation.starting(past.observations[:2], past.observations[-1].stamp)
    stamps = [o.stamp for o in past.observations]
    if settings.simulation.start == "moving":
        stamps = stamps[1:]
    predictions: list[Prediction] = []
    for k in range(0, len(stamps), at_once):
        yield SHORT
        predictions += predictions_at(simulation, stamps[k : k + at_once])
    shapes = np.array([p.control_points for p in predictions])
    chain = dict(zip(model.names, model.chain(), strict=True))
    moves = [p.sensitivity for p in predictions if p.sensitivity is not None]
    found = field(
        recording, shapes, np.array(moves) if moves else None, np.array([chain[n] for n in names])
    )
    err = np.linalg.norm(found[0], axis=1)
    return Simulated(model, (found,), (err,), (shapes,), (recording.motion,))
