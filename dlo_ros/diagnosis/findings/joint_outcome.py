# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The joint model's result: measured on held-out data, with numbers and in words."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.explain.certainty import far_off
from dlo_ros.diagnosis.explain.exact_setup import opened
from dlo_ros.diagnosis.explain.explanation import Explanation, still_certain
from dlo_ros.diagnosis.explain.measurement_error import material_err, own_err
from dlo_ros.diagnosis.findings import holdout
from dlo_ros.diagnosis.findings.confirmed_uncertainty import Widening, confirmed
from dlo_ros.diagnosis.findings.diagnosis_outcome import (
    Candidate,
    Diagnosis,
    Fitted,
    NamedEffect,
    Verdict,
)
from dlo_ros.diagnosis.findings.joint_learning import (
    FINAL_ITERATIONS,
    Errors,
    Learned,
    errors_of,
    nearest,
    refitted,
)
from dlo_ros.diagnosis.findings.joint_numbers import (
    at_guessed_scale,
    damping_as_effects,
    effect_numbers,
    fitted_material,
    plain_material,
    reported_covariance,
    set_up_numbers,
    systematic_errors,
    with_plain_values,
)
from dlo_ros.diagnosis.findings.next_recording import advice
from dlo_ros.diagnosis.findings.resolved_extents import with_resolved_extents
from dlo_ros.diagnosis.findings.rest_change import rest_change
from dlo_ros.diagnosis.findings.shape_views import views
from dlo_ros.diagnosis.findings.soft_axis import with_soft_axis
from dlo_ros.diagnosis.residuals.relations import relations, sentences
from dlo_ros.errors import SimulationError
from dlo_ros.identification.identifiability import rounded
from dlo_ros.identification.offline.initial_fit import Beginning
from dlo_ros.identification.offline.without_own_error import without_own_error
from dlo_ros.identification.residual_noise import whitened
from dlo_ros.inference.fixed_errors import shifts_by_fixed_errors
from dlo_ros.inference.joint import Evaluation, Simulated, simulate
from dlo_ros.inference.joint_fit import fit, nearest_err
from dlo_ros.inference.losses import TO_REPORT
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import OWN
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Final:
    """An explanation that holds in all recordings that may be learned from.

    Args:
        learned: what it was learned from, and its errors.
        found: the explanation, with those causes alone that are still certain.
        at: its model fitted to them.
        wider: factors of the standard deviations.
        shown: the same model as the report shows it.
    """

    learned: Learned
    found: Explanation
    at: Evaluation
    wider: Widening
    shown: Simulated


def joint_outcome(
    beginning: Beginning, plain: Evaluation, learned: Learned, given: Settings
) -> Diagnosis:
    """Measure ERR on held-out data, fit the model to all recordings, and put all together.

    Args:
        learned: what was learned, with the names of causes.

    Raises:
        SimulationError: a recording cannot be simulated, with the set-up alone either.
    """
    recordings = beginning.recordings
    first = recordings[: len(plain.err)]
    known = [k for k in range(len(first)) if not learned.masks[k].all()]
    final = _final(learned, first, known, given)
    found, at, shown = final.found, final.at, final.shown
    own = own_err(at, first) if len(at.err) == len(first) else found.own_err
    matters = material_err(own, given)
    bare_model = holdout.fitted_to_seen(plain.model, first, learned.seen[: len(first)], matters)
    before = errors_of(bare_model, recordings, learned.masks)
    immaterial = plain.mean_err < matters
    suffices = not found.causes and (immaterial or _no_nearer(final.learned.err.seen, before.seen))
    after = final.learned.err
    if suffices:  # what was fitted beyond the plain model predicts nothing better
        after, shown = before, plain
    seen_before, held_before = holdout.mean(before.seen), holdout.mean(before.held)
    held_after = holdout.mean(after.held)
    left = found.at.mean_err if held_after is None else held_after
    share = _share(seen_before if held_before is None else held_before, left, own)
    # A recording that is held out and cannot be fitted beside the others is not explained.
    least = 0.0 if len(at.err) == len(first) else left
    if suffices:
        setup = reached = plain.mean_err
    else:
        setup = _set_up_err(found, at, first, known, matters)
        # A fit to all that lies farther off than what was predicted has only ended early.
        reached = min(at.mean_err, final.learned.mean_err or np.inf)
    verdict = _verdict(
        setup, max(reached, least), matters, found.nameable_err, found.causes, _of_itself(found)
    )
    missed = (seen_before or 0.0) - own
    related_before = related_after = changed = None
    if verdict == "unexplained":
        changed = rest_change(shown, first, matters)
        related_before, related_after = (
            relations(first, whitened(e, first), e.predicted, e.model.settings)
            for e in (plain, shown)
        )
    remark = _left_over(share, left, matters, suffices=suffices)
    extended = _extended(final, after, given)
    return Diagnosis(
        verdict=verdict,
        effects=tuple(_effect(c, final, given, missed) for c in found.causes),
        noise_floor=own,
        baseline=plain_material(plain.model.settings, seen_before, held_before),
        extended=with_plain_values(extended, plain.model.settings) if suffices else extended,
        gain=holdout.gain(before.held, after.held),
        candidates=_tried(found),
        advice=advice(verdict, found, changed),
        simulation_error=None if np.isnan(beginning.error) else beginning.error,
        remarks=(remark, *(sentences(related_after) if related_after is not None else ())),
        views=views(recordings, plain, shown, learned.masks, given),
        relations_before=related_before,
        relations_after=related_after,
        material_err=matters,
        share=share,
        setup=set_up_numbers(opened(at), found.causes, given, found.doubts),
        systematic=systematic_errors(at),
        trace=found.trace,
        uncertain=tuple(_effect(c, final, given, missed) for c in found.uncertain),
    )


