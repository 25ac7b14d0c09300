# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The search for a peg that a DLO may have hit, of which only outlier frames give evidence.

It starts from the fit to undisturbed pictures (`robust_fit`, `undisturbed`) and the places that no
shape enters (`peg_places`). Only the disturbed recordings are simulated, with all other numbers as
they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from dlo_ros.diagnosis.contact.peg_places import Sight, apart, places, sight, tangent_wall
from dlo_ros.diagnosis.contact.undisturbed import undisturbed
from dlo_ros.diagnosis.fitting import robust_fit
from dlo_ros.diagnosis.fitting.levenberg_marquardt import attempt
from dlo_ros.diagnosis.fitting.plain_evaluation import PlainEvaluation, evaluate
from dlo_ros.diagnosis.fitting.plain_model import PlainModel, names
from dlo_ros.effects import Peg, Scene, Start
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.errors import SimulationError
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parallel import Threads
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

EFFECT = Obstacle.name
RADII = (0.012, 0.006, 0.024)
"""Radii of the pegs that are tried, from a nail to a pipe [m]; the fit finds the true one."""
OFF_BOARD = 0.02
"""Distance from the board over the length, beyond which a motion counts as spatial."""
LEFT = 0.3
"""Maximum share of the outlier frames that a peg may leave unexplained."""
AS_LIKELY = 0.05
"""Share of the outlier frames by which a place may explain fewer than the best place."""
SIMULATED, APART = 20, 0.02
"""Number of places that are simulated, and their smallest distance over the length."""
NEAREST, NEAR, NEARER = 3, 0.05, 0.006
"""Number of best places near which others are simulated, their largest distance from these, and
their smallest distance from each other, over the length."""
HELPS = 0.8
"""Largest loss with the best peg over that without one, of the disturbed recordings."""
FITTED = 3
STEP, LARGER = 0.01, 0.3
"""First steps of the simplex search: over the length, and of the logarithm of the radius."""
EVALUATIONS = 40
ITERATIONS = 6
BEGUN = 2
WORSE = 4.0
"""Sum of squared residuals over the best one's, up to which another peg is kept."""


@dataclass(frozen=True)
class _Disturbed:
    """Recordings in which the DLO may have hit something, and a model that is right before.

    Args:
        model: the model.
        recordings: drafts of the recordings.
        scale: scale of the robust loss, see `robust_fit.robust`.
        given: the parameter file.
    """

    model: PlainModel
    recordings: tuple[Recording, ...]
    scale: float
    given: Settings

    def loss(self, peg: Peg) -> float | None:
        """The robust loss with a peg; None where it cannot be simulated."""
        try:
            at = evaluate(self._with(peg), self.recordings, self.given, derivatives=False)
        except SimulationError:
            return None
        return robust_fit.loss(at, self.scale)

    def fitted(self, peg: Peg) -> PlainEvaluation | None:
        """Fit of a peg's numbers, by a simplex search first, since the loss has jumps."""
        length = self.given.rod.length

        def moved(step: FloatArray) -> Peg:
            dx, dz = (STEP * length * step[:2]).tolist()
            return Peg(peg.x + dx, peg.z + dz, peg.radius * float(np.exp(step[2])))

        def left(step: FloatArray) -> float:
            loss = self.loss(moved(step))
            return np.inf if loss is None else loss

        simplex = np.vstack([np.zeros(3), np.diag([1.0, 1.0, LARGER])])
        options = {"initial_simplex": simplex, "maxfev": EVALUATIONS}
        found = minimize(left, simplex[0], method="Nelder-Mead", options=options)
        return attempt(self._with(moved(found.x)), self.recordings, self.given, ITERATIONS)

    def _with(self, peg: Peg) -> PlainModel:
        """The model with a peg, of which only the peg's numbers are open."""
        block = peg._asdict()
        extended = self.model.extended(EFFECT, block, tuple(block))
        return replace(extended, free=names(EFFECT, block, tuple(block)))


@dataclass(frozen=True)
class PegBesideSetUp:
    """A peg that may have been hit, and the joint model fitted to the pictures before."""

    before: ParametricModel
    peg: Start


