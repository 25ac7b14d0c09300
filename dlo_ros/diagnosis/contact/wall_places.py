# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Straight walls that the DLO may have hit: beside all observed shapes, in the predicted ones' way.

No shape lies behind a wall: for each direction it is no nearer than the observed shapes reach (the
support function of their convex hull). No picture need show a DLO that bounces at the wall: it may
lie up to the way between two pictures behind that, but the predicted shapes must meet it before
they begin to be wrong.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.diagnosis.contact.peg_places import Sight
from dlo_ros.effects import Start
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference.parameter import value_of
from dlo_ros.inference.thresholds import SLACK
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

DIRECTIONS = 24
"""Directions of the normal that are looked at: within 15 degrees about the point that the DLO
touches, walls do alike."""
SPACING, MOST = 2e-3, 10
"""Distance over the length of the walls of one direction, and their largest number: what a DLO does
after an impact depends on millimetres."""
NORMAL, TURN = 0.1, 0.1
"""First steps where a wall is fitted: along its normal over that of a peg, since walls are tried as
near to each other, and of its direction [rad]."""
BEHIND = 0.01
"""Quantile of the pictures at which the observed shapes end: single ones are grossly wrong."""


def normal(angle: float) -> FloatArray:
    """Unit normal of a wall in x and z, shape (2,), from its angle against z [rad]."""
    return np.array([np.sin(angle), np.cos(angle)])


class TouchedWall(NamedTuple):
    """A straight wall through a point, which the axis of the DLO touches [m]."""

    x: float
    z: float
    angle: float  # of the normal against z [rad], see `StraightWall`

    def start(self, diameter: float) -> Start:
        """Where the fit of such a wall begins, for a DLO of a diameter [m]."""
        across = normal(self.angle)
        return StraightWall.touching(across, float(across @ self[:2]) - 0.5 * diameter)

    def steps(self) -> tuple[float, ...]:
        """First steps of a search: along its normal, in units of `stepped`, and of its angle."""
        return NORMAL, TURN

    def stepped(self, step: FloatArray, unit: float) -> TouchedWall:
        """The wall that is moved by a step (2,) along its normal, of a unit [m], and turned."""
        x, z = (self[:2] + unit * step[0] * normal(self.angle)).tolist()
        return TouchedWall(x, z, self.angle + float(step[1]))

    def fitted(self, settings: Settings) -> TouchedWall:
        """The wall of a model that contains one, where it is nearest to the origin."""
        offset, angle = (
            value_of(settings, StraightWall.parameter(key)) for key in ("offset", "angle")
        )
        x, z = ((offset + 0.5 * settings.rod.diameter) * normal(angle)).tolist()
        return TouchedWall(x, z, angle)

    def is_entered(self, view: Sight) -> bool:
        """Whether observed shapes reach behind the wall."""
        across = normal(self.angle)
        reached = tangent(view, self.angle)
        return float(across @ self[:2] - across @ reached[:2]) > SLACK


def walls(view: Sight) -> list[TouchedWall]:
    """Walls that no shape reaches behind but those that are predicted."""
    found: list[TouchedWall] = []
    for angle in np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False):
        touched = tangent(view, float(angle))
        across = normal(angle)
        edge = float(across @ touched[:2])
        room = edge - _farthest(view, across, edge)
        if room > -SLACK:
            count = int(np.clip((room + SLACK) / (SPACING * view.rod.length), 2, MOST))
            moves = (0.0, *np.linspace(SLACK, -room, count))
            found += [touched.stepped(np.array([x, 0.0]), 1.0) for x in moves]
    return found


def tangent(view: Sight, angle: float) -> TouchedWall:
    """The wall of one direction [rad] at which the observed shapes end."""
    points = np.concatenate(view.seen)  # (F, STATIONS, 2)
    coordinates = points @ normal(angle)
    nearest = coordinates.min(axis=1)
    picture = int(np.argsort(nearest)[int(BEHIND * len(nearest))])
    x, z = points[picture, np.argmin(coordinates[picture])].tolist()
    return TouchedWall(x, z, angle)


def _farthest(view: Sight, across: FloatArray, edge: float) -> float:
    """Smallest coordinate along its normal that a wall may have [m]; infinite where none may stand.

    In a recording whose prediction does not come near the wall something else is wrong, but not in
    those that hold most of the outlier frames.

    Args:
        edge: coordinate that the observed shapes reach [m].
    """
    result, explained = -np.inf, 0
    for seen, expected, wrong in zip(view.seen, view.expected, view.wrong, strict=True):
        if not wrong.any():
            continue
        met = float((expected[: int(np.argmax(wrong)) + 1] @ across).min())
        if met > edge + SLACK:
            continue
        explained += int(wrong.sum())
        moves = np.abs(np.diff((seen @ across).min(axis=1)))
        result = max(result, met, edge - float(moves.max(initial=0.0)))
    return result if 2 * explained >= view.count else np.inf
