# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A wall in other directions about the place that is touched, which tells little of its direction.

A wall is fitted before the causes beside it are known, from a direction that the errors without it
suggest. Simulations of an impact are rough, so that a fit does not turn far.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis.contact.wall_places import TouchedWall, normal
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.contact_trials import begun_in_place
from dlo_ros.diagnosis.explain.peg_size import curves
from dlo_ros.diagnosis.explain.trials import FIT_ITERATIONS, Trial, gains
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor, tells_apart
from dlo_ros.inference.parameter import value_of
from dlo_ros.inference.thresholds import SLACK
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

WALL = OFFSET, ANGLE = tuple(StraightWall.parameter(key) for key in ("offset", "angle"))
TURN = 0.25
"""Angle by which a wall is turned at once [rad]: within it, fits find the direction."""
MOST_TURNS = 4
"""Turns to one side at most: a wall that is turned further would meet the DLO elsewhere."""


def with_turned_wall(found: Search, recordings: Sequence[Recording]) -> Search:
    """A search's result with its wall in the direction that explains most, beside all it found.

    Where recordings do not tell two directions apart, tables lie level and walls stand upright.
    """
    wall = found.cause_of(StraightWall.name)
    if wall is None:
        return found
    best = found.at, wall
    for side in (TURN, -TURN):
        for _ in range(MOST_TURNS):
            there = _turned(best[0], wall, side, recordings)
            if there is None or not gains(there, best[0]):
                break
            best = there
        if best[1] is not wall:
            break
    at, proposal = best
    if proposal is wall:
        return found
    at = fit(at, recordings, FIT_ITERATIONS)
    gained = log_bayes_factor(at, found.at)
    LOG.info("the wall is turned by %+.2f rad: %+.1f", _angle(at) - _angle(found.at), gained)
    if _off_square(at) > _off_square(found.at) and not tells_apart(at, found.at):
        return found
    return found.exchanged(wall, (at, proposal))


def touched(at: Evaluation) -> FloatArray:
    """Mean of the places x, z of a DLO's axis [m] that touch its wall, or of those that are nearest
    to it where none does, shape (2,).
    """
    settings = at.model.settings
    points = curves(at)
    depth = points @ normal(_angle(at)) - value_of(settings, OFFSET) - 0.5 * settings.rod.diameter
    there: FloatArray = points[depth <= max(SLACK, float(depth.min()))].mean(axis=0)
    return there


def _turned(
    at: Evaluation, wall: Proposal, turn: float, recordings: Sequence[Recording]
) -> Trial | None:
    """The first steps of a fit with a wall that is turned [rad] about where it is touched."""
    x, z = touched(at).tolist()
    there = TouchedWall(x, z, _angle(at) + turn)
    return begun_in_place(at, wall, there.start(at.model.settings.rod.diameter), recordings)


def _angle(at: Evaluation) -> float:
    """Direction of the wall's normal against z [rad]."""
    return value_of(at.model.settings, ANGLE)


def _off_square(at: Evaluation) -> float:
    """Angle [rad] by which the wall is neither level nor upright."""
    square = 0.5 * np.pi
    return abs(_angle(at) - square * round(_angle(at) / square))
