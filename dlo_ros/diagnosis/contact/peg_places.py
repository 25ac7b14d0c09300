# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Places where a peg may stand: beside observed shapes, and in the way of predicted ones.

No picture need show a DLO that swings against a peg and bounces: it may stand anywhere in the
predicted way between the last picture that is right and the first that is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.effects import Peg, Start
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.inference.parameter import value_of
from dlo_ros.inference.thresholds import SLACK
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

TRIED = 150
"""Places in a recording."""
STATIONS = 60
BENT = 0.5
"""Deviation of a station over the largest of its picture, beside which places are tried."""
LARGER = 0.3
"""First step of the logarithm of a peg's radius, where it is fitted."""
WAY = 3
"""Steps of the way from picture to picture: it is as long as pegs are wide."""
AFTER = 3
"""Pictures after a hit that are looked at."""


class TouchedPeg(Peg):
    """A peg that the DLO may have touched."""

    def start(self, _: float) -> Start:
        """Where the fit of such a peg begins, for a DLO of any diameter."""
        block = self._asdict()
        return Start(Obstacle.name, block, (), tuple(block), neutral=False, form="peg 1")

    def steps(self) -> tuple[float, ...]:
        """First steps of a search: of its place, in units of `stepped`, and of ln radius."""
        return 1.0, 1.0, LARGER

    def stepped(self, step: FloatArray, unit: float) -> TouchedPeg:
        """The peg that is moved by a step (3,), of a unit [m], and larger."""
        dx, dz = (unit * step[:2]).tolist()
        return TouchedPeg(self.x + dx, self.z + dz, self.radius * float(np.exp(step[2])))

    def fitted(self, settings: Settings) -> TouchedPeg:
        """The peg of a model that contains one."""
        numbers = (value_of(settings, Obstacle.parameter(key)) for key in self._fields)
        return TouchedPeg(*numbers)

    def is_entered(self, view: Sight) -> bool:
        """Whether an observed shape lies where the peg is.

        One that touches it may pass it by the rope's radius, where a tracker sees the side that the
        rope turns to it.
        """
        centre = np.array(self[:2])
        return self.radius - min(float(_distance(s, centre).min()) for s in view.seen) > SLACK


@dataclass(frozen=True)
class Place:
    """A peg that no observed shape enters and some observed shape touches.

    Args:
        left: number of outlier frames before the prediction has met the peg, and of frames that are
            right although it just has.
        met: number of outlier frames of those recordings in which the prediction meets it.
        touched: number of pictures in which the DLO touches the peg.
    """

    peg: TouchedPeg
    left: int
    met: int
    touched: int


@dataclass(frozen=True)
class Sight:
    """Recordings as true points in the board's plane [m], shape (F, STATIONS, 2) each.

    A peg stands on the board: where the camera shows the DLO elsewhere it shows the peg, too.

    Args:
        rod: length and diameter of the model.
        seen, expected: observed and predicted points.
        wrong: outlier frames, shape (F,).
    """

    rod: RodParameters
    seen: tuple[FloatArray, ...]
    expected: tuple[FloatArray, ...]
    wrong: tuple[np.ndarray, ...]

    @property
    def count(self) -> int:
        """Number of outlier frames."""
        return sum(int(w.sum()) for w in self.wrong)


def sight(
    settings: RodSettings, observed: Sequence[FloatArray], predicted: Sequence[FloatArray],
    wrong: Sequence[np.ndarray],
) -> Sight:  # fmt: skip
    """True points of the observed and predicted shapes of recordings.

    Args:
        settings: the model, of whose camera the true points are.
        observed, predicted: control points of each recording [m], shape (F, n, 3 or more).
        wrong: see `Sight`.
    """
    u = np.linspace(0.04, 1.0, STATIONS) * settings.rod.length
    compared = [o[-len(p) :] for o, p in zip(observed, predicted, strict=True)]
    seen, expected = (true_points(settings, shapes, u) for shapes in (compared, predicted))
    return Sight(settings.rod, seen, expected, tuple(wrong))


