# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""When recordings are explained by the joint model, and from which of them it learns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.contact.contact_search import PegBesideSetUp, pegs_beside_set_up
from dlo_ros.diagnosis.explain.certainty import FEW, departures
from dlo_ros.diagnosis.explain.joint_explanation import Explanation
from dlo_ros.diagnosis.explain.measurement_error import material_err, own_err
from dlo_ros.diagnosis.findings import holdout as held_out
from dlo_ros.diagnosis.findings.joint_learning import (
    Learned,
    TrainingSet,
    learn,
    nearer,
    surprising,
    training_set,
)
from dlo_ros.diagnosis.findings.summary import Findings
from dlo_ros.diagnosis.fitting.initial_fit import Beginning
from dlo_ros.diagnosis.fitting.recording_noise import noise_floor
from dlo_ros.diagnosis.fitting.worker_processes import Progress, Workers
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_search import Candidate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.variances import FEWEST_FRAMES
from dlo_ros.parameters import Settings

SEVERAL = 6
"""Parts of the set-up that are off for certain, from which causes are looked for beside it before
single effects are: one effect alone makes up to five look so."""
CLEARLY_BETTER = 0.7
"""ERR of the joint model over that of models with less in them, below which many small errors are
at work rather than one of another kind."""


def learned_jointly(
    team: Workers, plain: Candidate, beginning: Beginning, begun: TrainingSet, progress: Progress
) -> Learned | None:
    """The joint explanation; None where the joint model cannot be simulated.

    It learns from all recordings where the one that is held out shows what the others do not.

    Args:
        plain: the plain model's fit.
        begun: recordings to learn from at first.
    """
    given = team.problem.given
    joint = learn(begun, given, _met(team, plain, begun, progress))
    if joint is None or not surprising(begun, joint):
        return joint
    progress("fitting the joint model to all recordings", 0.3)
    count = len(team.problem.recordings)
    wider = training_set(beginning, count, plain.at.model.settings, given, all_of_them=True)
    again = learn(wider, given, _met(team, plain, wider, progress)) if wider else None
    return again if again is not None and nearer(again, joint) else joint


def _met(
    team: Workers, plain: Candidate, begun: TrainingSet, progress: Progress
) -> list[PegBesideSetUp]:
    """Pegs that the DLO may have hit, where the set-up alone leaves an ERR that matters."""
    setup, recordings = begun.prepared.setup, begun.prepared.recordings
    if setup.mean_err < material_err(own_err(setup, recordings), team.problem.given):
        return []
    progress("looking for what was hit", 0.0)
    return pegs_beside_set_up(team, plain.at, begun.prepared.scene)


def takes_over(joint: Explanation, others: Sequence[Candidate]) -> bool:
    """Whether the joint model explains, or shows more than two things that are wrong for certain.

    Args:
        others: models with less in them.
    """
    if joint.at.mean_err < joint.material_err:
        return True
    if departures(joint.at, joint.proposals) <= FEW:
        return False
    least = min((held_out.mean(c.at.err) or np.inf for c in others), default=np.inf)
    return joint.at.mean_err < CLEARLY_BETTER * least


def joint_beside(found: Findings, joint: Learned | None, plain: Candidate) -> Findings:
    """Findings that name nothing, with the joint model where that clearly comes nearer.

    Of a few shapes each of many effects explains all, and where much is left an effect may stand
    for another one that nobody knows: the joint model then names none of them either, unless more
    is wrong than a single effect can tell.
    """
    before = held_out.mean(plain.at.err)
    if joint is None or before is None:
        return found
    if joint.explanation.at.mean_err > CLEARLY_BETTER * before:
        return found
    few = max(len(r) for r in plain.at.residuals) < FEWEST_FRAMES
    much = joint.explanation.at.mean_err > verdict.SURE_LEFT * before
    if (few or much) and not takes_over(joint.explanation, found.singles):
        joint = replace(joint, explanation=replace(joint.explanation, causes=()))
    return replace(found, joint=joint)


def misses(plain: Candidate, recordings: Sequence[Recording], given: Settings) -> bool:
    """Whether the plain model is further from the recordings than they are uncertain."""
    pairs = zip(recordings, plain.at.predicted, strict=True)
    floor = float(np.mean([noise_floor(r, p, given) for r, p in pairs]))
    err = held_out.mean(plain.at.err)
    return err is not None and err > material_err(floor, given)
