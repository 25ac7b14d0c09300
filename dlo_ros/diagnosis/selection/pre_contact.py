# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that are fitted to the time before the DLO hits something.

A peg may change the shapes so much that another effect beside it cannot be seen. Before the DLO
meets the peg the other effect is alone.
"""

from __future__ import annotations

from collections.abc import Sequence

from dlo_ros.diagnosis.fitting.evaluation import evaluate
from dlo_ros.diagnosis.fitting.levenberg_marquardt import fit
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Progress, workers
from dlo_ros.diagnosis.proposals.candidate_effects import starts
from dlo_ros.diagnosis.proposals.screening import screen
from dlo_ros.diagnosis.residuals import residual_autocovariance
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_search import Candidate, candidate, search
from dlo_ros.effects import nonsmooth
from dlo_ros.errors import SimulationError
from dlo_ros.inference.scene import scene

SHARES = (0.5, 0.25)
"""Shares of each recording, from its first picture, that are looked at alone."""
CALMER = 0.5
"""Largest root autocovariance of the residuals of these beginnings over that of the whole."""
ITERATIONS = 6
MOST_EXPLANATIONS = 2


def alone_before(
    problem: Problem, plain: Candidate, names: Sequence[str], processes: int, progress: Progress
) -> list[Candidate]:
    """Effects that explain the first part of each recording, best first, evaluated on all of it.

    Args:
        plain: the model without them, fitted to everything.
        names: everything that any command imposes.
    """
    given = problem.given
    for share in SHARES:
        part = _part(problem, share)
        try:
            at = evaluate(plain.at.model, part.recordings, given)
        except SimulationError:
            return []
        at = fit(at, part.recordings, given, ITERATIONS)
        left = residual_autocovariance.root_autocovariance(at.residuals)
        if verdict.adequate(at.residuals) or left > CALMER * plain.root_autocovariance:
            continue
        view = scene(at.model.settings, names, at.predicted)
        begun = starts(view, (*at.model.effects, *nonsmooth()))
        with workers(part, processes) as team:
            prospects = screen(team, at, begun, progress)
            most = verdict.limit(left)
            found = search(team, at, prospects, progress, most, thorough=False)
        explaining = verdict.explanations(found, most)[:MOST_EXPLANATIONS]
        if explaining:
            return [c for e in explaining if (c := _whole(problem, e.candidate)) is not None]
    return []


def _part(problem: Problem, share: float) -> Problem:
    """The first part of each recording."""
    ends = [max(1, int(share * len(r.times))) for r in problem.recordings]
    recordings, drafts = (
        tuple(r.until(end) for r, end in zip(some, ends, strict=True))
        for some in (problem.recordings, problem.drafts)
    )
    return Problem(recordings, problem.given, drafts)


def _whole(problem: Problem, c: Candidate) -> Candidate | None:
    """A candidate evaluated on whole recordings, with the numbers fitted to the first part."""
    try:
        at = evaluate(c.at.model, problem.recordings, problem.given)
    except SimulationError:
        return None
    return candidate(c.effect, c.form, at, problem.given)
