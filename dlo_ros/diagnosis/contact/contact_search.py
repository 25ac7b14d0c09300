# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The search for a peg or wall that a DLO may have hit, shown by outlier frames alone.

It starts from the fit to undisturbed pictures (`undisturbed`) and the places that no
shape enters (`peg_places`, `wall_places`). Only the disturbed recordings are simulated, with all
other numbers as they are.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize

from dlo_ros.diagnosis.contact.peg_places import Place, Sight, TouchedPeg, apart, places, sight
from dlo_ros.diagnosis.contact.undisturbed import (
    Undisturbed,
    outlier_frames,
    robust_loss,
    undisturbed,
)
from dlo_ros.diagnosis.contact.wall_places import TouchedWall, walls
from dlo_ros.effects import Start
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Simulated, evaluate, simulate
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import WHITE
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parallel import Threads
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import cause_priors
from dlo_ros.inference.thresholds import (
    CERTAIN,
    CLEARLY_LESS,
    MUCH_LARGER,
    SMALL_SHARE,
    UNEXPLAINED_PICTURES,
)
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

EFFECTS = {Obstacle.name, StraightWall.name}
RADII = (0.012, 0.006, 0.024)
"""Radii of the pegs that are tried, from a nail to a pipe [m]; the fit finds the true one."""
SIMULATED, DISTANCE = 80, 0.02
"""Number of places that are simulated, and their smallest distance over the length: beside a cause
that is not known yet, where a peg stands shows by what the DLO does after it alone."""
GROUPS = 2
"""Sets of recordings that a peg may explain, of which places are simulated."""
FITTED = 3
"""Number of pegs, and of walls, that are fitted."""
STEP = 0.01
"""First step of the simplex search, over the length."""
EVALUATIONS, ALIKE = 40, 0.01
"""Simulations of this search, and differences of the loss at which it ends."""
ITERATIONS = 6
BEGUN = 2
"""Pegs, and walls, that are kept."""
SOON = (8, 16)
"""Pictures after a hit by which contacts are judged where none explains all of them."""

Touched = TouchedPeg | TouchedWall
Hit = TypeVar("Hit", TouchedPeg, TouchedWall)


