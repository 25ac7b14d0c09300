# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Causes that recordings show beyond the tolerances of a set-up: a search by evidence.

The set-up within its tolerances is always part of the model. Of the proposals (`linear_evidence`)
those with the largest predicted gains are simulated, those that come nearest are fitted, and the
one that raises the log evidence most stays.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.explain.candidate_trials import Step, best_trials
from dlo_ros.diagnosis.explain.certainty import far_off, tolerances_off
from dlo_ros.diagnosis.explain.far_starts import (
    best_far_start,
    best_stood_for,
    with_best_in_place,
)
from dlo_ros.diagnosis.explain.left_out import beside_neutral, linear_loss, without
from dlo_ros.diagnosis.explain.measurement_error import own_err
from dlo_ros.diagnosis.explain.offered_effects import Offer, offered, ranked_proposals
from dlo_ros.diagnosis.explain.trials import Trial, begun_instead, best_with
from dlo_ros.diagnosis.proposals.linear_evidence import (
    PredictedGain,
    Proposal,
)
from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, evaluate
from dlo_ros.inference.joint_fit import nearest_err
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor
from dlo_ros.inference.parameter import SLAB, ParametricModel
from dlo_ros.inference.thresholds import CLEARLY_LESS, INDISPENSABLE, LOWERS, OWN, WORTH

LOG = logging.getLogger(__name__)

MOST_CAUSES = 6
SET_UP_EXCHANGES = 2
"""Numbers of the set-up that are exchanged for effects in a search."""


@dataclass(frozen=True)
class Search:
    """The result of a search.

    Args:
        at: the joint model with all causes.
        causes: causes in the order in which they were found.
        trace: every candidate of every step.
        offer: proposals of further causes for this model or one before it; None: not computed.
        second: the fit with the first cause that would have been added if the best had not been
            there, where it gained nearly as much.
        of_two: log evidence with the first two causes; infinite where there were never two.
        passed: the models that the search has passed through, the one that it began with first.
    """

    at: Evaluation
    causes: tuple[Proposal, ...]
    trace: tuple[Step, ...]
    offer: Offer | None
    second: Trial | None = None
    of_two: float = np.inf
    passed: tuple[Evaluation, ...] = ()

    def cause_of(self, effect: str) -> Proposal | None:
        """The cause that is an effect of a name."""
        return next((c for c in self.causes if c.effect == effect), None)

    def exchanged(self, cause: Proposal, trial: Trial) -> Search:
        """The result with a trial in the place of a cause, or of a number of the set-up."""
        at, proposal = trial
        if not any(c is cause for c in self.causes):
            return replace(self, at=at, causes=(*self.causes, proposal))
        causes = tuple(proposal if c is cause else c for c in self.causes)
        return replace(self, at=at, causes=causes)