def pegs_beside_set_up(
    drafts: Sequence[Recording], given: Settings, at: PlainEvaluation, scene: Scene
) -> list[PegBesideSetUp]:
    """Pegs that the DLO may have hit, beside a set-up that is off within its tolerances.

    There are none where it moves in space, off the board with the pegs.

    Args:
        drafts: the recordings with a coarse simulation, to try pegs with.
        given: the parameter file.
        at: the plain model, fitted to all pictures.
        scene: size, clamps and reach of the motion in the recordings.
    """
    if EFFECT in at.model.effects or _in_space(drafts, given):
        return []
    before = undisturbed(drafts, given, at, scene)
    if before is None:
        return []
    pegs = _pegs(drafts, given, before.at, before.scale)
    return [PegBesideSetUp(before.model, _start(peg, k)) for k, peg in enumerate(pegs)]


def _in_space(drafts: Sequence[Recording], given: Settings) -> bool:
    """Whether the DLO leaves the board on which pegs stand."""
    most = OFF_BOARD * given.rod.length
    return any(np.abs(d.observed[..., 1]).max() > most for d in drafts)


def _pegs(
    drafts: Sequence[Recording], given: Settings, consensus: PlainEvaluation, scale: float
) -> list[Peg]:
    """The pegs with which a fit to undisturbed pictures comes nearest to the other pictures.

    Args:
        consensus: evaluation of the fit to undisturbed pictures on all drafts.
        scale: scale of the robust loss, see `robust_fit.robust`.
    """
    length = consensus.model.settings.rod.length
    observed = [d.observed for d in drafts]
    wrong = robust_fit.outlier_frames(consensus, scale)
    if not any(w.any() for w in wrong):
        return []
    view = sight(consensus.model.settings.rod, observed, consensus.predicted, wrong)
    likely = _likely(view)
    disturbed = [k for k, w in enumerate(wrong) if w.any()]
    hit = _Disturbed(consensus.model, tuple(drafts[k] for k in disturbed), scale, given)

    def simulated(some: Sequence[Peg]) -> list[tuple[float, Peg]]:
        losses = Threads().map(hit.loss, some)
        return [(loss, peg) for peg, loss in zip(some, losses, strict=True) if loss is not None]

    tried = simulated(apart(likely, APART * length, SIMULATED))
    tried.sort(key=lambda t: t[0])
    for _, peg in tried[:NEAREST]:
        near = [p for p in likely if np.hypot(p.x - peg.x, p.z - peg.z) < NEAR * length]
        tried += simulated(apart(near, NEARER * length, SIMULATED))
    tried.sort(key=lambda t: t[0])
    there = replace(consensus, residuals=tuple(consensus.residuals[k] for k in disturbed))
    if not tried or tried[0][0] > HELPS * robust_fit.loss(there, scale):
        return []
    best = apart([peg for _, peg in tried], NEARER * length, FITTED)
    fits = [f for f in Threads().map(hit.fitted, best) if f is not None]
    fits.sort(key=lambda f: f.sum_of_squares)
    return [
        peg_of(f.model.settings)
        for f in fits[:BEGUN]
        if f.sum_of_squares < WORSE * fits[0].sum_of_squares
    ]


def wall_instead(model: ParametricModel, observed: Sequence[FloatArray]) -> Start | None:
    """A straight wall in place of the peg of a model; None where the DLO reaches behind it.

    Args:
        observed: control points of each recording [m], shape (F, n, 3).
    """
    found = tangent_wall(peg_of(model.settings), model.settings.rod, observed)
    return None if found is None else StraightWall.touching(*found)


def plausible_pegs(view: Sight) -> list[Start]:
    """The likeliest pegs by geometry alone, without a simulation."""
    length = view.rod.length
    return [_start(peg, k) for k, peg in enumerate(apart(_likely(view), APART * length, BEGUN))]


def _start(peg: Peg, rank: int) -> Start:
    block = peg._asdict()
    return Start(EFFECT, block, (), tuple(block), neutral=False, form=f"peg {rank + 1}")


def _likely(view: Sight) -> list[Peg]:
    """The pegs that explain most of the outlier frames, if they explain enough of them."""
    found = [p for radius in RADII for p in places(view, radius)]
    found.sort(key=lambda p: (p.left, -p.touched))
    if not found or found[0].left > LEFT * view.count:
        return []
    return [p.peg for p in found if p.left <= found[0].left + AS_LIKELY * view.count]


def peg_of(settings: Settings) -> Peg:
    """The peg that settings contain."""
    block = settings.effects[EFFECT]
    return Peg(*(v for key in Peg._fields if not isinstance(v := block[key], tuple)))