@dataclass(frozen=True)
class _Disturbed:
    """Recordings in which the DLO may have hit something, and a model that is right before.

    Args:
        scale: scale of the robust loss, see `robust_loss`.
        given: the parameter file.
        view: all recordings: nothing stands where a DLO has been in any of them.
    """

    settings: Settings
    recordings: tuple[Recording, ...]
    scale: float
    given: Settings
    view: Sight

    def loss(self, hit: Touched) -> float | None:
        """The robust loss with something that is hit; None where it cannot be simulated."""
        return self._loss(self._simulated(hit.start(self.settings.rod.diameter)))

    def most(self) -> float | None:
        """The largest loss of a contact that is worth it; None: nothing can be simulated."""
        without = self._loss(self._simulated(None))
        return None if without is None else CLEARLY_LESS * without

    def losses(self, some: Sequence[Hit]) -> list[tuple[float, Hit]]:
        """The losses of pegs or walls that can be simulated, and they."""
        found = Threads().map(self.loss, some)
        return [(loss, hit) for hit, loss in zip(some, found, strict=True) if loss is not None]

    def fitted(self, hit: Touched, most: float) -> tuple[float, Start] | None:
        """Fit of a contact's numbers, by a simplex search first, since the loss has jumps.

        Args:
            most: largest loss of a contact that is worth it.

        Returns:
            Sum of squared residuals, and the fitted numbers.
        """
        unit = STEP * self.given.rod.length

        def left(step: FloatArray) -> float:
            there = hit.stepped(step, unit)
            loss = None if there.is_entered(self.view) else self.loss(there)
            return np.inf if loss is None else loss

        simplex = np.vstack([np.zeros(len(hit.steps())), np.diag(hit.steps())])
        options = {
            "initial_simplex": simplex, "maxfev": EVALUATIONS, "fatol": ALIKE, "xatol": np.inf
        }  # fmt: skip
        with np.errstate(invalid="ignore"):  # of places where nothing can be simulated
            found = minimize(left, simplex[0], method="Nelder-Mead", options=options)
        if not found.fun <= most:
            return None
        nearest = hit.stepped(found.x, unit)
        try:
            start = nearest.start(self.settings.rod.diameter)
            begun = evaluate(self._with(start), self.recordings)
        except SimulationError:
            return None
        at = fit(begun, self.recordings, ITERATIONS, loss=WHITE, draft=True)
        if nearest.fitted(at.model.settings).is_entered(self.view):
            at = begun
        return _squares(at), replace(start, block=at.model.settings.effects[start.effect])

    def explains_all(self, start: Start) -> bool:
        """Whether no picture is an outlier frame with something that was hit."""
        at = self._simulated(start)
        return at is not None and not any(
            wrong.any() for wrong in outlier_frames(at, self.recordings, self.scale)
        )

    def holding(self, starts: Sequence[Start]) -> list[tuple[float, Start]]:
        """Those that are worth it, with the sums of squared residuals; see `fitted`."""
        most = self.most()
        found = []
        for start in starts:
            at = self._simulated(start)
            loss = self._loss(at)
            if at is not None and loss is not None and most is not None and loss <= most:
                found.append((_squares(at), start))
        return found

    def _simulated(self, start: Start | None) -> Simulated | None:
        """The model with a contact, or without; None where it cannot be simulated."""
        bare = ParametricModel(self.settings, ())
        model = bare if start is None else self._with(start)
        try:
            return simulate(model, self.recordings, ())
        except SimulationError:
            return None

    def _loss(self, at: Simulated | None) -> float | None:
        """The robust loss of a simulation."""
        return None if at is None else robust_loss(at, self.recordings, self.scale)

    def _with(self, start: Start) -> ParametricModel:
        """The model with a contact, of which only the contact's numbers are open."""
        parameters, _ = cause_priors(self.given, start)
        bare = ParametricModel(self.settings, ())
        return bare.extended(start.effect, dict(start.block), parameters)


def _squares(at: Simulated) -> float:
    """The sum of squared residuals of a simulation."""
    return sum(float(np.sum(r**2)) for r, _ in at.fields)


@dataclass(frozen=True)
class ContactBesideSetUp:
    """A peg or wall that may have been hit, and the joint model fitted to the pictures before."""

    before: ParametricModel
    start: Start


def contacts_beside_set_up(
    drafts: Sequence[Recording], given: Settings, model: ParametricModel
) -> list[ContactBesideSetUp]:
    """Pegs and walls that the DLO may have hit, beside a set-up off within its tolerances.

    Beside a peg that is known only walls are looked for, and beside a wall only pegs. A DLO that
    moves in space is seen from where a peg is a point and a wall is a line.

    Args:
        drafts: the recordings with a coarse simulation, to try contacts with.
        given: the parameter file.
        model: the joint model without them, from which a fit to undisturbed pictures begins.
    """
    kinds = EFFECTS - set(model.settings.effects)
    before = undisturbed(drafts, model) if kinds else None
    if before is None:
        return []
    starts = _contacts(drafts, given, before, kinds)
    return [ContactBesideSetUp(before.model, start) for start in starts]


