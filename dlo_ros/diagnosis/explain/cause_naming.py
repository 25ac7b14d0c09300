# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The causes that are named: those without which the best model is clearly worse."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from dlo_ros.diagnosis.explain.cause_judge import Judge
from dlo_ros.diagnosis.explain.cause_search import (
    Search,
    bears_a_share,
    takes_little,
)
from dlo_ros.diagnosis.explain.certainty import (
    SCALES,
    beyond,
    certain,
    strained,
)
from dlo_ros.diagnosis.explain.contact_trials import Contact, Rivals
from dlo_ros.diagnosis.explain.left_out import best_known, linear_loss, without
from dlo_ros.diagnosis.explain.offered_effects import offered
from dlo_ros.diagnosis.explain.rivals import Rival, rivals_of
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, freed
from dlo_ros.effects import Start
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import approached, nearest_err
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import certain_gain, log_bayes_factor, tells_apart
from dlo_ros.inference.thresholds import FAR, INDISPENSABLE, NAMED

LOG = logging.getLogger(__name__)

Bares = dict[str, Evaluation | None]
"""Fits without single causes, by the causes' labels; None where nothing could be simulated."""
Shifts = Mapping[str, Mapping[str, float]]
"""Changes of a model's other numbers, as inference sees them, by their names: without an effect, or
with a rival in a cause's place, by the name of that effect or rival."""


@dataclass(frozen=True)
class Cause:
    """A cause that the data show for certain.

    Args:
        effect: name of the effect.
        names: names of the effect's parameters.
        rivals: effects that explain the data as well in its place, with the values of their keys.
        evidence: log evidence that is lost without it.
        err, near: ERR to which the model can come without it, and with it [m].
    """

    effect: str
    names: tuple[str, ...]
    rivals: Rivals
    evidence: float
    err: float
    near: float


class Named(NamedTuple):
    """The causes of a search's result, see `named`.

    Args:
        causes: the causes that the data show for certain.
        shifts: changes of the other numbers without each effect that was added, or with a rival in
            its place.
        better: the result with a rival in a cause's place that explains the data better, if there
            is one; then the rest is of no use.
    """

    causes: tuple[Cause, ...]
    shifts: Shifts
    better: Search | None = None


def beside_contact(
    causes: tuple[Cause, ...], contact: Contact | None, *, complete: bool
) -> tuple[Cause, ...]:
    """The causes, what was hit with its rivals.

    Args:
        complete: whether the model leaves nothing that matters.
    """
    if contact is None:
        return causes
    effect, rivals = contact.trial[1].effect, contact.instead(complete=complete)
    return tuple(
        replace(c, rivals={**c.rivals, **rivals}) if c.effect == effect else c for c in causes
    )


def without_dampings(causes: tuple[Cause, ...], at: Evaluation) -> tuple[Cause, ...]:
    """The causes but for dampings: they take up what any missing law loses, or delays."""
    material = {p.name for p in at.model.parameters if not p.effect}
    return tuple(c for c in causes if material.isdisjoint(c.names))


def _needed(
    at: Evaluation, bare: Evaluation, group: Proposal, begun: Sequence[Start], *, sized: bool = True
) -> bool:
    """Whether the best model without a cause is clearly worse, see `NAMED` and `FAR`.

    Of a cause that is no part of every set-up, but one of K effects that were tried, ln K more of
    the log evidence must be lost.

    Args:
        bare: the fit without it.
        sized: whether its size is certain. Where it is not, it must be indispensable: a segment
            that hardly bends may be stiffer still, and yet is there.
    """
    tried = len({s.effect for s in begun}) if group.start is not None else 1
    loss = log_bayes_factor(at, bare)
    if not sized:
        return loss > INDISPENSABLE
    far = at.mean_err < FAR * bare.mean_err
    return loss >= certain_gain(tried) or (far and loss > 0.0)