def search(
    at: Evaluation, neutral: ParametricModel, recordings: Sequence[Recording],
    begun: Sequence[Start], enough: float, first: Trial | None = None,
    present: Sequence[Proposal] = (), wanted: float = -np.inf, most: int = MOST_CAUSES,
) -> Search:  # fmt: skip
    """Add causes one by one, the one that raises the log evidence most first.

    The search ends with a cause, not the first one, that takes too little of ERR away to be named,
    and without it if it cannot come nearer at all: then its fit has ended in a worse minimum. It
    ends, too, where nothing is left that matters and no proposal takes more by its first steps. The
    laws of the causes before it differ from the true ones; many effects can compensate for a little
    of that difference, and none of them is its reason.

    Args:
        at: the joint model with its set-up within tolerance, fitted.
        neutral: the same with the set-up at neutral, from where causes are looked for as well where
            the fitted set-up is strained: it may do most of a cause's work.
        begun: effects that might be added, at their starting values.
        enough: ERR [m] below which no cause is looked for, unless it is more than the measurement's
            own error.
        first: the fit with a cause that derivatives do not tell of, and the cause, with which the
            others compete in the first step; see `contact_trials` and `far_starts`.
        present: causes that the model contains already.
        wanted: log evidence without which the search is in vain. It ends where all causes that may
            still come would not reach it if each raised the evidence as much as the last one: the
            first ones raise it most.
        most: number of causes with which the search ends.
    """
    causes = list(present)
    dropped: set[str] = set()
    trace: list[Step] = []
    offer: Offer | None = None
    exchanged: list[str] = []
    passed: list[Evaluation] = []
    elsewhere: dict[str, list[Trial]] = {}
    second: Trial | None = None
    of_two = np.inf
    left = _is_left(at, recordings, enough)
    if not left and first is None and not causes:
        first = best_stood_for(at, recordings, begun)
    while len(causes) < most and (left or first is not None):
        known = {c.label for c in causes} | {c.effect for c in causes if c.start is not None}
        known |= dropped
        number = len(causes) + 1
        offer = offered(at, recordings, begun, offer)
        offers = [(at, _new(ranked_proposals(at, offer), known))]
        if not causes and _strained(at, (), ()) and leaves_something(at, recordings, enough):
            offers += _offers_beside(neutral, recordings, begun, offer)
        new = [b for b in begun if b.effect not in known]
        least = np.inf
        if causes and not leaves_something(at, recordings, enough):
            least = (1.0 - LOWERS) * nearest_err(at, recordings)
        elif first is None and len(causes) == 1:
            first = _far_beside(at, causes[0], recordings, new)
        instead = begun_instead(at, recordings, new)
        trials, steps = best_trials(number, at, offers, recordings, least, instead)
        found = trials[0] if trials else None
        if first is not None:
            trials.append(first)
            found = best_with(first, found, at, recordings)
            outcome = "added" if found is first else "fitted, but another gains more"
            steps.append(_compared(number, first, at, outcome))
            first = None
        trace += steps
        _tell(steps)
        over = left_over(found, at, recordings)
        little = over > 1.0 - LOWERS
        if little and leaves_something(found[0] if found else at, recordings, enough):
            for group in _strained(at, causes, exchanged)[: SET_UP_EXCHANGES - len(exchanged)]:
                exchanged.append(group.label)
                other, steps = _exchange(number, at, group, recordings, begun, known, offer)
                trace += steps
                _tell(steps)
                if other is not None and not takes_little(other, at, recordings):
                    found, causes = other, [c for c in causes if c.label != group.label]
                    little = False
                    break
        if found is None:
            break
        if little and causes and over > 1.0:
            steps = [_compared(number, found, at, "returned: comes no nearer")]
            trace += steps
            _tell(steps)
            break
        if not causes:
            second = _second(trials, found, at)
        gain = log_bayes_factor(found[0], at)
        passed.append(at)
        elsewhere[found[1].label] = _elsewhere(trials, found)
        at, causes = found[0], [*causes, found[1]]
        if at.posterior.evidence + (MOST_CAUSES - number) * gain < wanted:
            break
        if number > 1:
            at, causes = with_best_in_place(at, causes, recordings, begun, elsewhere)
        at, kept, steps = _needed_alone(number, at, causes, recordings)
        dropped |= {c.label for c in causes} - {c.label for c in kept}
        causes, trace = kept, trace + steps
        if len(causes) == 2 and of_two == np.inf:
            of_two = at.posterior.evidence
        if little and number > 1:
            break
        left = _is_left(at, recordings, enough)
    return Search(at, tuple(causes), tuple(trace), offer, second, of_two, tuple(passed))


def _needed_alone(
    number: int, at: Evaluation, causes: Sequence[Proposal], recordings: Sequence[Recording]
) -> tuple[Evaluation, list[Proposal], list[Step]]:
    """A model with those of its causes alone that it needs, and what became of the others.

    Args:
        number: number of the step, for the trace.
    """
    kept, steps = list(causes), list[Step]()
    for cause in reversed(causes):
        if linear_loss(at, cause) > INDISPENSABLE:
            continue
        bare = without(at, cause, recordings)
        if bare is None:
            continue
        loss = log_bayes_factor(at, bare)
        if loss >= WORTH:
            continue
        steps.append(Step(number, cause.label, loss, bare.mean_err, "returned: not needed"))
        at, kept = bare, [c for c in kept if c is not cause]
    _tell(steps)
    return at, kept, steps


def _second(trials: Sequence[Trial], found: Trial, at: Evaluation) -> Trial | None:
    """The best trial of another effect than the one that is added, where it gains nearly as much.

    While other causes are missing, evidence tells them apart no better than `CLEARLY_LESS`.

    Args:
        at: the model without them.
    """
    others = [t for t in trials if t[1].start is not None and t[1].effect != found[1].effect]
    second = max(others, key=lambda t: t[0].posterior.evidence, default=None)
    if second is None:
        return None
    gain, most = (log_bayes_factor(t[0], at) for t in (second, found))
    return second if gain >= CLEARLY_LESS * most else None


def _elsewhere(trials: Sequence[Trial], found: Trial) -> list[Trial]:
    """Trials of the effect that is added, at other places.

    While other causes are missing, a soft stretch may do the work of a stiff one beside it.
    """
    effect, label = found[1].effect, found[1].label
    return [t for t in trials if t[1].effect == effect and t[1].label != label and t[1].start]


def _far_beside(
    at: Evaluation, cause: Proposal, recordings: Sequence[Recording], begun: Sequence[Start]
) -> Trial | None:
    """The best fit of what begins far away beside a first cause, and a set-up at neutral.

    A mass that outweighs a DLO that hits a wall comes no nearer to the shapes while there is no
    wall. None where the first cause has begun far away itself.
    """
    if cause.start is not None and cause.start.afar:
        return None
    of_set_up = [p.name for p in at.model.parameters if p.tolerated and p not in cause.parameters]
    return best_far_start(at, at.model.centred(of_set_up), recordings, begun)


