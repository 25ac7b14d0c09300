# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Looks for what a DLO may have hit: nothing tells of a peg but that some pictures go astray.

From the fit to what is right before (`robust_fit`, `undisturbed`) and the places that no shape
enters (`peg_places`), a peg is found by simulating only the recordings that go astray, all other
numbers as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from dlo_ros.diagnosis.contact.peg_places import Sight, apart, places, sight
from dlo_ros.diagnosis.contact.undisturbed import undisturbed
from dlo_ros.diagnosis.fitting import robust_fit
from dlo_ros.diagnosis.fitting.candidate_model import Model, names
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, evaluate
from dlo_ros.diagnosis.fitting.levenberg_marquardt import attempt
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Workers
from dlo_ros.effects import Peg, Scene, Start
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.errors import SimulationError
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.spline import FloatArray

EFFECT = Obstacle.name
RADII = (0.012, 0.006, 0.024)
"""Radii of the pegs that are tried, from a nail to a pipe [m]; the fit finds the true one."""
OFF_BOARD = 0.02
"""Distance from the board over the length, from which a motion is one in space."""
LEFT = 0.3
"""Largest share of the deviating pictures that a peg need not explain."""
AS_LIKELY = 0.05
"""Share of the deviating pictures by which a place may explain fewer than the best."""
SIMULATED, APART = 20, 0.02
"""Places that are simulated, and how far from each other at least, over the length."""
NEAREST, NEAR, NEARER = 3, 0.05, 0.006
"""Number of best places near which others are simulated, how near, and how far from each other."""
HELPS = 0.8
"""Largest residual with the best peg over that without one, of the deviating recordings."""
FITTED = 3
STEP, LARGER = 0.01, 0.3
"""First steps of a search downhill: over the length, and of the logarithm of the radius."""
EVALUATIONS = 40
ITERATIONS = 6
BEGUN = 2
WORSE = 4.0
"""Squared residuals over the best one's, up to which another fit is begun with."""

Task = tuple[Model, tuple[int, ...], Peg, float]


@dataclass(frozen=True)
class PegBesideSetUp:
    """A peg that may have been hit, and the joint model that the pictures before tell of."""

    before: ParametricModel
    peg: Start


def pegs_met(team: Workers, at: CandidateEvaluation, present: Sequence[str]) -> list[Start]:
    """Pegs that the DLO may have hit; none where it moves in space, off the board they stand on.

    Args:
        at: the fit to all pictures.
        present: effects of the model.
    """
    found = None if EFFECT in present or _in_space(team) else robust_fit.calm(team, at)
    if found is None:
        return []
    calm, typical = found
    own = tuple((calm.model.theta() - at.model.theta()).tolist())
    return [_start(peg, k, own) for k, peg in enumerate(_pegs(team, calm, typical))]


def pegs_beside_set_up(
    team: Workers, at: CandidateEvaluation, scene: Scene
) -> list[PegBesideSetUp]:
    """Pegs that the DLO may have hit, beside a set-up that is off within its tolerances.

    Args:
        at: see `pegs_met`.
        scene: what the recordings look like.
    """
    if EFFECT in at.model.effects or _in_space(team):
        return []
    before = undisturbed(team, at, scene)
    if before is None:
        return []
    pegs = _pegs(team, before.at, before.typical)
    return [PegBesideSetUp(before.model, _start(peg, k)) for k, peg in enumerate(pegs)]


def _in_space(team: Workers) -> bool:
    """Whether the DLO leaves the board on which pegs stand."""
    length = team.problem.given.rod.length
    shapes = [d.observed for d in team.problem.drafts]
    return any(np.abs(s[..., 1]).max() > OFF_BOARD * length for s in shapes)


