# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From recordings to what the model gets wrong, its cause, and what naming it gains."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from dlo_ros.diagnosis import damping_selection
from dlo_ros.diagnosis.contact.contact_search import pegs_met
from dlo_ros.diagnosis.explain.certainty import departures
from dlo_ros.diagnosis.findings import holdout as held_out
from dlo_ros.diagnosis.findings.diagnosis_outcome import Diagnosis
from dlo_ros.diagnosis.findings.joint_outcome import (
    learn,
    training_set,
)
from dlo_ros.diagnosis.findings.measured_force_scale import with_forces
from dlo_ros.diagnosis.findings.remarks import left_out
from dlo_ros.diagnosis.findings.summary import Findings, is_immaterial, outcome
from dlo_ros.diagnosis.fitting.candidate_model import Model
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, evaluate
from dlo_ros.diagnosis.fitting.initial_fit import Beginning, begin, drafts, finer
from dlo_ros.diagnosis.fitting.levenberg_marquardt import fit, renewed
from dlo_ros.diagnosis.fitting.worker_processes import Problem, Progress, Workers, workers
from dlo_ros.diagnosis.joint_diagnosis import (
    SEVERAL,
    joint_beside,
    learned_jointly,
    misses,
    takes_over,
)
from dlo_ros.diagnosis.proposals.candidate_effects import starts
from dlo_ros.diagnosis.proposals.screening import Prospect, alarm, screen
from dlo_ros.diagnosis.residuals import residual_autocovariance
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_pairs import BASES, bases, other_pegs
from dlo_ros.diagnosis.selection.effect_search import Candidate, apart, candidate, reformed, search
from dlo_ros.diagnosis.selection.pre_contact import alone_before
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import searchable
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

NEAREST = 4
"""Candidates that are fitted anew with a finer simulation where nothing explains the data."""
REFINED = 4
"""Iterations with a simulation that has been refined."""
MISSED = 0.8
"""Root autocovariance of the residuals over the plain model's, below which another plain model
takes its place."""
REFORMED = 12.0
"""Root autocovariance of the best pair over that of an explanation, up to which other forms are
tried."""


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
        recordings: to learn from; without `holdout` one of them, or the end of the only one, is
            held out for the measured gain.
        settings: initial guess, what is known beforehand, and effects that are known already.
        holdout: recordings that are only predicted.
        processes: that simulate at the same time.
        progress: called with what is being done and the share of it that is done.

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
    plain, found = _search(beginning, count, given, processes, progress)
    unused = left_out(beginning)
    if found.joint is not None:
        progress("measuring the gain", 1.0)
        return with_forces(outcome(beginning, plain, found, given), recordings, given, unused)
    missed = _missed(plain, found, beginning.recordings[:count], given)
    if missed is not None:
        progress("fitting the plain model anew", 0.0)
        beginning = begin([*recordings, *holdout], given, missed)
        plain, found = _search(beginning, count, given, processes, progress)
    near = min((*found.singles, *found.pairs), key=lambda c: c.root_autocovariance, default=None)
    if near is not None:
        progress("refining the simulation", 0.0)
        try:
            sharper = finer(beginning, near.at.model, given)
            if sharper is not None:
                plain, found = _refined(sharper, plain, found, given)
                beginning = sharper
        except SimulationError as err:
            LOG.info("not refined: %s", err)
    progress("measuring the gain", 1.0)
    return with_forces(outcome(beginning, plain, found, given), recordings, given, unused)