def _final(
    learned: Learned, recordings: Sequence[Recording], known: Sequence[int], given: Settings
) -> _Final:
    """The explanation fitted to all recordings that may be learned from, or the set-up alone.

    Args:
        known: numbers of those that it was learned from.

    Raises:
        SimulationError: a recording cannot be simulated with either.
    """
    found = learned.explanation
    told = {c.effect for c in found.causes}
    recordings = with_resolved_extents(recordings, found.at.model.settings, told)
    at = _completed(found.at, recordings, known, learned.predicting)
    compared = recordings
    if len(at.err) == len(recordings):
        at, compared = without_own_error(at, recordings)
        if compared is not recordings:  # otherwise that fit is at its end, or was refused
            at = fit(at, compared, FINAL_ITERATIONS, loss=TO_REPORT)
    fitted_to = compared if len(at.err) == len(recordings) else [recordings[k] for k in known]
    at = with_soft_axis(at_guessed_scale(at), fitted_to, given)
    wider = confirmed(at, compared, found.causes)
    found = replace(found, shifts={**found.shifts, **shifts_by_fixed_errors(at, compared)})
    covariance = reported_covariance(at, wider.parameters, found.doubts)
    found = still_certain(found, at, covariance)
    at = nearest(at, fitted_to)
    try:
        shown = simulate(replace(at.model, parameters=()), recordings)
        return _Final(learned, found, at, wider, shown)
    except SimulationError as err:
        if found.at is found.setup:
            raise
        LOG.warning("the model with its causes is dropped, since it does not hold: %s", err)
    alone = replace(found, at=found.setup, causes=(), proposals=(), exact=False)
    bare = replace(learned, explanation=alone, err=Errors(), predicting=None)
    return _final(bare, recordings, known, given)


def _no_nearer(after: Sequence[FloatArray] | None, before: Sequence[FloatArray] | None) -> bool:
    """Whether the full model is no nearer than the plain one to what both were learned from.

    Beside a cause that it does not contain, such as an impact, a fit of the set-up is wrong a
    little in all pictures, where the plain model is wrong in few.
    """
    there, here = holdout.mean(after), holdout.mean(before)
    return there is not None and here is not None and there >= here


def _set_up_err(
    found: Explanation, final: Evaluation, recordings: Sequence[Recording], known: Sequence[int],
    matters: float,
) -> float:  # fmt: skip
    """ERR to which the set-up without causes can come [m], of all recordings where that decides."""
    bare = final if found.setup is found.at else found.setup
    if bare.mean_err < matters or not found.causes:  # of what was learned from: is it so of all?
        bare = bare if bare is final else _completed(bare, recordings, known)
        if len(bare.err) == len(recordings) and bare.mean_err >= matters:
            return nearest_err(bare, recordings)
    return bare.mean_err


