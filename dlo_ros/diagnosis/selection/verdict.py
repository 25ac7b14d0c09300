# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The verdict on fitted candidates; each finding is named with its rivals.

Where more is wrong than that, the joint model takes over, with rules of its own
(`dlo_ros.diagnosis.explain.joint_explanation`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import geometric_mean
from typing import Literal

import numpy as np

from dlo_ros.diagnosis.residuals import residual_autocovariance
from dlo_ros.diagnosis.selection.effect_search import Candidate
from dlo_ros.spline import FloatArray

Verdict = Literal["adequate", "explained", "unexplained"]

NOTHING = 0.5
"""Root autocovariance of the residuals, in units of the noise of one frame, that counts as none:
ERR rises by an eighth."""
FAINT = 0.9
"""Root autocovariance up to which it counts as none, too, unless one cause takes nearly all of it
away: it raises ERR by a third, and another simulation of the same rope may differ as much."""
FAINT_LEFT = 0.33
"""Largest root autocovariance that the cause of a faint one leaves, over that before."""
EXPLAINED = 0.75
"""Largest root autocovariance that an explanation leaves, in units of the noise of one frame; an
effect that was added has been fitted to what it explains."""
SHARE_LEFT = 0.025
"""Largest root autocovariance that the right cause leaves, over that before: the laws of real DLOs
are not quite ours."""
MOST_LEFT = 2.0
"""Root autocovariance above which nothing counts as explained, whatever it was before."""
AS_GOOD = 0.6
"""Root autocovariance that one explanation may have beyond another and still rank beside it."""
SIGNIFICANT_STDS = 3.0
"""Standard errors by which one explanation must be better than another to exclude it."""
CONFIRMED = 1.5
"""ERR on held-out data, over the best one's, with which an explanation still holds."""
SUSPECTED = 2.0
"""Largest ERR on held-out data, over the best one's, of a suspect where nothing explains them."""
SUSPECTS = 8
"""Largest number of suspects."""
SURE_LEFT = 0.35
"""Largest ERR over that before, of a model that explains a part for certain."""
SURE_SHARE = 0.4
"""ERR, and that on held-out data, over those of every model that lacks an effect."""
TINY = 1e-12
"""ERR [m] that counts as none."""
EQUAL_PREDICTION = 1.25
"""ERR on held-out data, over the best one's, up to which few pictures do not exclude a rival."""
ALIKE = 2.0
"""Ratio of root autocovariances up to which explanations rank as alike."""


@dataclass(frozen=True)
class SufficientEffects:
    """A set of effects that brings the residual down to the noise.

    Args:
        effects: names of the effects in the order in which they were found.
        candidate: the fit.
    """

    effects: tuple[str, ...]
    candidate: Candidate


@dataclass(frozen=True)
class Decision:
    """The verdict, the chosen explanation and its rivals.

    Args:
        verdict: see interface.md.
        chosen: the explanation; None where there is none or none is needed.
        rivals: names for each effect of the chosen explanation.
    """

    verdict: Verdict
    chosen: SufficientEffects | None
    rivals: tuple[tuple[str, ...], ...] = ()


def limit(before: float) -> float:
    """Root autocovariance of the residuals up to which an extended model explains the data.

    Args:
        before: root autocovariance of the plain model.
    """
    if before < FAINT:
        return FAINT_LEFT * before
    return max(EXPLAINED, min(SHARE_LEFT * before, MOST_LEFT))


def adequate(residuals: Sequence[FloatArray]) -> bool:
    """Whether the residuals of the plain model are no more than noise.

    Args:
        residuals: see `residual_autocovariance.root_autocovariance`.
    """
    root_autocovariance = residual_autocovariance.root_autocovariance(residuals)
    return root_autocovariance < NOTHING or (
        excusable(residuals) and root_autocovariance < residual_autocovariance.chance(residuals)
    )


def excusable(residuals: Sequence[FloatArray]) -> bool:
    """Whether residuals may be correlated by chance, for which many pictures leave little room."""
    pictures = sum(len(r) for r in residuals)
    return (
        pictures < residual_autocovariance.FEW
        or residual_autocovariance.root_autocovariance(residuals) < FAINT
    )


def explains(candidate: Candidate, most: float) -> bool:
    """Whether a candidate's residuals are hardly correlated, or as far as chance in few pictures.

    Args:
        most: see `limit`.
    """
    if candidate.root_autocovariance <= most:
        return True
    pictures = sum(len(r) for r in candidate.at.residuals)
    few = candidate.root_autocovariance <= MOST_LEFT and pictures < residual_autocovariance.FEW
    return few and candidate.root_autocovariance < residual_autocovariance.chance(
        candidate.at.residuals
    )


def best_forms(
    candidates: Sequence[Candidate], wanted: Callable[[Candidate], bool] = lambda c: True
) -> list[Candidate]:
    """The best wanted candidate of each set of effects, best first."""
    found: dict[tuple[str, ...], Candidate] = {}
    for c in sorted(candidates, key=lambda c: c.score):
        key = tuple(sorted(c.at.model.effects))
        if key not in found and wanted(c):
            found[key] = c
    return list(found.values())


def explanations(candidates: Sequence[Candidate], most: float) -> list[SufficientEffects]:
    """The candidates that explain the data, one form of each set of effects, best first."""
    return [
        SufficientEffects(c.at.model.effects, c)
        for c in best_forms(candidates, lambda c: explains(c, most))
    ]


def sure(
    plain: Candidate,
    candidates: Sequence[Candidate],
    holdout_err: Callable[[Candidate], float | None],
) -> tuple[SufficientEffects, tuple[tuple[str, ...], ...]] | None:
    """Effects of an incomplete model that are certain: every model without them is much worse.

    They are judged by ERR, in which every recording counts the same: where no model is right, the
    residuals are no noise.

    Args:
        plain: the model without any of the effects.
        candidates: all that were fitted.
        holdout_err: see `confirmed`.

    Returns:
        The best candidate with those of its effects that are certain, and of each its rivals,
        which all have that is not much worse without it. None where nothing is certain.
    """
    known = set(plain.at.model.effects)
    best = min(candidates, key=_missed, default=None)
    if best is None or _missed(best) > SURE_LEFT * _missed(plain):
        return None
    err = holdout_err(best)
    found: dict[str, tuple[str, ...]] = {}
    for effect in best.at.model.effects:
        if effect in known:
            continue
        without = [c for c in (plain, *candidates) if effect not in c.at.model.effects]
        near = [c for c in without if _missed(c) < _missed(best) / SURE_SHARE]
        rivals = _stand_ins(near, known | set(best.at.model.effects))
        if rivals is None:
            continue
        rest = [c for c in without if not set(rivals) & set(c.at.model.effects)]
        other = holdout_err(min(rest, key=_missed))
        if err is not None and other is not None and err < SURE_SHARE * other:
            found[effect] = rivals
    return (SufficientEffects(tuple(found), best), tuple(found.values())) if found else None


def _missed(c: Candidate) -> float:
    """ERR [m], the geometric mean over recordings."""
    return geometric_mean([max(float(np.mean(e)), TINY) for e in c.at.err])


def _stand_ins(candidates: Sequence[Candidate], not_these: set[str]) -> tuple[str, ...] | None:
    """The effects that all candidates have in common; None where there are none."""
    if not candidates:
        return ()
    shared = set.intersection(*(set(c.at.model.effects) for c in candidates)) - not_these
    return tuple(sorted(shared)) or None


def confirmed(
    found: Sequence[SufficientEffects],
    before: float | None,
    holdout_err: Callable[[Candidate], float | None],
    *,
    up_to: float = CONFIRMED,
) -> list[SufficientEffects]:
    """The explanations that also hold on the held-out data.

    Args:
        found: explanations, best first.
        before: ERR of the plain model there [m].
        holdout_err: ERR of a candidate on held-out data [m]; None where it cannot be simulated.
        up_to: ERR over the least, with which one holds.
    """
    errors = [holdout_err(e.candidate) for e in found]
    known = [e for e in (*errors, before) if e is not None]
    if not known:
        return []
    most = up_to * min(known)
    return [e for e, err in zip(found, errors, strict=True) if err is not None and err <= most]


def suspects(
    candidates: Sequence[Candidate], holdout_err: Callable[[Candidate], float | None]
) -> list[Candidate]:
    """The candidates that come nearest where none explains the data, best first; no findings.

    Args:
        candidates: all that were fitted.
        holdout_err: see `confirmed`.
    """
    forms = best_forms(candidates)
    if not forms:
        return []
    least = min(c.root_autocovariance for c in forms)
    near = [c for c in forms if c.root_autocovariance < ALIKE * least][:SUSPECTS]
    found = [SufficientEffects(c.at.model.effects, c) for c in near]
    held = confirmed(found, None, holdout_err, up_to=SUSPECTED)
    return [e.candidate for e in held]


def as_good(best: Candidate, other: Candidate) -> bool:
    """Whether another explanation cannot be excluded, since it is as good within the noise."""
    gap = residual_autocovariance.compare(best.at.residuals, other.at.residuals)
    if gap.difference < SIGNIFICANT_STDS * gap.std and other.root_autocovariance < ALIKE * max(
        best.root_autocovariance, AS_GOOD
    ):
        return True
    return other.root_autocovariance**2 < max(best.root_autocovariance, 0.0) ** 2 + AS_GOOD**2


def equal_predictors(
    best: Candidate,
    candidates: Sequence[Candidate],
    holdout_err: Callable[[Candidate], float | None],
) -> list[SufficientEffects]:
    """Explanations that predict as well as the best and fit worse, where pictures are few.

    Few pictures determine the noise poorly; then held-out data decide better.
    """
    pictures = sum(len(r) for r in best.at.residuals)
    err = holdout_err(best)
    if pictures >= residual_autocovariance.FEW or err is None:
        return []

    def as_well(c: Candidate) -> bool:
        if (
            len(c.at.model.effects) != len(best.at.model.effects)
            or c.root_autocovariance >= MOST_LEFT
        ):
            return False
        other = holdout_err(c)
        return other is not None and other < EQUAL_PREDICTION * err

    return [SufficientEffects(c.at.model.effects, c) for c in best_forms(candidates, as_well)]


def choose(
    found: Sequence[SufficientEffects], others: Sequence[SufficientEffects] = ()
) -> Decision:
    """The best explanation and its rivals.

    Args:
        found: explanations with equally many effects, best first.
        others: further rivals, see `equal_predictors`.
    """
    best = found[0]
    alike = [e for e in found[1:] if as_good(best.candidate, e.candidate)]
    alike += [e for e in others if e.candidate is not best.candidate]
    rivals = []
    for effect in best.effects:
        rest = set(best.effects) - {effect}
        # Whoever takes its place beside the others, or makes them unnecessary.
        names = [n for e in alike for n in e.effects if n not in best.effects]
        fitting = [
            n for e in alike for n in e.effects
            if n not in best.effects and rest <= set(e.effects)
        ]  # fmt: skip
        rivals.append(tuple(dict.fromkeys(fitting if len(best.effects) > 1 else names)))
    return Decision("explained", best, tuple(rivals))