def _missed(
    plain: Candidate, found: Findings, recordings: Sequence[Recording], given: Settings
) -> Model | None:
    """A plain model that does better than what was taken for the best: its fit went astray.

    An effect that does nothing may have led the other parameters out of a wrong valley.
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
    """What was found with a finer simulation; what comes nearest may explain the data now."""
    recordings = beginning.recordings[: len(plain.at.residuals)]

    def again(c: Candidate) -> Candidate:
        at = fit(evaluate(c.at.model, recordings, given), recordings, given, REFINED)
        return candidate(c.effect, c.form, renewed(at, recordings, given), given)

    plain, decision = again(plain), found.decision
    kept = replace(found.holdout_errors, recordings=beginning.recordings, known={})
    if decision.verdict == "unexplained":
        order = sorted((*found.singles, *found.pairs), key=lambda c: c.root_autocovariance)
        sharp = {id(c): again(c) for c in order[:NEAREST]}
        singles, pairs = (
            tuple(sharp.get(id(c), c) for c in some) for some in (found.singles, found.pairs)
        )
        found = replace(found, singles=singles, pairs=pairs)
        most = verdict.limit(plain.root_autocovariance)
        fresh = {id(c) for c in sharp.values()}
        explained = _explained(
            plain, [c for c in singles if id(c) in fresh], (), most, kept
        ) or _explained(plain, [c for c in pairs if id(c) in fresh], singles, most, kept)
        if explained is not None:
            return plain, replace(found, decision=explained, holdout_errors=kept)
    if decision.chosen is not None:
        chosen = replace(decision.chosen, candidate=again(decision.chosen.candidate))
        decision = replace(decision, chosen=chosen)
    return plain, replace(found, decision=decision, holdout_errors=kept)


def _explained(
    plain: Candidate, found: Sequence[Candidate], fewer: Sequence[Candidate], most: float,
    holdout_err: held_out.HoldoutErrors,
) -> verdict.Decision | None:  # fmt: skip
    """The explanation of the data that also holds on the held-out data.

    Args:
        found: candidates of equally many effects.
        fewer: candidates of fewer effects, which did not explain the data.
    """
    explaining = verdict.explanations(found, most)
    enough = verdict.confirmed(explaining, holdout_err(plain), holdout_err) if explaining else []
    if not enough:
        return None
    enough = verdict.without_idle(enough[0].candidate, fewer) or enough
    others = verdict.foretold(enough[0].candidate, [*fewer, *found], holdout_err)
    return verdict.choose(enough, others)


def _search(
    beginning: Beginning, count: int, given: Settings, processes: int, progress: Progress
) -> tuple[Candidate, Findings]:
    """The plain model and what explains the first `count` recordings beyond it."""
    learned = beginning.recordings[:count]
    at = _only(beginning.at, count)
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
            found = _explain(team, plain, holdout_errors, beginning, processes, progress)
        if found.decision.verdict == "adequate" and misses(plain, learned, given):
            # Too few shapes for a test, and yet far from them.
            progress("fitting the joint model", 0.5)
            begun = training_set(beginning, count, at.model.settings, given)
            found = joint_beside(found, learn(begun, given) if begun else None, plain)
        if found.joint is not None:
            return plain, found
        progress("judging the damping", 0.0)
        best = next(iter(found.suspects), plain)
        told = damping_selection.named(team, plain, best, found.decision, found.holdout_errors)
    if told is None:
        return plain, found
    return told.plain, replace(
        found, decision=told.decision, singles=(*found.singles, *told.candidates)
    )


def _only(at: CandidateEvaluation, count: int) -> CandidateEvaluation:
    """The part of an evaluation that belongs to the first recordings."""
    assert at.jacobians is not None
    return replace(
        at, residuals=at.residuals[:count], jacobians=at.jacobians[:count],
        predicted=at.predicted[:count], err=at.err[:count],
    )  # fmt: skip


def _explain(
    team: Workers, plain: Candidate, holdout_errors: Callable[[Candidate], held_out.HoldoutErrors],
    beginning: Beginning, processes: int, progress: Progress,
) -> Findings:  # fmt: skip
    """Single effects first; then the joint model, or pairs where two causes may be enough."""
    recordings = team.problem.recordings
    names = imposed_names(r.manipulation for r in recordings)
    most = verdict.limit(plain.root_autocovariance)

    def screened(at: CandidateEvaluation, present: Sequence[str]) -> list[Prospect]:
        here = scene(at.model.settings, names, at.predicted)
        progress("looking for what was hit", 0.0)
        return screen(team, at, [*starts(here, present), *pegs_met(team, at, present)], progress)

    def holdout_errors_beside(candidates: Sequence[Candidate]) -> held_out.HoldoutErrors:
        """Errors on the held-out data, which are chosen by the best explanation."""
        found = verdict.explanations(candidates, most)
        return holdout_errors(found[0].candidate if found else plain)

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
    prospects = screened(plain.at, known)
    promise, by_chance = alarm(prospects)
    if promise < by_chance and verdict.excusable(plain.at.residuals):
        return Findings(verdict.Decision("adequate", None), holdout_errors(plain))
    singles = search(team, plain.at, prospects, progress, most, thorough=not faint)
    holdout_err = holdout_errors_beside(singles)
    explained = _explained(plain, singles, (), most, holdout_err)
    if explained is not None:
        return Findings(explained, holdout_err, tuple(singles))
    if immaterial:
        return Findings(verdict.Decision("adequate", None), holdout_err, tuple(singles))
    if begun is not None and joint is None:
        progress("fitting the joint model", 0.5)
        joint = learned_jointly(team, plain, beginning, begun, progress)
    if joint is not None and takes_over(joint.explanation, singles):
        return Findings(
            verdict.Decision("unexplained", None), holdout_err, tuple(singles), joint=joint
        )
    pairs: list[Candidate] = []
    before = alone_before(team.problem, plain, names, processes, progress)
    told = {c.effect for c in before}
    firmest = [c for c in bases(singles, plain.root_autocovariance) if c.effect not in told]

    def beside(first: Candidate) -> list[Candidate]:
        """Pairs of an effect with every other."""
        prospects = screened(first.at, [*known, first.effect])
        return search(team, first.at, prospects, progress, most, thorough=False)

    def nearest(candidates: Sequence[Candidate]) -> Candidate | None:
        """What comes near an explanation without being one."""
        near = min(candidates, key=lambda c: c.root_autocovariance, default=None)
        return near if near and most < near.root_autocovariance < REFORMED * most else None

    def firsts() -> Iterator[Candidate]:
        """What a second effect is looked for beside; at last the second of what comes near."""
        yield from (some := [*before, *firmest][:BASES])
        near = nearest(pairs)
        if near is not None and near.effect not in {c.effect for c in some}:
            alone = apart(team, near, [*known, near.effect])
            yield from sorted(alone, key=lambda c: c.at.cost)[:1]

    for first in firsts():
        found = beside(first)
        near = nearest(found)
        if near is not None:
            found += reformed(team, near, singles)
        pairs = sorted([*pairs, *found], key=lambda c: c.score)
        holdout_err = holdout_errors_beside(pairs)
        explained = _explained(plain, pairs, singles, most, holdout_err)
        if explained is not None and explained.chosen is not None:
            # What was no use alone at first may be enough where the pair has led it.
            alone = apart(team, explained.chosen.candidate, known)
            singles += alone
            single = _explained(plain, alone, (), most, holdout_err)
            if single is None:
                # What takes the place of the first beside the second.
                seconds = [c for c in alone if c.effect != first.effect]
                second = min(seconds, key=lambda c: c.at.cost, default=None)
                if second is not None:
                    pairs += beside(second)
                pairs.sort(key=lambda c: c.score)
            explained = single or _explained(plain, pairs, singles, most, holdout_err) or explained
            pairs += other_pegs(team, explained, pairs)
            return Findings(explained, holdout_err, tuple(singles), tuple(pairs))
    everything = sorted([*singles, *pairs], key=lambda c: c.score)
    holdout_err = holdout_errors(everything[0] if everything else plain)
    decision = verdict.Decision(
        "unexplained", *(verdict.sure(plain, everything, holdout_err) or (None,))
    )
    findings = Findings(decision, holdout_err, tuple(singles), tuple(pairs))
    return findings if decision.chosen is not None else joint_beside(findings, joint, plain)
