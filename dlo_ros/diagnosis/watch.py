# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Watches a live identification for what E, mu and damping cannot explain.

What neighbouring pictures have in common after the best E, mu and damping is held against the noise
that is new in every picture. Where it is as large, the effects of the registry are tried on the
same pictures by a linear test, piece by piece, so that nobody waits. It ranks suspects; what is
really the cause, and how large, is the business of `diagnose`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.diagnosis.candidates import starts
from dlo_ros.diagnosis.contact import glimpsed
from dlo_ros.diagnosis.model import names
from dlo_ros.diagnosis.pegs import sight
from dlo_ros.effects import Start
from dlo_ros.errors import DloError
from dlo_ros.identification.pieces import LONG, SHORT, Pieces, Worker
from dlo_ros.identification.statement import rounded
from dlo_ros.identification.uncertainty import discrepancy
from dlo_ros.inference.forecast import Forecast, Manipulation, motion_of, whitening
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.parameters import Settings
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.tangents import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

WINDOW = 90  # pictures that are looked at together
FEWEST = 30
EVERY = 15  # pictures between two looks
LOOKS = 2  # one after the other that must find something, before the window is full
LIMIT = 0.9  # of the noise of one picture, as `diagnose` has it: ERR is then a third too large
AT_ONCE = 3  # pictures in a piece of work
AT_MOST = 4  # beginnings of an effect without a useful derivative where it does nothing
NAMED = 3  # suspects that are told of
WORTH = 0.1  # share of what is left over that a suspect must explain
ASTRAY = 0.2  # of the picture that is off most, from which one may come after a hit
RIDGE = 1e-9  # of a column's own size, so that columns that say the same do no harm


@dataclass(frozen=True)
class Leftover:
    """What is left over in pictures when E, mu and damping have done their best.

    Args:
        common: root mean square distance along the DLO that neighbouring pictures share [m].
        noise: likewise, that is new in every picture [m].
        own: error that the simulation and the theory may have themselves [m].
    """

    common: float
    noise: float
    own: float

    @property
    def structured(self) -> bool:
        """Whether it is more than noise."""
        return self.common > LIMIT * math.hypot(self.noise, self.own)


@dataclass(frozen=True)
class Suspicion:
    """The model misses something.

    Args:
        leftover: how much.
        suspects: names of effects with the share of it that each would explain, best first; empty
            where none was tried yet, or none explains any of it.
    """

    leftover: Leftover
    suspects: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        apart = rounded(1e3 * self.leftover.common)
        times = self.leftover.common / self.leftover.noise
        seen = (
            f"the shapes differ from the model by {apart} mm that E and mu cannot remove "
            f"({rounded(times)} times the noise)"
        )
        if not self.suspects:
            return f"{seen}; record them and run `dlo_ros diagnose`"
        names = ", ".join(f"{name} ({100.0 * share:.0f} %)" for name, share in self.suspects)
        return f"{seen}; suspects: {names}; record them and run `dlo_ros diagnose`"


class Watch:
    """Watches the residuals of a live identification; read `suspicion` whenever."""

    def __init__(self) -> None:
        self.suspicion: Suspicion | None = None
        self._worker = Worker(-1.0, lambda: 0.0)  # a piece a turn
        self._looked, self._found, self._tried = 0, 0, 0
        self._task: tuple[Manipulation, Settings, int, Leftover] | None = None

    @property
    def busy(self) -> bool:
        """Whether `proceed` has something to do."""
        return self._task is not None

    def due(self, count: int) -> bool:
        """Whether it is time for a look, now that there are so many pictures."""
        return count >= FEWEST and not self._looked <= count < self._looked + EVERY

    def look(self, found: Forecast, settings: Settings, past: Manipulation | None) -> None:
        """Look at the residuals of a model that has converged; quick.

        Args:
            found: the pictures since the start with derivatives by `MATERIAL`.
            settings: the parameters that it was made with.
            past: the same pictures with what was imposed; None where their beginning is gone.
        """
        count = len(found.stamps)
        if not self.due(count):
            return
        self._looked = count
        leftover = left_over(found, settings)
        self._found = self._found + 1 if leftover.structured else 0
        if not self._found:
            self.suspicion = None
        if self._found < (LOOKS if count < WINDOW else 1) or self.busy:
            return
        suspects = self.suspicion.suspects if self.suspicion else ()
        self.suspicion = Suspicion(leftover, suspects)
        # More pictures may tell more, but not each of them.
        if past is not None and not self._tried <= count < 2 * self._tried:
            self._tried = count
            self._task = past, settings, found.spans, leftover

    def proceed(self) -> None:
        """Do a piece of the linear test."""
        if self._task is None:
            return
        task = self._task
        self._worker.turn(0.0, lambda: self._test(*task))
        if not self._worker.busy:
            self._task = None

    def _test(
        self, past: Manipulation, settings: Settings, spans: int, leftover: Leftover
    ) -> Pieces[None]:
        try:
            suspects = yield from suspected(past, settings, spans)
        except DloError as err:
            LOG.warning("the suspects cannot be ranked: %s", err)
            return
        if self.suspicion is not None:
            self.suspicion = Suspicion(leftover, suspects)


