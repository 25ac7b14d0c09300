# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The order in which explanations are sought: single effects, and the joint model.

Where the set-up is off in many ways, the joint model comes first; otherwise single effects do, and
it takes their place where none of them explains the data.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from dlo_ros.diagnosis.contact.contact_search import pegs_beside_plain_model
from dlo_ros.diagnosis.explain.certainty import departures
from dlo_ros.diagnosis.findings import holdout as held_out
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.diagnosis.findings.summary import Findings, is_immaterial
from dlo_ros.diagnosis.fitting.initial_fit import Beginning, finer
from dlo_ros.diagnosis.fitting.worker_processes import Progress, Workers
from dlo_ros.diagnosis.joint_diagnosis import (
    SEVERAL,
    joint_beside,
    learned_jointly,
    takes_over,
)
from dlo_ros.diagnosis.proposals.candidate_effects import starts
from dlo_ros.diagnosis.proposals.screening import alarm, screen
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_search import Candidate, search
from dlo_ros.errors import SimulationError
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

NEAR = 12.0
"""Root autocovariance of the best effect over that of an explanation, up to which what is left may
be the simulation's own error."""


def explain_in_order(
    team: Workers, plain: Candidate, holdout_errors: Callable[[Candidate], held_out.HoldoutErrors],
    beginning: Beginning, progress: Progress,
) -> Findings:  # fmt: skip
    """Single effects first, then the joint model; the other way round where much is off.

    Args:
        team: the workers, with the recordings to learn from.
        plain: the fitted plain model.
        holdout_errors: function that returns the errors on held-out data, by which a model is
            chosen.
        beginning: the initial fit to all recordings.
        progress: see `diagnose`.

    Returns:
        The decision, the candidates that led to it, and the joint model where that takes over; or
        a finer simulation, where a single effect comes so near that the simulation's own error is
        what is left.
    """
    recordings = team.problem.recordings
    names = imposed_names(r.manipulation for r in recordings)
    most = verdict.limit(plain.root_autocovariance)
    given = team.problem.given
    faint = plain.root_autocovariance < verdict.FAINT
    immaterial = faint or is_immaterial(plain, given, recordings)
    known = plain.at.model.effects
    begun = None
    if not immaterial:
        progress("fitting the joint model", 0.0)
        begun = training_set(beginning, len(recordings), plain.at.model.settings, given)
    joint = None
    if begun is not None and departures(begun.prepared.setup) >= SEVERAL:
        # No single effect does what several do: none is looked for by itself first.
        joint = learned_jointly(team, plain, beginning, begun, progress)
        if joint is not None and takes_over(joint.explanation, [plain]):
            holdout_err = holdout_errors(plain)
            return Findings(verdict.Decision("unexplained", None), holdout_err, joint=joint)
    progress("looking for what was hit", 0.0)
    here = scene(plain.at.model.settings, names, plain.at.predicted)
    hit = pegs_beside_plain_model(team, plain.at, known)
    prospects = screen(team, plain.at, [*starts(here, known), *hit], progress)
    gain, by_chance = alarm(prospects)
    if gain < by_chance and verdict.excusable(plain.at.residuals):
        return Findings(verdict.Decision("adequate", None), holdout_errors(plain))
    singles = search(team, plain.at, prospects, progress, most, thorough=not faint)
    explaining = verdict.explanations(singles, most)
    holdout_err = holdout_errors(explaining[0].candidate if explaining else plain)
    explained = confirmed_explanation(plain, singles, most, holdout_err)
    if explained is not None:
        return Findings(explained, holdout_err, tuple(singles))
    if immaterial:
        return Findings(verdict.Decision("adequate", None), holdout_err, tuple(singles))
    near = min(singles, key=lambda c: c.root_autocovariance, default=None)
    if near is not None and near.root_autocovariance > NEAR * most:
        near = None
    sharper = sharpened(beginning, near, given) if near is not None else None
    if sharper is not None:
        nothing = verdict.Decision("unexplained", None)
        return Findings(nothing, holdout_err, tuple(singles), sharper=sharper)
    if begun is not None and joint is None:
        progress("fitting the joint model", 0.5)
        joint = learned_jointly(team, plain, beginning, begun, progress)
    if joint is not None and takes_over(joint.explanation, singles):
        return Findings(
            verdict.Decision("unexplained", None), holdout_err, tuple(singles), joint=joint
        )
    holdout_err = holdout_errors(singles[0] if singles else plain)
    decision = verdict.Decision(
        "unexplained", *(verdict.sure(plain, singles, holdout_err) or (None,))
    )
    findings = Findings(decision, holdout_err, tuple(singles))
    return findings if decision.chosen is not None else joint_beside(findings, joint, plain)


def sharpened(beginning: Beginning, near: Candidate, given: Settings) -> Beginning | None:
    """The initial fit with a simulation that is fine enough for a candidate.

    The simulation was made fine enough for what the plain model leaves over. What remains beside a
    single effect that comes nearer may be its own error, which others would be fitted to.

    Returns:
        None where the simulation is fine enough, or cannot be finer.
    """
    try:
        return finer(beginning, near.at.model, given)
    except SimulationError as err:
        LOG.info("not refined: %s", err)
        return None


def confirmed_explanation(
    plain: Candidate, found: Sequence[Candidate], most: float, holdout_err: held_out.HoldoutErrors
) -> verdict.Decision | None:  # fmt: skip
    """The explanation of the data that also holds on the held-out data.

    Args:
        plain: the plain model.
        found: candidates.
        most: root autocovariance of the residuals up to which one explains the data.
        holdout_err: ERR of a candidate on held-out data [m].

    Returns:
        The decision; None where no candidate explains the data.
    """
    explaining = verdict.explanations(found, most)
    enough = verdict.confirmed(explaining, holdout_err(plain), holdout_err) if explaining else []
    if not enough:
        return None
    others = verdict.equal_predictors(enough[0].candidate, found, holdout_err)
    return verdict.choose(enough, others)
