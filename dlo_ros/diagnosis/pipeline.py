# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The pipeline of the diagnosis: from recordings to model errors, their cause, and its gain."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from dlo_ros.diagnosis import damping_selection
from dlo_ros.diagnosis.explanation_order import (
    confirmed_explanation,
    explain_in_order,
    sharpened,
)
from dlo_ros.diagnosis.findings import holdout as held_out
from dlo_ros.diagnosis.findings.diagnosis_outcome import Diagnosis
from dlo_ros.diagnosis.findings.joint_learning import learn, training_set
from dlo_ros.diagnosis.findings.measured_force_scale import with_forces
from dlo_ros.diagnosis.findings.remarks import left_out
from dlo_ros.diagnosis.findings.summary import Findings, outcome
from dlo_ros.diagnosis.fitting.candidate_model import Model
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, evaluate
from dlo_ros.diagnosis.fitting.initial_fit import Beginning, begin, drafts
from dlo_ros.diagnosis.fitting.levenberg_marquardt import fit, renewed
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Progress, workers
from dlo_ros.diagnosis.joint_diagnosis import joint_beside, misses
from dlo_ros.diagnosis.residuals import residual_autocovariance
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_search import Candidate, candidate
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import searchable
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

NEAREST = 4
"""Candidates that are fitted anew with a finer simulation where nothing explains the data."""
REFINED = 4
"""Iterations with a simulation that has been refined."""
ALONE = 10
"""Iterations of the plain model's fit to the recordings that may be learned from."""
MISSED = 0.8
"""Root autocovariance of the residuals over the plain model's, below which another plain model
takes its place."""


def diagnose(
    recordings: Sequence[Manipulation],
    settings: Settings,
    holdout: Sequence[Manipulation] = (),
    *,
    processes: int = 1,
    progress: Progress = lambda text, share: None,
) -> Diagnosis:
    """Find what the model gets wrong.

    Args:
        recordings: recordings to learn from; without `holdout` one of them, or the end of the only
            one, is held out for the measured gain.
        settings: initial guess, what is known beforehand, and effects that are known already.
        holdout: recordings that are only predicted.
        processes: number of processes that simulate at the same time.
        progress: function that is called with the name of the present step and the fraction of it
            that is done.

    Raises:
        InputError: no usable recording.
        SimulationError: the plain model cannot be simulated with any starting value.
    """
    if not recordings:
        raise InputError("no recording to diagnose; give at least one bag")
    given = searchable(settings)
    progress("fitting the plain model", 0.0)
    beginning = begin([*recordings, *holdout], given)
    count = len(recordings)
    beginning, plain, found = _search(beginning, count, given, processes, progress)
    unused = left_out(beginning)
    if found.joint is not None:
        progress("measuring the gain", 1.0)
        return with_forces(outcome(beginning, plain, found, given), recordings, given, unused)
    better = _better_plain_model(plain, found, beginning.recordings[:count], given)
    if better is not None:
        progress("fitting the plain model anew", 0.0)
        beginning = begin([*recordings, *holdout], given, better)
        beginning, plain, found = _search(beginning, count, given, processes, progress)
    near = min(found.singles, key=lambda c: c.root_autocovariance, default=None)
    if near is not None:
        progress("refining the simulation", 0.0)
        sharper = sharpened(beginning, near, given)
        if sharper is not None:
            try:
                plain, found = _refined(sharper, plain, found, given)
                beginning = sharper
            except SimulationError as err:
                LOG.info("not refined: %s", err)
    progress("measuring the gain", 1.0)
    return with_forces(outcome(beginning, plain, found, given), recordings, given, unused)


def _better_plain_model(
    plain: Candidate, found: Findings, recordings: Sequence[Recording], given: Settings
) -> Model | None:
    """A plain model that does better than the fitted one, whose fit had ended in a wrong minimum.

    An effect that does nothing may have led the other parameters out of that minimum.
    """
    chosen = found.decision.chosen
    c = (
        chosen.candidate
        if chosen
        else min(found.singles, key=lambda c: c.root_autocovariance, default=None)
    )
    if c is None:
        return None
    model = c.at.model
    for effect in set(model.effects) - set(plain.at.model.effects):
        model = model.without(effect)
    if model.free != plain.at.model.free:
        return None
    try:
        at = evaluate(model, recordings, given, derivatives=False)
    except SimulationError:
        return None
    return (
        model
        if residual_autocovariance.root_autocovariance(at.residuals)
        < MISSED * plain.root_autocovariance
        else None
    )


