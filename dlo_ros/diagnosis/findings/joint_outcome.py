# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The joint model's result: measured on held-out data, with numbers and in words."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.contact.contact_search import PegBesideSetUp
from dlo_ros.diagnosis.explain.joint_explanation import (
    Cause,
    Explanation,
    Prepared,
    explain,
    prepare,
    still_certain,
)
from dlo_ros.diagnosis.explain.measurement_error import OWN, material_err, own_err
from dlo_ros.diagnosis.findings import holdout
from dlo_ros.diagnosis.findings.confirmed_uncertainty import Widening, confirmed
from dlo_ros.diagnosis.findings.diagnosis_outcome import (
    Diagnosis,
    NamedEffect,
    Trial,
)
from dlo_ros.diagnosis.findings.experiment_advice import REPEAT, SETTLED
from dlo_ros.diagnosis.findings.joint_numbers import (
    damping_as_effects,
    effect_numbers,
    fitted_material,
    plain_material,
    reported_covariance,
    set_up_numbers,
    systematic_errors,
)
from dlo_ros.diagnosis.findings.shape_views import views
from dlo_ros.diagnosis.fitting.candidate_model import Model
from dlo_ros.diagnosis.fitting.evaluation import evaluate as held_against
from dlo_ros.diagnosis.fitting.initial_fit import Beginning, drafts
from dlo_ros.diagnosis.residuals.relations import relations, sentences
from dlo_ros.diagnosis.selection.effect_search import Candidate
from dlo_ros.diagnosis.selection.verdict import Verdict
from dlo_ros.effects import effects
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, borrowed, evaluate, rejudged, simulate
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

Errors = list[FloatArray] | None

FEWEST = 10
"""Frames, from which the end of a recording can be predicted from its beginning."""
FINAL_ITERATIONS = 8
SURPRISING = 3.0
"""ERR on the recording that is held out over that on the others, from which it shows what they do
not."""


@dataclass(frozen=True)
class Learned:
    """The joint explanation, and what it was learned from.

    Args:
        explanation: explanation of the recordings learned from.
        masks: frames of each recording of the beginning that are held out, shape (F,).
        held, seen: ERR [m] of the frames that are held out, and of the others, see `_errors`, of
            the full model with values that know nothing of the former.
    """

    explanation: Explanation
    masks: tuple[np.ndarray, ...]
    held: Errors
    seen: Errors


@dataclass(frozen=True)
class TrainingSet:
    """The recordings that the joint model is to learn from, with its set-up fitted to them.

    Args:
        recordings: all of the beginning's.
        count: number of recordings, from the first, that may be learned from.
        held_out: index of a recording among them that is held out all the same; None: none is.
        prepared: the recordings learned from, with the set-up fitted to them.
    """

    recordings: Sequence[Recording]
    count: int
    held_out: int | None
    prepared: Prepared


def training_set(
    beginning: Beginning, count: int, plain: Settings, given: Settings, *, all_of_them: bool = False
) -> TrainingSet | None:
    """The recordings to learn from, with the set-up fitted; None where it cannot be simulated.

    Held out are the recordings after the first `count`, or one of several; nothing is selected by
    them.

    Args:
        count: recordings that may be learned from.
        plain: settings of the plain model's fit.
        given: the parameter file.
        all_of_them: whether none of those is held out.
    """
    recordings = beginning.recordings
    spare = len(recordings) == count and not all_of_them
    held_out = holdout.held_out_recording(recordings) if spare else None
    chosen = [k for k in range(count) if k != held_out]
    learned = [recordings[k] for k in chosen]
    residuals, predicted = (
        [x[k] for k in chosen] for x in (beginning.at.residuals, beginning.at.predicted)
    )
    rough = drafts(
        learned, replace(beginning.at, residuals=tuple(residuals), predicted=tuple(predicted))
    )
    try:
        return TrainingSet(recordings, count, held_out, prepare(rough, plain, given))
    except SimulationError:
        return None


def learn(
    training: TrainingSet, given: Settings, pegs: Sequence[PegBesideSetUp] = ()
) -> Learned | None:
    """Explain the recordings that are not held out; None where the model cannot be simulated.

    Where all recordings are needed to find causes, the values alone are learned from their
    beginnings, to predict their ends.

    Args:
        given: the parameter file.
        pegs: pegs that the DLO may have hit.
    """
    recordings, count, held_out = training.recordings, training.count, training.held_out
    frames = [len(r.times) for r in recordings]
    masks = [np.full(f, k >= count or k == held_out) for k, f in enumerate(frames)]
    try:
        found = explain(training.prepared, given, pegs)
        predicting = found.at
        if len(recordings) == count and held_out is None and min(frames) >= FEWEST:
            masks = [np.arange(f) >= (holdout.TRAINED + 0.1) * (f - 1) for f in frames]
            stops = [int(holdout.TRAINED * (f - 1)) + 1 for f in frames]
            begun = [r.until(s) for r, s in zip(training.prepared.recordings, stops, strict=True)]
            predicting = _refitted(found.at, begun)
    except SimulationError:
        return None
    return Learned(found, tuple(masks), *_errors(predicting.model, recordings, masks))


