# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Straight walls that the DLO may have hit: beside all observed shapes, in the predicted ones' way.

No shape lies behind a wall, so that for each direction there is one place for it, up to the way
that the DLO may have gone between two pictures: where the observed shapes reach furthest (the
support function of their convex hull).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dlo_ros.diagnosis.contact.peg_places import Sight
from dlo_ros.effects import Start
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.spline import FloatArray

DIRECTIONS = 36
"""Directions of the normal that are looked at: what a wall does changes little within 10 degrees
about the point that the DLO touches."""
BETWEEN = (0.0, 0.5)
"""Shares of the largest motion between two pictures by which a wall may lie behind all shapes: a
DLO that bounces is seen before and after the impact."""
BEHIND = 0.01
"""Share of the pictures that may lie behind a wall: single ones are grossly wrong."""


class TouchedWall(NamedTuple):
    """A straight wall through a point, which the axis of the DLO touches [m]."""

    x: float
    z: float
    angle: float  # of the normal against z [rad], see `StraightWall`

    def start(self, diameter: float) -> Start:
        """Where the fit of such a wall begins, for a DLO of a diameter [m]."""
        normal = np.array([np.sin(self.angle), np.cos(self.angle)])
        return StraightWall.touching(normal, float(normal @ self[:2]) - 0.5 * diameter)

    def moved(self, along: float, turn: float) -> TouchedWall:
        """The wall that is moved along its normal [m] and turned about its point [rad]."""
        x, z = along * np.sin(self.angle), along * np.cos(self.angle)
        return TouchedWall(self.x + float(x), self.z + float(z), self.angle + turn)


def walls(view: Sight) -> list[TouchedWall]:
    """Walls that no shape reaches behind but those that are predicted."""
    found: list[TouchedWall] = []
    for angle in np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False):
        normal = np.array([np.sin(angle), np.cos(angle)])
        seen = [s @ normal for s in view.seen]  # (F, STATIONS) each
        nearest = np.concatenate([s.min(axis=1) for s in seen])
        rank = int(np.argsort(nearest)[int(BEHIND * len(nearest))])
        point = np.concatenate(view.seen)[rank, np.argmin(np.concatenate(seen)[rank])]
        edge = float(nearest[rank])
        room = edge - min(float((e @ normal).min()) for e in view.expected)
        apart = min(room, _between(seen))
        found += [
            TouchedWall(float(point[0]), float(point[1]), float(angle)).moved(-share * apart, 0.0)
            for share in BETWEEN
            if room > 0.0
        ]
    return found


def _between(seen: Sequence[FloatArray]) -> float:
    """Largest motion between two pictures of what comes nearest to a wall [m].

    Args:
        seen: coordinates along the wall's normal, shape (F, STATIONS) for each recording.
    """
    moves = [np.abs(np.diff(s.min(axis=1))) for s in seen if len(s) > 1]
    return float(np.concatenate(moves).max()) if moves else 0.0