def _refined(
    beginning: Beginning, plain: Candidate, found: Findings, given: Settings
) -> tuple[Candidate, Findings]:
    """The findings with a finer simulation, with which candidates may explain the data."""
    recordings = beginning.recordings[: len(plain.at.residuals)]

    def again(c: Candidate) -> Candidate:
        at = fit(evaluate(c.at.model, recordings, given), recordings, given, REFINED)
        return candidate(c.effect, c.form, renewed(at, recordings, given), given)

    plain, decision = again(plain), found.decision
    kept = replace(found.holdout_errors, recordings=beginning.recordings, known={})
    if decision.verdict == "unexplained":
        order = sorted(found.singles, key=lambda c: c.root_autocovariance)
        sharp = {id(c): again(c) for c in order[:NEAREST]}
        found = replace(found, singles=tuple(sharp.get(id(c), c) for c in found.singles))
        most = verdict.limit(plain.root_autocovariance)
        explained = confirmed_explanation(plain, list(sharp.values()), most, kept)
        if explained is not None:
            return plain, replace(found, decision=explained, holdout_errors=kept)
    if decision.chosen is not None:
        chosen = replace(decision.chosen, candidate=again(decision.chosen.candidate))
        decision = replace(decision, chosen=chosen)
    return plain, replace(found, decision=decision, holdout_errors=kept)


def _search(
    beginning: Beginning, count: int, given: Settings, processes: int, progress: Progress
) -> tuple[Beginning, Candidate, Findings]:
    """The plain model and the explanation of the first `count` recordings.

    Returns:
        The initial fit, with a finer simulation where that was needed, the plain model fitted to
        the recordings learned from, and the explanation.
    """
    learned = beginning.recordings[:count]
    at = _learned(beginning, count, given)
    plain = candidate("", "", at, given)
    problem = Problem(learned, given, drafts(learned, at))

    def holdout_errors(best: Candidate) -> held_out.HoldoutErrors:
        recordings = beginning.recordings
        parted = held_out.split(recordings, len(recordings) - count, at, best.at, given)
        return held_out.HoldoutErrors(recordings, count, parted, given)

    with workers(problem, processes) as team:
        if verdict.adequate(at.residuals):
            found = Findings(verdict.Decision("adequate", None), holdout_errors(plain))
        else:
            found = explain_in_order(team, plain, holdout_errors, beginning, progress)
        if found.sharper is not None:
            progress("refining the simulation", 0.5)
        elif found.decision.verdict == "adequate" and misses(plain, learned, given):
            # Too few shapes for a test, and yet far from them.
            progress("fitting the joint model", 0.5)
            begun = training_set(beginning, count, at.model.settings, given)
            found = joint_beside(found, learn(begun, given) if begun else None, plain)
        told = None
        if found.joint is None and found.sharper is None:
            progress("judging the damping", 0.0)
            best = next(iter(found.suspects), plain)
            told = damping_selection.named(team, plain, best, found.decision, found.holdout_errors)
    if found.sharper is not None:
        return _search(found.sharper, count, given, processes, progress)
    if told is None:
        return beginning, plain, found
    return (
        beginning,
        told.plain,
        replace(found, decision=told.decision, singles=(*found.singles, *told.candidates)),
    )


def _learned(beginning: Beginning, count: int, given: Settings) -> CandidateEvaluation:
    """The plain model fitted to the first `count` recordings, from which all may be learned.

    The initial fit has seen the others, too: from all recordings a starting point is found that
    each of them can be simulated from.
    """
    if count == len(beginning.recordings):
        return beginning.at
    learned = beginning.recordings[:count]
    here = evaluate(beginning.at.model, learned, given)
    return renewed(fit(here, learned, given, ALONE), learned, given)