def surprising(training: TrainingSet, learned: Learned) -> bool:
    """Whether the held-out recording shows a cause that the others do not, such as an impact.

    It is then needed to find causes.
    """
    if training.held_out is None:
        return False
    held, seen = holdout.mean(learned.held), holdout.mean(learned.seen)
    if held is None or seen is None:
        return True
    return held > SURPRISING * max(seen, learned.explanation.material_err)


def nearer(learned: Learned, other: Learned) -> bool:
    """Whether a model that has learned from all recordings comes nearer to them than another."""
    err = holdout.mean([*(other.held or ()), *(other.seen or ())])
    return other.held is None or err is None or learned.explanation.at.mean_err < err


def joint_outcome(
    beginning: Beginning, plain: Candidate, learned: Learned, given: Settings
) -> Diagnosis:
    """Measure ERR on held-out data, fit the model to all recordings, and put all together.

    Raises:
        SimulationError: a recording cannot be simulated, with the set-up alone either.
    """
    found, recordings = learned.explanation, beginning.recordings
    first = recordings[: len(plain.at.residuals)]
    known = [k for k in range(len(first)) if not learned.masks[k].all()]
    final = _completed(found.at, first, known)
    wider = confirmed(final, first, [name for c in found.causes for name in c.names])
    found = still_certain(found, final, reported_covariance(final, wider.parameters))
    try:
        ours = held_against(Model(final.model.settings, ()), first, given, derivatives=False)
    except SimulationError as err:
        if found.at is found.setup:
            raise
        LOG.warning("the model with its causes is dropped, since it does not hold: %s", err)
        alone = replace(found, at=found.setup, causes=(), proposals=())
        return joint_outcome(beginning, plain, Learned(alone, learned.masks, None, None), given)
    own = own_err(final, first) if len(final.err) == len(first) else found.own_err
    matters = material_err(own, given)
    bare = final if found.setup is found.at else found.setup
    if bare.mean_err < matters:  # of what was learned from: is it so of all?
        bare = _completed(bare, first, known)
    bare_model = _unseeing(plain, first, learned.masks[: len(first)], given)
    before, seen_before = _errors(bare_model, recordings, learned.masks)
    after, seen_after = learned.held, learned.seen
    missing, left = holdout.mean(before), holdout.mean(after)
    missing = holdout.mean(seen_before) if missing is None else missing
    left = found.at.mean_err if left is None else left
    share = _share(missing, left, own)
    # A recording that is held out and cannot be fitted beside the others is not explained.
    least = 0.0 if len(final.err) == len(first) else left
    verdict = _verdict(
        bare.mean_err, max(final.mean_err, least), matters, found.nameable_err, found.causes
    )
    missed = (holdout.mean(seen_before) or 0.0) - own
    base = held_against(plain.at.model, first, given, derivatives=False)
    related_before = related_after = None
    if verdict == "unexplained":
        related_before, related_after = (
            relations(first, at.residuals, at.predicted, at.model.settings) for at in (base, ours)
        )
    remarks = (
        f"{_percent(share)} of what the plain model misses beyond the measurement's own error is "
        f"explained; {_mm(left)} remain, and {_mm(matters)} would be "
        "immaterial.",
    )
    return Diagnosis(
        verdict,
        tuple(_effect(c, final, given, found.at.mean_err, missed, wider) for c in found.causes),
        own,
        plain_material(plain, holdout.mean(seen_before), holdout.mean(before)),
        replace(
            fitted_material(
                final,
                holdout.mean(seen_after),
                holdout.mean(after),
                wider.material,
                found.stiffness_doubt,
            ),
            settings=damping_as_effects(
                final.model.settings, given, [c.effect for c in found.causes]
            ),
        ),
        holdout.gain(before, after),
        _tried(found),
        _advice(verdict, found),
        None if np.isnan(beginning.error) else beginning.error,
        (*remarks, *(sentences(related_after) if related_after is not None else ())),
        views(recordings, base, ours, learned.masks, given),
        related_before,
        related_after,
        matters,
        share,
        set_up_numbers(final, found.causes, given),
        systematic_errors(final),
        found.trace,
    )


def _unseeing(
    plain: Candidate, recordings: Sequence[Recording], masks: Sequence[np.ndarray], given: Settings
) -> ParametricModel:
    """The plain model fitted to the frames that are not held out."""
    model = plain.at.model
    if any(m.any() for m in masks):
        model = holdout.refitted(plain.at, recordings, [~m for m in masks], given)
    return ParametricModel(model.settings, ())