def left_over(found: Forecast, settings: Settings) -> Leftover:
    """What the last pictures of a forecast with derivatives leave over.

    Differences in time of second and fourth order tell the noise, the product of neighbours what
    they have in common.
    """
    assert found.derivative is not None
    field = found.residual[-WINDOW:].reshape(min(len(found.residual), WINDOW), -1)
    columns = found.derivative[-WINDOW:].transpose(0, 2, 3, 1).reshape(field.size, -1)
    field = _without(field.ravel(), columns).reshape(field.shape)
    noise = []
    for weights in ((1.0, -2.0, 1.0), (1.0, -4.0, 6.0, -4.0, 1.0)):
        size = len(field) - len(weights) + 1
        gap = sum(w * field[k : k + size] for k, w in enumerate(weights))
        power = np.sum(np.asarray(gap) ** 2, axis=1) / sum(w**2 for w in weights)
        noise.append(float(np.median(power)))
    common = float(np.mean(np.sum(field[1:] * field[:-1], axis=1)))
    own = discrepancy(found, settings)
    return Leftover(math.sqrt(max(common, 0.0)), math.sqrt(min(noise)), own)


def _without(field: FloatArray, columns: FloatArray) -> FloatArray:
    """A field (N,) without what columns (N, P) can explain of it."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0.0, size, 1.0)
    lhs = scaled.T @ scaled + RIDGE * np.eye(columns.shape[1])
    return np.asarray(field - scaled @ np.linalg.solve(lhs, scaled.T @ field))


def suspected(
    past: Manipulation, settings: Settings, spans: int
) -> Pieces[tuple[tuple[str, float], ...]]:
    """Effects by the share of what is left over that each would explain, best first.

    Args:
        past: what was imposed and seen, from the start of the simulation on.
        settings: with the estimated parameters.
        spans: knot spans of the simulation.
    """
    plain = yield from _moved(past, settings, MATERIAL, spans)
    observed = np.array([o.control_points[:, :3] for o in past.observations])[-len(plain[0]) :]
    view = scene(settings, imposed_names([past]), [plain[0]])
    white = whitening(settings.rod.control_points, settings.rod.length)
    field = white @ (observed - plain[0])
    size = np.linalg.norm(field, axis=(1, 2))
    yield LONG
    pegs = glimpsed(sight(settings.rod, [observed], [plain[0]], [size > ASTRAY * size.max()]))
    residual = field.ravel()
    own = _columns(white, plain[1])
    before = float(np.sum(_without(residual, own) ** 2))
    shares: dict[str, float] = {}
    present = tuple(settings.effects)
    begun = [*starts(view, present), *(p for p in pegs if p.effect not in present)]
    for sheet in _sheets(begun):
        try:
            moves = yield from _directions(past, settings, spans, sheet, plain[0])
        except DloError as err:
            LOG.info("%s: %s", ", ".join(s.effect for s in sheet), err)
            continue
        for start, move in zip(sheet, moves, strict=True):
            columns = np.hstack([own, _columns(white, move)])
            share = 1.0 - float(np.sum(_without(residual, columns) ** 2)) / before
            # Every further number explains a little by itself.
            share -= 2.0 * (len(move) - 1) / len(past.observations)
            shares[start.effect] = max(shares.get(start.effect, 0.0), share)
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    return tuple((name, share) for name, share in ranked[:NAMED] if share > WORTH)


def _columns(white: FloatArray, moves: FloatArray) -> FloatArray:
    """Derivatives (P, F, n, 3) of control points as columns (F n 3, P)."""
    return np.asarray((white @ moves).reshape(len(moves), -1).T)


def _sheets(all_starts: Sequence[Start]) -> list[list[Start]]:
    """Starts that can be tried in one simulation: linear ones of different effects."""
    sheets: list[list[Start]] = []
    count: dict[str, int] = {}
    for start in all_starts:
        k = count.get(start.effect, 0)
        count[start.effect] = k + 1
        if not start.neutral:
            if k < AT_MOST:
                sheets.append([start])
            continue
        if k == len([s for s in sheets if s[0].neutral]):
            sheets.insert(k, [])
        [s for s in sheets if not s or s[0].neutral][k].append(start)
    return sheets


def _directions(
    past: Manipulation, settings: Settings, spans: int, sheet: Sequence[Start], plain: FloatArray
) -> Pieces[list[FloatArray]]:
    """How each start of a sheet would move the shapes, each (k, F, n, 3)."""
    extended = settings.with_effects(
        {**settings.effects, **{start.effect: dict(start.block) for start in sheet}}
    )
    if not sheet[0].neutral:
        shapes, _ = yield from _moved(past, extended, (), spans)
        return [(shapes - plain)[None]]
    wanted = [names(start.effect, start.block, start.screened) for start in sheet]
    _, moves = yield from _moved(past, extended, [n for group in wanted for n in group], spans)
    cuts = np.cumsum([len(group) for group in wanted])[:-1]
    return np.split(moves, cuts)


def _moved(
    past: Manipulation, settings: Settings, parameters: Sequence[str], spans: int
) -> Pieces[tuple[FloatArray, FloatArray]]:
    """Simulated shapes (F, n, 3) and their derivatives (P, F, n, 3)."""
    simulation = Simulation(settings, motion_of(past), parameters=parameters, spans=spans)
    for _ in simulation.starting(past.observations[:2], past.observations[-1].stamp):
        yield SHORT
    stamps = [o.stamp for o in past.observations]
    if settings.simulation.start == "moving":
        stamps = stamps[1:]
    predictions = [simulation.prediction()] if stamps[0] == simulation.stamp else []
    later = stamps[len(predictions) :]
    for k in range(0, len(later), AT_ONCE):
        yield SHORT
        predictions += simulation.advance_through(later[k : k + AT_ONCE])
    shapes = np.array([p.control_points[:, :3] for p in predictions])
    none = np.zeros((0, *shapes.shape[1:]))
    moves = [none if p.sensitivity is None else p.sensitivity for p in predictions]
    return shapes, np.array(moves).swapaxes(0, 1)
