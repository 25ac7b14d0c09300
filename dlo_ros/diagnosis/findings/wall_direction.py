# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The std of a wall's direction, which a DLO that meets it in one point hardly shows.

Simulations of an impact are rough: a small turn of the wall about the point that is hit costs more
than a large one after which all else is fitted anew. No derivative tells of that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis.contact.wall_places import normal
from dlo_ros.diagnosis.explain.peg_size import curves
from dlo_ros.diagnosis.explain.profile_loss import refitted_loss
from dlo_ros.diagnosis.explain.turned_walls import ANGLE, OFFSET
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel

TURNS = (0.3, 0.1)
"""Angles by which a wall is turned either way [rad]."""


def wall_factors(at: Evaluation, recordings: Sequence[Recording]) -> dict[str, float]:
    """Factors, at least 1, by which the std of a wall's numbers must grow; none without a wall.

    A wall that explains the data as well when it is turned is known no better than that.

    Args:
        at: a fit; where it is not one to these recordings, nothing is told.
    """
    if not {OFFSET, ANGLE} <= set(at.model.names) or len(at.err) != len(recordings):
        return {}
    angle = at.model.index(ANGLE)
    std = float(np.sqrt(at.posterior.covariance[angle, angle]))
    for turn in TURNS:
        refits = [refitted_loss(at, turned(at, s * turn), recordings) for s in (1.0, -1.0)]
        best = min(refits, key=lambda r: r.loss)
        if best.does_as_well():
            factor = max(1.0, turn / best.stds_away() / std)
            # Its place along the normal changes with it, and is known no better.
            return {OFFSET: factor, ANGLE: factor}
    return {}


def turned(at: Evaluation, turn: float) -> ParametricModel:
    """The model with its wall turned about the point of the DLO that comes nearest to it, and held
    in that direction.

    Args:
        turn: angle [rad].
    """
    wall = at.model.settings.effects[StraightWall.name]
    assert isinstance(wall["offset"], float) and isinstance(wall["angle"], float)
    before, after = normal(wall["angle"]), normal(wall["angle"] + turn)
    points = curves(at)
    nearest = points[np.argmin(points @ before)]
    theta = at.model.theta()
    for name, value in (
        (OFFSET, wall["offset"] + float(nearest @ (after - before))),
        (ANGLE, wall["angle"] + turn),
    ):
        k = at.model.index(name)
        theta[k] = at.model.parameters[k].inner(value)
    model, k = at.model.at(theta), at.model.index(ANGLE)
    return model.with_prior([at.model.parameters[k].held(float(theta[k]))])