def _completed(at: Evaluation, recordings: Sequence[Recording], known: Sequence[int]) -> Evaluation:
    """The model fitted to all recordings, or as it was where that fit is worse.

    A recording with a cause of its own distorts all numbers.

    Args:
        at: fitted to those that are known.
        known: numbers of these.
    """
    found = _refitted(at, recordings)
    if len(found.err) != len(recordings) or len(known) == len(recordings):
        return found
    spoilt = np.mean([found.err[k].mean() for k in known]) > OWN * at.mean_err
    return at if spoilt else found


def _refitted(at: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """The model fitted to all that it may learn from."""
    frames = [len(e) for e in at.err]
    try:
        if len(recordings) == len(frames) and all(
            len(r.times) <= f for r, f in zip(recordings, frames, strict=True)
        ):
            begun = rejudged(borrowed(at, at.model, recordings))
            return fit(begun, recordings, FINAL_ITERATIONS)
        return fit(evaluate(at.model, recordings), recordings, FINAL_ITERATIONS)
    except SimulationError:
        return at


def _errors(
    model: ParametricModel, recordings: Sequence[Recording], masks: Sequence[np.ndarray]
) -> tuple[Errors, Errors]:
    """ERR [m] of the frames that are held out, and of the others, per recording that has any."""
    try:
        err = simulate(model, recordings, ()).err
    except SimulationError:
        return None, None
    masks = [m[-len(e) :] for m, e in zip(masks, err, strict=True)]
    held = [e[m] for e, m in zip(err, masks, strict=True) if m.any()]
    seen = [e[~m] for e, m in zip(err, masks, strict=True) if not m.all()]
    return held, seen


def _verdict(
    setup: float, after: float, matters: float, nameable: float, causes: Sequence[Cause]
) -> Verdict:
    """The verdict by the ERR [m] of the set-up and of the full model, fitted to everything.

    A number of the set-up that is named lies beyond its tolerance: a fit of the set-up alone
    contains it, and yet that is no set-up within tolerances where it matters. Where nothing is
    named, the ERR that the full model takes away matters as little as a cause that may only
    compensate for laws.

    Args:
        matters: ERR [m] below which nothing is left to explain.
        nameable: ERR [m] that a cause must take away to be named.
        causes: causes that are named.
    """
    if setup < matters and all(c.err < matters for c in causes):
        return "adequate"
    if after >= matters:
        return "unexplained"
    if causes:
        return "explained"
    return "adequate" if setup - after < nameable else "unexplained"


def _share(before: float | None, after: float | None, own: float) -> float | None:
    """Share of ERR beyond the measurement's own that is taken away, 0 to 1."""
    if before is None or after is None or before <= own:
        return None
    return float(np.clip((before - max(after, own)) / (before - own), 0.0, 1.0))


def _effect(
    cause: Cause, final: Evaluation, given: Settings, err: float, missed: float, wider: Widening
) -> NamedEffect:
    """A cause with its numbers and its share.

    Args:
        given: the parameter file.
        err: ERR of the full model on the recordings learned from [m].
        missed: error of the plain model on them beyond the measurement's own [m].
        wider: factors of the standard deviations.
    """
    share = (cause.err - err) / missed if missed > 0.0 else None
    return NamedEffect(
        cause.effect, effect_numbers(cause.effect, final, given, wider.parameters),
        tuple(cause.rivals), None if share is None else float(np.clip(share, 0.0, 1.0)),
        cause.rivals,
    )  # fmt: skip


def _tried(found: Explanation) -> tuple[Trial, ...]:
    """The best of each candidate's trials: minus twice its log evidence over that without it."""
    best: dict[str, float] = {}
    for step in found.trace:
        best[step.name] = max(step.gain, best.get(step.name, -np.inf))
    order = sorted(best.items(), key=lambda row: -row[1])
    return tuple(Trial(name, None, -2.0 * gain, 0.0) for name, gain in order)


def _advice(verdict: Verdict, found: Explanation) -> str:
    """The next experiment, in a sentence."""
    open_ = next((c for c in found.causes if c.rivals), None)
    if open_ is not None:
        known = effects()
        names = " and ".join(known[n].called() for n in (open_.effect, *open_.rivals))
        return (
            f"These data do not separate {names}: record another manipulation, one that turns "
            "the clamp or moves a free end; dlo_ros design --report proposes one."
        )
    if verdict == "adequate":
        return "No error is left to explain: the set-up is within its tolerances."
    if verdict == "explained":
        return SETTLED
    return REPEAT


def _percent(share: float | None) -> str:
    return "An unknown share" if share is None else f"{100.0 * share:.0f} %"


def _mm(value: float) -> str:
    return f"{1e3 * value:.2f} mm"