def true_points(
    settings: RodSettings, shapes: Sequence[FloatArray], u: FloatArray
) -> tuple[FloatArray, ...]:
    """Points of measured shapes as they lie on the board [m], shape (F, U, 2) each.

    Args:
        settings: the model, of whose camera they are.
        shapes: control points of each recording [m], shape (F, n, 3 or more).
        u: material coordinates of the points [m], shape (U,).
    """
    camera = MeasurementMap(settings)
    values = SplineBasis(settings.rod.control_points, settings.rod.length).matrix(u)
    return tuple(values @ camera.true(shape)[..., [0, 2]] for shape in shapes)


def places(view: Sight, radius: float) -> list[Place]:
    """Pegs of one radius [m] that may have been hit, the most likely first.

    The pictures that a peg explains begin where the prediction meets it first.
    """
    away = radius + 0.5 * view.rod.diameter
    ways = [_way(e) for e in view.expected]
    found = []
    for centre in (*_beside(view, away), *_between(view, ways, away)):
        peg = TouchedPeg(float(centre[0]), float(centre[1]), radius)
        if peg.is_entered(view):
            continue
        left, hit, touched = 0, 0, 0
        for s, way, wrong in zip(view.seen, ways, view.wrong, strict=True):
            met = np.flatnonzero(away - _distance(way, centre) > 0.5 * SLACK)
            first = int(met[0]) if len(met) else len(wrong)
            left += int(wrong[:first].sum() + (~wrong[first : first + AFTER]).sum())
            hit += int(wrong.sum()) if len(met) else 0
            touched += int(np.sum(_distance(s[first:], centre) - away < SLACK))
        found.append(Place(peg, left, hit, touched))
    return sorted(found, key=lambda p: (p.left, -p.touched))


def _distance(points: FloatArray, centre: FloatArray) -> FloatArray:
    """Distance of the nearest point of each picture, shape (F,)."""
    x, z = points[..., 0] - centre[0], points[..., 1] - centre[1]
    squares = x * x + z * z
    return np.asarray(np.sqrt(squares.min(axis=tuple(range(1, squares.ndim)))))


def _way(shapes: FloatArray) -> FloatArray:
    """Points on the way to each picture from the one before, shape (F, WAY, STATIONS, 2)."""
    before = np.concatenate([shapes[:1], shapes[:-1]])
    shares = np.arange(1, WAY + 1)[:, None, None] / WAY
    return np.asarray(before[:, None] + shares * (shapes - before)[:, None])


def _across(shapes: FloatArray) -> FloatArray:
    """Unit normals of shapes, shape (..., STATIONS, 2)."""
    along = np.gradient(shapes, axis=-2)
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
    return np.stack([-along[..., 1], along[..., 0]], axis=-1)


def _beside(view: Sight, away: float) -> Iterator[FloatArray]:
    """Points beside the observed shapes of outlier frames, on the side of the prediction."""
    for s, e, wrong in zip(view.seen, view.expected, view.wrong, strict=True):
        across = _across(s)
        miss = np.sum((e - s) * across, axis=2)
        most = np.abs(miss).max(axis=1, keepdims=True)
        there = (np.abs(miss) > BENT * most) & wrong[:, None]
        yield from _some(s[there] + (np.sign(miss[there]) * away)[:, None] * across[there])


def _between(view: Sight, ways: Sequence[FloatArray], away: float) -> Iterator[FloatArray]:
    """Points in the way that the prediction takes to the first outlier frame of each recording.

    Args:
        ways: the predicted ways, see `_way`.
    """
    for e, way, wrong in zip(view.expected, ways, view.wrong, strict=True):
        first = int(np.argmax(wrong))
        if first == 0:
            continue
        across = _across(way[first])
        side = np.sign(np.sum((e[first] - e[first - 1]) * across, axis=-1))
        yield from _some((way[first] + away * side[..., None] * across).reshape(-1, 2))


def _some(centres: FloatArray) -> FloatArray:
    """Every so many of some points, shape (K, 2), so that at most `TRIED` are left."""
    return centres[:: max(1, -(-len(centres) // TRIED))]


def apart(found: Sequence[TouchedPeg], distance: float, most: int) -> list[TouchedPeg]:
    """The first pegs, in their order, that keep a distance [m] from each other."""
    kept: list[TouchedPeg] = []
    for peg in found:
        if all(np.hypot(peg.x - k.x, peg.z - k.z) > distance for k in kept):
            kept.append(peg)
        if len(kept) == most:
            break
    return kept
