# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings that the joint model learns from, and its errors on those that are held out."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.contact.contact_search import ContactBesideSetUp
from dlo_ros.diagnosis.explain.explanation import Explanation
from dlo_ros.diagnosis.explain.joint_explanation import (
    Prepared,
    explain,
    explain_again,
    prepare,
)
from dlo_ros.diagnosis.explain.measurement_error import material_err, own_err
from dlo_ros.diagnosis.explain.own_moments import for_recordings
from dlo_ros.diagnosis.findings import holdout
from dlo_ros.diagnosis.proposals.time_steps import (
    with_short_steps,
    with_steps_instead_of_plain,
)
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline.drafts import drafts, drafts_error
from dlo_ros.identification.offline.initial_fit import Beginning
from dlo_ros.identification.residual_noise import rms, whitened
from dlo_ros.inference.joint import (
    Evaluation,
    Simulated,
    borrowed,
    evaluate,
    rejudged,
    simulate,
)
from dlo_ros.inference.joint_fit import ITERATIONS, approached, fit
from dlo_ros.inference.losses import TO_REPORT
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import APART, CLEARLY_LESS, FEWEST, IMMATERIAL, LOWERS
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

FINAL_ITERATIONS = 8
STIFFER = 1.1
"""Factor of E by which another model lies beside one that comes near: no fit goes farther on."""


@dataclass(frozen=True)
class Errors:
    """ERR of a model [m], shape (F,) for each recording that has any such frames.

    Both are None where a recording cannot be simulated.

    Args:
        held, seen: ERR of the frames that are held out, and of the others.
    """

    held: Sequence[FloatArray] | None = None
    seen: Sequence[FloatArray] | None = None


@dataclass(frozen=True)
class Learned:
    """The joint explanation, and what it was learned from.

    Args:
        explanation: explanation of the recordings learned from.
        drafts: these recordings with a coarser simulation, by their number.
        masks: frames of each recording of the beginning that are held out, shape (F,).
        err: errors of the full model with values that know nothing of the frames held out.
        predicting: the fit that has these values.
        parts: what these values were fitted to.
        seen: frames of each recording that are in the parts, shape (F,); some are neither that nor
            held out.
    """

    explanation: Explanation
    drafts: Mapping[int, Recording]
    masks: tuple[np.ndarray, ...]
    err: Errors
    predicting: Evaluation | None = None
    parts: tuple[Recording, ...] = ()
    seen: tuple[np.ndarray, ...] = ()

    @property
    def mean_err(self) -> float | None:
        """ERR on all recordings [m], held out or not; None where one cannot be simulated."""
        if self.err.held is None or self.err.seen is None:
            return None
        return holdout.mean([*self.err.held, *self.err.seen])


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
) -> TrainingSet:
    """The recordings to learn from, with the set-up fitted.

    Held out are the recordings after the first `count`, or one of several; nothing is selected by
    them.

    Args:
        count: recordings that may be learned from.
        plain: settings of the plain model's fit.
        given: the parameter file.
        all_of_them: whether none of those is held out.

    Raises:
        SimulationError: the joint model cannot be simulated.
    """
    recordings = beginning.recordings
    spare = len(recordings) == count and not all_of_them
    held_out = holdout.held_out_recording(recordings) if spare else None
    chosen = [k for k in range(count) if k != held_out]
    learned = [recordings[k] for k in chosen]
    at = (beginning.near or beginning.at).of(chosen)
    beside = None if beginning.near is None else _beside(at, learned)
    rough = with_short_steps(drafts(learned, at, beside), at)
    prepared = _with_reliable_drafts(prepare(rough, plain, given), learned)
    steps = with_steps_instead_of_plain(prepared.recordings, prepared.setup)
    prepared = replace(prepared, recordings=steps)
    return TrainingSet(recordings, count, held_out, prepared)


def _beside(near: Simulated, learned: Sequence[Recording]) -> Simulated | None:
    """A model beside one that comes near, see `STIFFER`; None where it cannot be simulated."""
    try:
        return simulate(near.model.stiffened(STIFFER), learned, ())
    except SimulationError:
        return None


def _with_reliable_drafts(prepared: Prepared, learned: Sequence[Recording]) -> Prepared:
    """The set-up fitted with drafts that are reliable for it, not for the plain model alone.

    What drafts do wrong is taken from them as it is with the plain model. That has dampings which
    stand for all that it lacks; with others the DLO moves more rapidly, and drafts err more.

    Args:
        learned: the recordings with their fine simulation.
    """
    try:
        near = simulate(prepared.setup.model, learned, ())
        missed = drafts_error(prepared.setup, prepared.recordings, near, learned)
        most = max(IMMATERIAL, LOWERS * rms(whitened(near, learned)))
        LOG.info("drafts of the set-up err by %.2f of the noise, %.2f allowed", missed, most)
        if missed < most:
            return prepared
        rough = with_short_steps(drafts(learned, near), near)
        setup = fit(evaluate(near.model, rough), rough, ITERATIONS)
    except SimulationError as err:
        LOG.info("the drafts stay: %s", err)
        return prepared
    return replace(prepared, recordings=rough, setup=setup)