def _pegs(team: Workers, calm: CandidateEvaluation, typical: float) -> list[Peg]:
    """The pegs with which a fit to undisturbed pictures comes nearest to the others.

    Args:
        calm: the fit, held against the drafts.
        typical: of pictures that are right, see `robust_fit.robust`.
    """
    length = calm.model.settings.rod.length
    observed = [d.observed for d in team.problem.drafts]
    wrong = robust_fit.astray(calm, typical)
    if not any(w.any() for w in wrong):
        return []
    view = sight(calm.model.settings.rod, observed, calm.predicted, wrong)
    likely = _likely(view)
    astray = tuple(k for k, w in enumerate(wrong) if w.any())

    def simulated(some: Sequence[Peg]) -> list[tuple[float, Peg]]:
        tasks: list[Task] = [(calm.model, astray, peg, typical) for peg in some]
        return [
            (loss, peg) for peg, loss in zip(some, team.each(_loss, tasks), strict=True)
            if loss is not None
        ]  # fmt: skip

    tried = simulated(apart(likely, APART * length, SIMULATED))
    tried.sort(key=lambda t: t[0])
    for _, peg in tried[:NEAREST]:
        near = [p for p in likely if np.hypot(p.x - peg.x, p.z - peg.z) < NEAR * length]
        tried += simulated(apart(near, NEARER * length, SIMULATED))
    tried.sort(key=lambda t: t[0])
    there = replace(calm, residuals=tuple(calm.residuals[k] for k in astray))
    if not tried or tried[0][0] > HELPS * robust_fit.loss(there, typical):
        return []
    best = apart([peg for _, peg in tried], NEARER * length, FITTED)
    tasks: list[Task] = [(calm.model, astray, peg, typical) for peg in best]
    fits = [f for f in team.each(_fitted, tasks) if f is not None]
    fits.sort(key=lambda f: f.sum_of_squares)
    return [
        peg_of(f.model) for f in fits[:BEGUN] if f.sum_of_squares < WORSE * fits[0].sum_of_squares
    ]


def glimpsed(view: Sight) -> list[Start]:
    """The likeliest pegs as they look, without a simulation."""
    length = view.rod.length
    return [_start(peg, k) for k, peg in enumerate(apart(_likely(view), APART * length, BEGUN))]


def _start(peg: Peg, rank: int, own: tuple[float, ...] = ()) -> Start:
    block = peg._asdict()
    form = f"peg {rank + 1}"
    return Start(EFFECT, block, (), tuple(block), neutral=False, form=form, own=own)


def _likely(view: Sight) -> list[Peg]:
    """The pegs that explain most of what goes astray, if they explain enough."""
    found = [p for radius in RADII for p in places(view, radius)]
    found.sort(key=lambda p: (p.left, -p.touched))
    if not found or found[0].left > LEFT * view.count:
        return []
    return [p.peg for p in found if p.left <= found[0].left + AS_LIKELY * view.count]


def _alone(model: Model, peg: Peg) -> Model:
    """The model with a peg of which alone the numbers are open."""
    block = peg._asdict()
    extended = model.extended(EFFECT, block, tuple(block))
    return replace(extended, free=names(EFFECT, block, tuple(block)))


def peg_of(model: Model) -> Peg:
    """The peg that a model contains."""
    block = model.settings.effects[EFFECT]
    return Peg(*(v for key in Peg._fields if not isinstance(v := block[key], tuple)))


def _loss(problem: Problem, task: Task) -> float | None:
    """What `robust_fit.robust` makes small, of the recordings that go astray."""
    model, astray, peg, typical = task
    recordings = [problem.drafts[k] for k in astray]
    try:
        at = evaluate(_alone(model, peg), recordings, problem.given, derivatives=False)
    except SimulationError:
        return None
    return robust_fit.loss(at, typical)


def _fitted(problem: Problem, task: Task) -> CandidateEvaluation | None:
    """Fit a peg's numbers: downhill first, since what a peg does changes in jumps."""
    model, astray, peg, typical = task
    length = model.settings.rod.length

    def moved(step: FloatArray) -> Peg:
        dx, dz = (STEP * length * step[:2]).tolist()
        return Peg(peg.x + dx, peg.z + dz, peg.radius * float(np.exp(step[2])))

    def left(step: FloatArray) -> float:
        loss = _loss(problem, (model, astray, moved(step), typical))
        return np.inf if loss is None else loss

    simplex = np.vstack([np.zeros(3), np.diag([1.0, 1.0, LARGER])])
    options = {"initial_simplex": simplex, "maxfev": EVALUATIONS}
    found = minimize(left, simplex[0], method="Nelder-Mead", options=options)
    recordings = [problem.drafts[k] for k in astray]
    return attempt(_alone(model, moved(found.x)), recordings, problem.given, ITERATIONS)