def _contacts(
    drafts: Sequence[Recording], given: Settings, before: Undisturbed, kinds: Collection[str]
) -> list[Start]:
    """The pegs and walls with which a fit to undisturbed pictures comes nearest to the others.

    Beside a cause that is not known yet a DLO rebounds in another way than the model does, which
    then is farther off with the right wall than with none: what explains the first pictures after
    the hit leads to places that no search in all pictures finds.

    Args:
        kinds: effects that are looked for.
    """
    at, settings = before.at, before.model.settings
    wrong = outlier_frames(at, drafts, before.scale)
    disturbed = [k for k, w in enumerate(wrong) if w.any()]
    view = sight(settings, [d.observed for d in drafts], at.predicted, wrong)
    hit = _Disturbed(settings, tuple(drafts[k] for k in disturbed), before.scale, given, view)
    first = [len(drafts[k].times) - len(wrong[k]) + int(np.argmax(wrong[k])) for k in disturbed]
    found = _fits(hit, kinds)
    for pictures in SOON:
        if any(hit.explains_all(start) for _, start in found):
            break
        ends = [k + pictures for k in first]
        soon = [r.until(end) for r, end in zip(hit.recordings, ends, strict=True)]
        found += hit.holding([s for _, s in _fits(replace(hit, recordings=tuple(soon)), kinds)])
    found.sort(key=lambda f: f[0])
    least = found[0][0] if found else 0.0
    near = [start for squares, start in found if squares < MUCH_LARGER**2 * least]
    return [s for s in near if s in [other for other in near if other.effect == s.effect][:BEGUN]]


def _fits(hit: _Disturbed, kinds: Collection[str]) -> list[tuple[float, Start]]:
    """Fits of the pegs and walls that leave least of disturbed pictures, see `_Disturbed.fitted`.

    Args:
        kinds: effects that are looked for.
    """
    most = hit.most()
    if most is None:
        return []
    pegs = _best_pegs(hit) if Obstacle.name in kinds else []
    walls_ = _best_walls(hit) if StraightWall.name in kinds else []
    best = min((loss for loss, _ in (*pegs, *walls_)), default=0.0)
    most = min(most, CERTAIN**2 * best)
    # Round a peg, a little beside its place or smaller than it, a DLO whips another way: the best
    # of them is fitted in any case.
    tried = [
        h for some in (pegs, walls_) for k, (loss, h) in enumerate(some) if k == 0 or loss <= most
    ]
    found = Threads().map(partial(hit.fitted, most=most), tried)
    return [f for f in found if f is not None]


def _best_pegs(hit: _Disturbed) -> list[tuple[float, TouchedPeg]]:
    """The pegs that leave least, apart from each other."""
    distance = DISTANCE * hit.given.rod.length
    groups = [[p.peg for p in group] for group in _likely(hit.view)[:GROUPS]]
    some = [peg for group in groups for peg in apart(group, distance, SIMULATED)]
    return sorted(hit.losses(some), key=lambda t: t[0])[:FITTED]


def _best_walls(hit: _Disturbed) -> list[tuple[float, TouchedWall]]:
    """The walls that leave least, of different directions."""
    best: dict[float, tuple[float, TouchedWall]] = {}
    for loss, wall in sorted(hit.losses(walls(hit.view)), key=lambda t: t[0]):
        best.setdefault(wall.angle, (loss, wall))
    return list(best.values())[:FITTED]


def plausible_pegs(view: Sight) -> list[Start]:
    """The likeliest pegs by geometry alone, without a simulation."""
    most = SMALL_SHARE * view.count  # that a place explains less than the best one of its group
    likely = [p.peg for g in _likely(view) for p in g if p.left <= g[0].left + most]
    best = apart(likely, DISTANCE * view.rod.length, BEGUN)
    return [replace(p.start(view.rod.diameter), form=f"peg {k}") for k, p in enumerate(best, 1)]


def _likely(view: Sight) -> list[list[Place]]:
    """Places of pegs that may explain most of the outlier frames, the likeliest of a group first.

    In a recording in which the DLO does not come near them something else is wrong. So there is a
    group for each set of recordings that a peg may explain, which are told apart by the number of
    their outlier frames; the one that explains most comes first.
    """
    found = [p for radius in RADII for p in places(view, radius)]
    groups: dict[int, list[Place]] = {}
    for place in sorted(found, key=lambda p: (p.left, -p.touched)):
        groups.setdefault(place.met, []).append(place)
    result = []
    for group in groups.values():
        best = group[0]
        others = view.count - best.met
        if best.met and best.left - others <= UNEXPLAINED_PICTURES * best.met:
            result.append(group)
    return result
