# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From fitted candidates of one effect or two to a verdict; each is named with all its rivals.

Where more is wrong than that, the joint model takes over, by rules of its own
(`dlo_ros.diagnosis.explain.joint_explanation`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import geometric_mean
from typing import Literal

import numpy as np

from dlo_ros.diagnosis.residuals import residual_structure
from dlo_ros.diagnosis.selection.effect_search import Candidate
from dlo_ros.spline import FloatArray

Verdict = Literal["adequate", "explained", "unexplained"]

NOTHING = 0.5
"""Structure, in units of the noise of one frame, that counts as none: ERR rises by an eighth."""
FAINT = 0.9
"""Structure up to which it counts as none, too, unless one cause takes nearly all of it away: it
raises ERR by a third, and another simulation of the same rope may differ as much."""
FAINT_LEFT = 0.33
"""Largest residual structure of the cause of a faint one, over the structure before."""
EXPLAINED = 0.75
"""Largest residual structure of an explanation, in units of the noise of one frame; an effect that
was added has been fitted to what it explains."""
SHARE_LEFT = 0.025
"""Largest residual structure of the right cause, over the structure before: the laws of real DLOs
are not quite ours."""
MOST_LEFT = 2.0
"""Structure above which nothing counts as explained, whatever it was before."""
AS_GOOD = 0.6
"""Structure that one explanation may have beyond another and still rank beside it."""
SIGNIFICANT_STDS = 3.0
"""Standard errors by which one explanation must be better than another to exclude it."""
CONFIRMED = 1.5
"""ERR on what is kept aside, over the best one's, with which an explanation still holds."""
SUSPECTED = 2.0
"""Largest ERR on held-out data, over the best one's, of a suspect where nothing explains them."""
SUSPECTS = 8
"""Largest number of suspects."""
SURE_LEFT = 0.35
"""Largest ERR over that before, of a model that explains a part for certain."""
SURE_SHARE = 0.4
"""ERR, and that on what is kept aside, over those of everything that lacks an effect."""
TINY = 1e-12
"""ERR [m] that counts as none."""
FORETOLD = 1.25
"""ERR on what is kept aside, over the best one's, with which few pictures exclude nothing."""
ALIKE = 2.0
"""Ratio of leftover structure up to which explanations rank as alike."""


@dataclass(frozen=True)
class SufficientEffects:
    """A set of effects that brings the residual down to the noise.

    Args:
        effects: their names, the first found first.
        candidate: the fit.
    """

    effects: tuple[str, ...]
    candidate: Candidate


@dataclass(frozen=True)
class Decision:
    """What the data allow to say.

    Args:
        verdict: see interface.md.
        chosen: the explanation; None where there is none or none is needed.
        rivals: names for each effect of the chosen explanation.
    """

    verdict: Verdict
    chosen: SufficientEffects | None
    rivals: tuple[tuple[str, ...], ...] = ()


def limit(before: float) -> float:
    """Structure up to which an extended model explains the data.

    Args:
        before: structure that the plain model leaves.
    """
    if before < FAINT:
        return FAINT_LEFT * before
    return max(EXPLAINED, min(SHARE_LEFT * before, MOST_LEFT))


def adequate(residuals: Sequence[FloatArray]) -> bool:
    """Whether what the plain model leaves over is noise.

    Args:
        residuals: see `residual_structure.structure`.
    """
    structure = residual_structure.structure(residuals)
    return structure < NOTHING or (
        excusable(residuals) and structure < residual_structure.chance(residuals)
    )


def excusable(residuals: Sequence[FloatArray]) -> bool:
    """Whether structure may be there by chance: of many pictures the noise is known well."""
    pictures = sum(len(r) for r in residuals)
    return pictures < residual_structure.FEW or residual_structure.structure(residuals) < FAINT


def explains(candidate: Candidate, most: float) -> bool:
    """Whether a candidate leaves little, or no more than a few pictures have by chance.

    Args:
        most: see `limit`.
    """
    if candidate.structure <= most:
        return True
    pictures = sum(len(r) for r in candidate.at.residuals)
    few = candidate.structure <= MOST_LEFT and pictures < residual_structure.FEW
    return few and candidate.structure < residual_structure.chance(candidate.at.residuals)


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
    """The candidates that leave no structure, one form of each set of effects, best first."""
    return [
        SufficientEffects(c.at.model.effects, c)
        for c in best_forms(candidates, lambda c: explains(c, most))
    ]


def sure(
    plain: Candidate,
    candidates: Sequence[Candidate],
    kept_aside: Callable[[Candidate], float | None],
) -> tuple[SufficientEffects, tuple[tuple[str, ...], ...]] | None:
    """What is certain although structure remains: without it, everything is much worse.

    Judged by ERR, every recording counting the same: where no model is right, what each misses is
    no noise.

    Args:
        plain: the model without any of the effects.
        candidates: all that were fitted.
        kept_aside: see `confirmed`.

    Returns:
        The best candidate with those of its effects that are certain, and of each its rivals,
        which all have that is not much worse without it. None where nothing is certain.
    """
    known = set(plain.at.model.effects)
    best = min(candidates, key=_missed, default=None)
    if best is None or _missed(best) > SURE_LEFT * _missed(plain):
        return None
    err = kept_aside(best)
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
        other = kept_aside(min(rest, key=_missed))
        if err is not None and other is not None and err < SURE_SHARE * other:
            found[effect] = rivals
    return (SufficientEffects(tuple(found), best), tuple(found.values())) if found else None


def _missed(c: Candidate) -> float:
    """ERR [m], the geometric mean over recordings."""
    return geometric_mean([max(float(np.mean(e)), TINY) for e in c.at.err])


def _stand_ins(candidates: Sequence[Candidate], not_these: set[str]) -> tuple[str, ...] | None:
    """The effects that all candidates have; None where they have none in common."""
    if not candidates:
        return ()
    shared = set.intersection(*(set(c.at.model.effects) for c in candidates)) - not_these
    return tuple(sorted(shared)) or None


def confirmed(
    found: Sequence[SufficientEffects],
    before: float | None,
    kept_aside: Callable[[Candidate], float | None],
    *,
    up_to: float = CONFIRMED,
) -> list[SufficientEffects]:
    """Those explanations that also hold on what was kept aside.

    Args:
        found: explanations, best first.
        before: ERR of the plain model there [m].
        kept_aside: ERR of a candidate there [m]; None where it cannot be simulated.
        up_to: ERR over the least, with which one holds.
    """
    errors = [kept_aside(e.candidate) for e in found]
    known = [e for e in (*errors, before) if e is not None]
    if not known:
        return []
    most = up_to * min(known)
    return [e for e, err in zip(found, errors, strict=True) if err is not None and err <= most]


def suspects(
    candidates: Sequence[Candidate], kept_aside: Callable[[Candidate], float | None]
) -> list[Candidate]:
    """What comes nearest where nothing explains the data, best first: none of it is a finding.

    Args:
        candidates: all that were fitted.
        kept_aside: see `confirmed`.
    """
    forms = best_forms(candidates)
    if not forms:
        return []
    least = min(c.structure for c in forms)
    near = [c for c in forms if c.structure < ALIKE * least][:SUSPECTS]
    found = [SufficientEffects(c.at.model.effects, c) for c in near]
    held = confirmed(found, None, kept_aside, up_to=SUSPECTED)
    return [e.candidate for e in held]


def as_good(best: Candidate, other: Candidate) -> bool:
    """Whether another explanation cannot be excluded: within the noise, or nearly so."""
    gap = residual_structure.compare(best.at.residuals, other.at.residuals)
    if gap.difference < SIGNIFICANT_STDS * gap.std and other.structure < ALIKE * max(
        best.structure, AS_GOOD
    ):
        return True
    return other.structure**2 < max(best.structure, 0.0) ** 2 + AS_GOOD**2


def foretold(
    best: Candidate,
    candidates: Sequence[Candidate],
    kept_aside: Callable[[Candidate], float | None],
) -> list[SufficientEffects]:
    """What predicts as well as the best although it leaves more over, where pictures are few.

    A few pictures tell little of what is noise and what is not; what was kept aside tells more.
    """
    pictures = sum(len(r) for r in best.at.residuals)
    err = kept_aside(best)
    if pictures >= residual_structure.FEW or err is None:
        return []

    def as_well(c: Candidate) -> bool:
        if len(c.at.model.effects) != len(best.at.model.effects) or c.structure >= MOST_LEFT:
            return False
        other = kept_aside(c)
        return other is not None and other < FORETOLD * err

    return [SufficientEffects(c.at.model.effects, c) for c in best_forms(candidates, as_well)]


def without_idle(best: Candidate, singles: Sequence[Candidate]) -> list[SufficientEffects]:
    """Single effects of a pair that do as well as both, best first: the other did nothing."""
    names = set(best.at.model.effects)
    return [
        SufficientEffects(c.at.model.effects, c)
        for c in sorted(singles, key=lambda c: c.score)
        if set(c.at.model.effects) < names and as_good(best, c)
    ][:1]


def choose(
    found: Sequence[SufficientEffects], others: Sequence[SufficientEffects] = ()
) -> Decision:
    """The best explanation and its rivals.

    Args:
        found: explanations with equally many effects, best first.
        others: further rivals, see `foretold`.
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