def without_needless(
    found: Search, recordings: Sequence[Recording], begun: Sequence[Start], least: float, *,
    complete: bool,
) -> tuple[Search, Bares, Shifts]:  # fmt: skip
    """The result without added effects that the data do not show for certain.

    Beside an effect that may or may not act, another one of which the data are certain would not be
    needed either, where each can do the other's work: neither would be named.

    Where something is left unexplained, evidence is that of a wrong model: it is raised by whatever
    mends that model's laws a little in these manipulations, and in others that makes matters worse.
    There only what brings the model nearer to the shapes is kept, or an effect that bears a share
    of what all causes gain; numbers of the set-up that bring it no nearer are within their
    tolerance again. Guessed dampings are tried first: one has its guess again where the model, with
    all added effects, does as well with the guess.
    What is left out already counts: all of it together must do as little as one may.

    Args:
        found: what the search has found.
        begun: beginnings of the effects that were offered to the search.
        least: log evidence of the set-up without causes.
        complete: whether nothing is left unexplained.

    Returns:
        The result, fits of it without single causes as far as they were made, and the shifts
        without each effect or damping that is left out.
    """
    at, causes = found.at, found.causes
    shifts: dict[str, Mapping[str, float]] = {}
    bares: Bares = {}
    groups = [c for c in reversed(found.causes) if c.start is not None or not complete]
    for group in groups if complete else [*_guessed_dampings(at), *groups]:
        if complete and linear_loss(at, group, wholly=True) > INDISPENSABLE:
            continue
        of_set_up = group in found.causes and group.start is None
        if of_set_up and group not in causes:  # a damping that has its guess again
            continue
        bare = without(at, group, recordings, wholly=not of_set_up)
        if bare is not None and group.start is not None:
            bare = best_known(at, group, bare, found.passed)
        if bare is None or (
            _needed(at, bare, group, begun)
            if complete
            else not takes_little((found.at, group), bare, recordings)
            or (group.start is not None and bears_a_share(found.at, bare, least))
        ):
            if not of_set_up:
                bares[group.label] = bare
            continue
        LOG.info("left out: %s", group.label)
        shifts[group.effect] = _changes(at, bare, group)
        at, causes = bare, tuple(c for c in causes if c.label != group.label)
        bares = {}
    return replace(found, at=at, causes=causes), bares, shifts


def _guessed_dampings(at: Evaluation) -> list[Proposal]:
    """Dampings that the parameter file only guesses."""
    return [g for g in freed(at.model) if all(p.guessed for p in g.parameters)]


def named(
    found: Search, setup: Evaluation, bares: Bares, recordings: Sequence[Recording],
    begun: Sequence[Start], owns: Sequence[float], least: float, *, exact: bool = False,
    complete: bool = True, exchange: bool = False,
) -> Named:  # fmt: skip
    """The causes without which the best model is clearly worse, numbers of the set-up among them.

    What lies within its tolerance, or is no part of every set-up, is none where all that it
    explains is immaterial, or takes away less than `least` [m] of ERR: beside a cause whose true
    law is another than the model's, a further effect mends that law a little. It is one, though,
    where it takes a fourth away and nothing is left, or bears a share of what all gain in a model
    that leaves something. Where the set-up must leave its tolerance to do a cause's work, or E / mu
    would certainly be another one, ERR does not tell how much that is. Correlated errors let fits
    drift from the shapes, by more than a cause may take away: what counts is how near the model can
    come with it and without it. What comes so near takes part of the measurement's own error away,
    too: that error is then no more than what is left with the cause.

    Of effects that do each other's work, each may be left out, and yet one of them acts where the
    set-up alone explains less: the one without which most is lost is named, with the others as its
    rivals. Where it is the set-up that does a cause's work, and must leave its tolerance for it, as
    a tilt does that of an even force, those numbers of it are the rivals. A rival that explains the
    data better than the cause takes its place.

    Args:
        owns: ERR of the measurement alone in each recording [m].
        setup: the set-up without causes, fitted: a fit without one of them that explains less has
            gone astray.
        exact: whether the set-up is as precise as the data tell: then all that is certain is named.
        complete: whether the model leaves nothing that matters.
        exchange: whether a better rival may take a cause's place.
    """
    at, offer = found.at, found.offer
    result = []
    shifts: dict[str, Mapping[str, float]] = {}
    instead: dict[str, Mapping[str, float]] = {}
    shared: list[tuple[float, Proposal]] = []
    judge = Judge(at, setup, recordings, owns, least, exact, complete)
    for group in (*found.causes, *beyond(at)):
        sized = certain(at, group, SCALES)
        if not sized and (group.start is None or not complete):
            continue
        # Linearly, the rest may do the work of what was added by moves that no set-up makes.
        if group.start is None and linear_loss(at, group, wholly=True) < NAMED:
            continue
        known = group.label in bares
        bare = bares[group.label] if known else without(at, group, recordings, wholly=True)
        if bare is None:
            continue
        if group.start is not None:
            bare = best_known(at, group, bare, found.passed if exact else (setup, *found.passed))
            shifts[group.effect] = _changes(at, bare, group)
        if not _needed(at, bare, group, begun, sized=sized):
            continue
        there = approached(bare, recordings)
        if judge.matters(group, bare, there):
            offer = offered(at, recordings, begun, offer)
            fits = rivals_of((at, group), bare, recordings, begun, offer, complete=complete)
            better = _best_of(fits, at, recordings, complete=complete) if exchange else None
            if better is not None:
                LOG.info("%s, instead of %s", better.proposal.label, group.label)
                return Named((), {}, found.exchanged(group, (better.at, better.proposal)))
            instead |= {effect: _changes(at, r.at, group) for effect, r in fits.items()}
            blocks = {effect: r.values for effect, r in fits.items()}
            result.append(_cause(judge, group, blocks, bare, there.mean_err))
        elif twins := strained(bare, at):
            values = bare.model.settings.effects
            both = tuple(p for g in (group, *twins) for p in g.parameters)
            neither = without(at, replace(group, parameters=both), recordings, wholly=True) or bare
            rivals = {
                t.effect: values[t.effect] for t in twins
                if t.effect in values and t.effect != group.effect  # it may be the other end's
            }  # fmt: skip
            instead |= dict.fromkeys(rivals, _changes(at, bare, group))
            without_both = nearest_err(neither, recordings)
            result.append(_cause(judge, group, rivals, neither, without_both))
        elif group.start is not None:
            shared.append((log_bayes_factor(at, bare), group))
    # One of several effects that do each other's work acts for certain where the set-up does not.
    if len(shared) > 1 and len(shared) == sum(c.start is not None for c in found.causes):
        _, first = max(shared, key=lambda row: row[0])
        there = approached(setup, recordings)
        if judge.matters(first, setup, there):
            effects = at.model.settings.effects
            others = {c.effect: effects[c.effect] for _, c in shared if c.effect != first.effect}
            result.append(_cause(judge, first, others, setup, there.mean_err))
    causes = _merged(result)
    told = {rival for cause in causes for rival in cause.rivals}
    return Named(causes, shifts | {r: instead[r] for r in told & instead.keys()})