def learn(
    training: TrainingSet, given: Settings, contacts: Callable[[], Sequence[ContactBesideSetUp]],
    known: Explanation | None = None,
) -> Learned:  # fmt: skip
    """Explain the recordings that are not held out.

    Causes are looked for with drafts; the values with which the rest is predicted are learned with
    the fine simulation. Where all recordings are needed to find causes, these values are learned
    from their beginnings, to predict their ends.

    Args:
        given: the parameter file.
        contacts: function that looks for pegs and walls that the DLO may have hit.
        known: explanation of other recordings, or by another simulation, whose causes may do.

    Raises:
        SimulationError: the joint model cannot be simulated.
    """
    recordings, count, held_out = training.recordings, training.count, training.held_out
    frames = [len(r.times) for r in recordings]
    masks = [np.full(f, k >= count or k == held_out) for k, f in enumerate(frames)]
    found = explain_again(training.prepared, given, known) if known is not None else None
    found = found or explain(training.prepared, given, contacts())
    chosen = [k for k, mask in enumerate(masks) if not mask.any()]
    parts, seen = [recordings[k] for k in chosen], [~mask for mask in masks]
    rough = dict(zip(chosen, training.prepared.recordings, strict=True))
    if len(recordings) == count and held_out is None and min(frames) >= FEWEST:
        masks = [np.arange(f) >= (holdout.TRAINED + 0.1) * (f - 1) for f in frames]
        stops = [int(holdout.TRAINED * (f - 1)) + 1 for f in frames]
        parts = [r.until(s) for r, s in zip(recordings, stops, strict=True)]
        seen = [np.arange(f) < s for f, s in zip(frames, stops, strict=True)]
    learned = Learned(found, rough, tuple(masks), Errors(), parts=tuple(parts), seen=tuple(seen))
    return _predicting(learned, recordings)


def _predicting(learned: Learned, recordings: Sequence[Recording]) -> Learned:
    """The explanation with values that know nothing of the held-out data, and their errors.

    Args:
        recordings: all of the beginning's.
    """
    predicting = nearest(refitted(learned.explanation.at, learned.parts), learned.parts)
    err = errors_of(predicting.model, recordings, learned.masks)
    return replace(learned, err=err, predicting=predicting)


def with_names(learned: Learned, recordings: Sequence[Recording]) -> Learned:
    """The explanation with its causes, in whose places rivals may be now, and the errors with them.

    Args:
        recordings: all of the beginning's.
    """
    named = replace(learned, explanation=learned.explanation.with_names())
    changed = named.explanation.at is not learned.explanation.at
    return _predicting(named, recordings) if changed else named


def all_learned_from(learned: Learned) -> bool:
    """Whether no recording was held out as a whole."""
    return not any(mask.all() for mask in learned.masks)


def surprising(training: TrainingSet, learned: Learned) -> bool:
    """Whether the held-out recording shows a cause that the others do not, such as an impact.

    It is then needed to find causes.
    """
    if training.held_out is None:
        return False
    held, seen = holdout.mean(learned.err.held), holdout.mean(learned.err.seen)
    if held is None or seen is None:
        return True
    return held > APART * max(seen, learned.explanation.material_err)


def nearer(learned: Learned, other: Learned) -> bool:
    """Whether a model that has learned from all recordings comes nearer to them than another."""
    err = other.mean_err
    return err is None or learned.explanation.at.mean_err < err


def refitted(
    at: Evaluation, recordings: Sequence[Recording], other: Evaluation | None = None
) -> Evaluation:
    """The model fitted to all that it may learn from; as it is where that leaves the shapes.

    Errors that stay are cheap, so that a fit may follow a motion at the cost of its shapes.

    Args:
        other: another fit of the model, to fewer frames, from which it begins if that explains all
            of them better: a fit that has ended beside an impact finds no way on from there.
    """
    begun: list[Evaluation] = []
    for there in (at, other):
        try:
            begun += [] if there is None else [_over(there, recordings)]
        except SimulationError as err:
            LOG.info("a fit does not hold in all recordings: %s", err)
    if not begun:
        return at
    best = max(begun, key=lambda e: e.posterior.evidence)
    try:
        found = fit(best, recordings, FINAL_ITERATIONS, loss=TO_REPORT)
    except SimulationError:
        return at
    return best if best.mean_err < CLEARLY_LESS * found.mean_err else found


def nearest(at: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """A fit as near to the shapes as it can come, where even so it leaves something that matters.

    There its likelihood is that of a wrong model: it follows what is rapid at the cost of errors
    that stay, and what it foretells is off by as much.
    """
    matters = material_err(own_err(at, recordings), at.model.settings)
    if at.mean_err < matters:
        return at
    near = approached(at, recordings)
    return at if near.mean_err < matters else near


def _over(at: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """The model of a fit, held against other recordings, or other parts of the same.

    Raises:
        SimulationError: it cannot be simulated.
    """
    frames = [len(e) for e in at.err]
    if len(recordings) == len(frames) and all(
        len(r.times) <= f for r, f in zip(recordings, frames, strict=True)
    ):
        return rejudged(borrowed(at, at.model, recordings))
    return evaluate(for_recordings(at.model, recordings), recordings)


def errors_of(
    model: ParametricModel, recordings: Sequence[Recording], masks: Sequence[np.ndarray]
) -> Errors:
    """Errors of a model.

    Args:
        masks: frames of each recording that are held out, shape (F,).
    """
    try:
        err = simulate(model, recordings, ()).err
    except SimulationError:
        return Errors()
    masks = [m[-len(e) :] for m, e in zip(masks, err, strict=True)]
    held = [e[m] for e, m in zip(err, masks, strict=True) if m.any()]
    seen = [e[~m] for e, m in zip(err, masks, strict=True) if not m.all()]
    return Errors(held, seen)