def _is_left(at: Evaluation, recordings: Sequence[Recording], enough: float) -> bool:
    """Whether a model leaves more than `enough` [m], or than the measurement errs."""
    return at.mean_err > enough or leaves_something(at, recordings, 0.0)


def leaves_something(at: Evaluation, recordings: Sequence[Recording], enough: float) -> bool:
    """Whether a model stays farther from the shapes than the measurement errs and `enough` [m]."""
    most = max(OWN * own_err(at, recordings), enough)
    return at.mean_err > most and nearest_err(at, recordings) > most


def left_over(found: Trial | None, at: Evaluation, recordings: Sequence[Recording]) -> float:
    """ERR to which a trial can come over that to which a model can; infinite without a trial."""
    if found is None:
        return np.inf
    here, there = (nearest_err(e, recordings) for e in (at, found[0]))
    LOG.info("%s: %.3f mm, %.3f mm without", found[1].label, 1e3 * there, 1e3 * here)
    return there / here


def takes_little(found: Trial | None, at: Evaluation, recordings: Sequence[Recording]) -> bool:
    """Whether a trial comes too little nearer to the shapes than a model to be named."""
    return left_over(found, at, recordings) > 1.0 - LOWERS


def bears_a_share(at: Evaluation, bare: Evaluation, least: float) -> bool:
    """Whether a model loses a share of what its causes gain without one of them that counts.

    What only mends the law of another one a little gains a few per cent of that.

    Args:
        bare: the model without the cause.
        least: log evidence of the set-up without causes.
    """
    gained = at.posterior.evidence - least
    return log_bayes_factor(at, bare) > max(WORTH, LOWERS * gained)


def _strained(
    at: Evaluation, causes: Sequence[Proposal], exchanged: Sequence[str]
) -> list[Proposal]:
    """Numbers of the set-up beyond their tolerance that are not exchanged yet, farthest first."""
    own = [c for c in causes if c.start is None]
    groups = [g for g in (*own, *far_off(at)) if g.label not in exchanged]
    return sorted(groups, key=lambda g: -tolerances_off(at, g))


def _exchange(
    number: int, at: Evaluation, group: Proposal, recordings: Sequence[Recording],
    begun: Sequence[Start], known: set[str], offer: Offer,
) -> tuple[Trial | None, list[Step]]:  # fmt: skip
    """The best effect in place of numbers of the set-up that lie beyond their tolerance.

    While the true cause is not in the model, the set-up may be strained until it does most of the
    work. From there little gain is predicted for the cause, and it makes matters worse where it is
    simulated.

    Args:
        number: number of the step, for the trace.
        at: the joint model over which the effect must gain.
        group: the numbers.
        begun: effects that might be added, where they are looked for.
        known: names of effects that are not tried.
        offer: what might be added to that model.
    """
    within = at.model.with_prior([p.returned(SLAB) for p in group.parameters])
    bare = _with_neutral(at, within, group)
    offers = [(e, _new(p, known)) for e, p in _offers_beside(bare, recordings, begun, offer)]
    trials, steps = best_trials(number, at, offers, recordings)
    return (trials[0] if trials else None), steps


def _offers_beside(
    model: ParametricModel, recordings: Sequence[Recording], begun: Sequence[Start], known: Offer
) -> list[tuple[Evaluation, list[PredictedGain]]]:
    """A model and the predictions of the effects that might be added; none where it fails.

    Args:
        known: an offer for another model.
    """
    try:
        at = evaluate(model, recordings)
    except SimulationError as err:
        LOG.info("with the set-up at neutral: %s", err)
        return []
    ranked = ranked_proposals(at, offered(at, recordings, begun, known))
    return [(at, [p for p in ranked if p.proposal.start is not None])]


def _new(predictions: Sequence[PredictedGain], known: set[str]) -> list[PredictedGain]:
    """The predictions of proposals whose labels and effects are not known."""
    return [p for p in predictions if not {p.proposal.label, p.proposal.effect} & known]


def _with_neutral(at: Evaluation, model: ParametricModel, group: Proposal) -> ParametricModel:
    """A model with a group at neutral, and the other parameters as `beside_neutral` says."""
    return beside_neutral(at, model, group).centred([p.name for p in group.parameters])


def _compared(number: int, trial: Trial, at: Evaluation, outcome: str) -> Step:
    """A line of the trace: a fit with a cause beside one without it."""
    gain = log_bayes_factor(trial[0], at)
    return Step(number, trial[1].label, gain, trial[0].mean_err, outcome)


def _tell(steps: Sequence[Step]) -> None:
    """The candidates of a step, in the log."""
    for s in steps:
        err = "-" if s.err is None else f"{1e3 * s.err:.3f} mm"
        LOG.info("cause %d: %s: %+.1f, ERR %s: %s", s.step, s.name, s.gain, err, s.outcome)