def _best_of(
    fits: Mapping[str, Rival], at: Evaluation, recordings: Sequence[Recording], *, complete: bool
) -> Rival | None:
    """The rival that explains the data best, if it certainly explains them better than a model.

    Beside a missing cause, where evidence tells little, it must come nearer to the shapes, too, by
    as much as a cause does.

    Args:
        fits: rivals of one of the model's causes, by their names.
    """
    others = (r for r in fits.values() if not r.twin)
    best = max(others, key=lambda r: r.at.posterior.evidence, default=None)
    if best is None or not tells_apart(best.at, at):
        return None
    return best if complete or not takes_little((best.at, best.proposal), at, recordings) else None


def _cause(judge: Judge, group: Proposal, rivals: Rivals, bare: Evaluation, err: float) -> Cause:
    """A group as a cause.

    Args:
        bare: the fit without it.
        err: how near that model can come [m].
    """
    names, evidence = tuple(p.name for p in group.parameters), log_bayes_factor(judge.at, bare)
    return Cause(group.effect, names, rivals, evidence, err, judge.near.mean_err)


def _changes(at: Evaluation, other: Evaluation, group: Proposal) -> dict[str, float]:
    """Changes from one model to another one of all numbers that both have, but for a group's."""
    own = {p.name for p in group.parameters}
    there = dict(zip(other.model.names, other.model.theta(), strict=True))
    pairs = zip(at.model.names, at.model.theta(), strict=True)
    return {n: float(there[n] - x) for n, x in pairs if n in there and n not in own}


def _merged(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Causes with one entry for each effect, the clearest first."""
    by_effect: dict[str, list[Cause]] = {}
    for cause in sorted(causes, key=lambda c: -c.evidence):
        by_effect.setdefault(cause.effect, []).append(cause)
    return tuple(
        Cause(
            effect, tuple(n for c in same for n in c.names),
            {r: v for r, v in same[0].rivals.items() if all(r in c.rivals for c in same)},
            same[0].evidence, max(c.err for c in same), same[0].near,
        )
        for effect, same in by_effect.items()
    )  # fmt: skip
