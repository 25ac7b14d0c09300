# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The findings of a search, measured on held-out data, as numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.explain.measurement_error import material_err, mean_length
from dlo_ros.diagnosis.findings import holdout
from dlo_ros.diagnosis.findings.diagnosis_outcome import Diagnosis, NamedEffect, Trial
from dlo_ros.diagnosis.findings.experiment_advice import advise
from dlo_ros.diagnosis.findings.fitted_numbers import (
    damping_numbers,
    fitted,
    numbers,
    own_error,
)
from dlo_ros.diagnosis.findings.joint_learning import Learned
from dlo_ros.diagnosis.findings.joint_outcome import joint_outcome
from dlo_ros.diagnosis.findings.remarks import remarks
from dlo_ros.diagnosis.findings.shape_views import views
from dlo_ros.diagnosis.fitting.evaluation import is_differentiable
from dlo_ros.diagnosis.fitting.initial_fit import Beginning
from dlo_ros.diagnosis.fitting.levenberg_marquardt import polished
from dlo_ros.diagnosis.fitting.recording_noise import noise_floor
from dlo_ros.diagnosis.residuals.relations import Relations, relations, sentences
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_search import Candidate, candidate
from dlo_ros.effects.start import Block
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings


@dataclass(frozen=True)
class Findings:
    """The result of the search.

    Args:
        singles: fits of single effects.
        joint: the joint model's explanation, where that takes the place of single effects.
        sharper: the initial fit with a finer simulation, with which the search is to begin anew;
            None where the simulation is fine enough.
    """

    decision: verdict.Decision
    holdout_errors: holdout.HoldoutErrors
    singles: tuple[Candidate, ...] = ()
    joint: Learned | None = None
    sharper: Beginning | None = None

    @property
    def suspects(self) -> list[Candidate]:
        """The candidates that come nearest, whether they explain the data or not, best first."""
        return verdict.suspects(self.singles, self.holdout_errors)


def outcome(beginning: Beginning, plain: Candidate, found: Findings, given: Settings) -> Diagnosis:
    """The diagnosis of a search, with ERR measured on the held-out data."""
    if found.joint is not None:
        return joint_outcome(beginning, plain, found.joint, given)
    recordings = beginning.recordings
    holdout_errors = found.holdout_errors
    decision = _immaterial(found.decision, plain, given, recordings[: len(plain.at.residuals)])
    parted = holdout_errors.parted
    count = len(plain.at.residuals)
    learned = recordings[:count]
    best = _polished(decision.chosen.candidate, learned, given) if decision.chosen else plain
    models = [
        holdout.refitted(c.at, learned, parted.train[:count], given) for c in (plain, best)
    ]  # fmt: skip
    train = [holdout.errors(m, recordings, parted.train, given) for m in models]
    kept = [holdout.errors(m, recordings, parted.holdout, given) for m in models]
    own = own_error(best.at, learned, given)
    effects: tuple[NamedEffect, ...] = ()
    if decision.chosen is not None:
        others = [
            c for c in found.singles
            if c is not decision.chosen.candidate
            and set(c.at.model.effects) == set(best.at.model.effects) and verdict.as_good(best, c)
        ]  # fmt: skip
        # Without derivatives they only tell how far its numbers may be off.
        alike = [
            _polished(c, learned, given).at if is_differentiable(c.at.model) else c.at
            for c in others
        ]
        effects = tuple(
            NamedEffect(
                name,
                numbers(best.at, name, given, alike, own),
                rivals,
                rival_values=_values(name, rivals, found.singles),
            )
            for name, rivals in zip(decision.chosen.effects, decision.rivals, strict=True)
            if name in best.at.model.effects and name not in plain.at.model.effects
        )
    tried = []
    for c in verdict.best_forms([plain, *found.singles]):
        err = holdout_errors.linearised_err(c)
        label = "+".join(n for n in c.at.model.effects if n not in plain.at.model.effects)
        tried.append(Trial(label or "none", err, c.score, c.root_autocovariance))
    floors = [noise_floor(r, p, given) for r, p in zip(learned, best.at.predicted, strict=True)]
    suspects = found.suspects if decision.verdict == "unexplained" else []
    shown = suspects[0] if suspects else best
    before, after = (
        _related(c, learned) if decision.verdict != "adequate" else None for c in (plain, shown)
    )
    return Diagnosis(
        decision.verdict,
        effects,
        float(np.mean(floors)),
        fitted(plain.at, given, holdout.mean(train[0]), holdout.mean(kept[0])),
        fitted(best.at, given, holdout.mean(train[1]), holdout.mean(kept[1]), own),
        holdout.gain(kept[0], kept[1]),
        tuple(tried),
        advise(decision, found.singles, learned, given),
        None if np.isnan(beginning.error) else beginning.error,
        (*remarks(plain, best, suspects, decision), *_left(after, decision)),
        views(recordings, plain.at, best.at, parted.holdout, given),
        before,
        after if shown is not plain else None,
        material_err(float(np.mean(floors)), given),
        setup=damping_numbers(best.at, given, own),
    )


def _values(
    effect: str, rivals: Sequence[str], candidates: Sequence[Candidate]
) -> dict[str, Block]:
    """Values of the rivals of an effect in the best fits that are without it."""
    found: dict[str, Block] = {}
    for c in sorted(candidates, key=lambda c: c.score):
        block = c.at.model.settings.effects
        if effect not in block:
            found = {n: block[n] for n in rivals if n in block} | found
    return found


def _immaterial(
    decision: verdict.Decision, plain: Candidate, given: Settings, recordings: Sequence[Recording]
) -> verdict.Decision:
    """The decision; residuals that nothing explains are ignored where they are immaterial."""
    if decision.verdict != "unexplained" or not is_immaterial(plain, given, recordings):
        return decision
    return replace(decision, verdict="adequate")


def is_immaterial(plain: Candidate, given: Settings, recordings: Sequence[Recording]) -> bool:
    """Whether the ERR of the plain model is too small to matter."""
    err = holdout.mean(plain.at.err)
    along = float(np.mean([r.along_std for r in recordings]))
    return err is not None and err < material_err(mean_length(np.array([along])), given)


def _related(c: Candidate, recordings: Sequence[Recording]) -> Relations:
    """The inputs that the residual of a candidate depends on."""
    at = c.at
    return relations(recordings, at.residuals, at.predicted, at.model.settings)


def _left(found: Relations | None, decision: verdict.Decision) -> tuple[str, ...]:
    """Remark on the residual where nothing explains the data."""
    return sentences(found) if found is not None and decision.verdict == "unexplained" else ()


def _polished(c: Candidate, recordings: Sequence[Recording], given: Settings) -> Candidate:
    """A candidate whose numbers are reported, with a finished fit."""
    return candidate(c.effect, c.form, polished(c.at, recordings, given), given)