def _extended(final: _Final, errors: Errors, given: Settings) -> Fitted:
    """The full model as it is reported."""
    fitted = fitted_material(
        final.at, holdout.mean(errors.seen), holdout.mean(errors.held),
        final.wider.material, final.found.doubts,
    )  # fmt: skip
    named = [c.effect for c in final.found.causes]
    return replace(fitted, settings=damping_as_effects(final.at.model.settings, given, named))


def _completed(
    at: Evaluation, recordings: Sequence[Recording], known: Sequence[int],
    predicting: Evaluation | None = None,
) -> Evaluation:  # fmt: skip
    """The model fitted to all recordings, or as it was where that fit is worse.

    A recording with a cause of its own distorts all numbers.

    Args:
        at: fitted to those that are known.
        known: numbers of these.
        predicting: see `Learned`.
    """
    found = refitted(at, recordings, predicting)
    if len(found.err) != len(recordings) or len(known) == len(recordings):
        return found
    spoilt = np.mean([found.err[k].mean() for k in known]) > OWN * at.mean_err
    return at if spoilt else found


def _verdict(
    setup: float,
    after: float,
    matters: float,
    nameable: float,
    causes: Sequence[Cause],
    of_itself: Collection[str] = (),
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
        of_itself: effects among them whose work the set-up does within its tolerances.
    """
    if setup < matters and all(c.effect in of_itself or c.err < matters for c in causes):
        return "adequate"
    if after >= matters:
        return "unexplained"
    if causes:
        return "explained"
    return "adequate" if setup - after < nameable else "unexplained"


def _of_itself(found: Explanation) -> set[str]:
    """Causes whose work a set-up does within its tolerances: those of one as precise as the data
    tell, but for its numbers that lie far beyond their tolerance in the fit of the set-up, too.
    """
    if not found.exact:
        return set()
    return {c.effect for c in found.causes} - {g.effect for g in far_off(found.setup)}


def _share(before: float | None, after: float | None, own: float) -> float | None:
    """Share of ERR beyond the measurement's own that is taken away, 0 to 1."""
    if before is None or after is None or before <= own:
        return None
    return float(np.clip((before - max(after, own)) / (before - own), 0.0, 1.0))


def _left_over(share: float | None, left: float, matters: float, *, suffices: bool) -> str:
    """A sentence on what is explained and what is left.

    Args:
        share: share of what the plain model misses that is explained; None: unknown.
        left: ERR that is left [m].
        matters: ERR below which nothing is left to explain [m].
        suffices: whether the plain model does as well.
    """
    remains, immaterial = (f"{rounded(1e3 * x)} mm" for x in (left, matters))
    if suffices:
        return f"The plain model misses {remains}; {immaterial} would be immaterial."
    known = "An unknown share" if share is None else f"{100.0 * share:.0f} %"
    return (
        f"{known} of what the plain model misses beyond the measurement's own error is explained; "
        f"{remains} remain, and {immaterial} would be immaterial."
    )


def _effect(cause: Cause, final: _Final, given: Settings, missed: float) -> NamedEffect:
    """A cause with its numbers and its share.

    Args:
        given: the parameter file.
        missed: error of the plain model on the recordings learned from, beyond the measurement's
            own [m].
    """
    share = (cause.err - cause.near) / missed if missed > 0.0 else None
    return NamedEffect(
        cause.effect,
        effect_numbers(cause.effect, final.at, given, final.wider.parameters, final.found.doubts),
        tuple(cause.rivals), None if share is None else float(np.clip(share, 0.0, 1.0)),
        cause.rivals,
    )  # fmt: skip


def _tried(found: Explanation) -> tuple[Candidate, ...]:
    """The best of each effect's trials: minus twice its log evidence over that without it."""
    best: dict[str, float] = {}
    for step in found.trace:
        effect, _, _ = step.name.partition(" (")  # what follows is where it began
        best[effect] = max(step.gain, best.get(effect, -np.inf))
    order = sorted(best.items(), key=lambda row: -row[1])
    return tuple(Candidate(name, -2.0 * gain) for name, gain in order)
