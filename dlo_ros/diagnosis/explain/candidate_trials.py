# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Proposals tried: the largest predicted gains are simulated, the nearest to the shapes fitted."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from dlo_ros.diagnosis.explain.own_moments import (
    has_common_moments,
    nearest_moments,
    of_model,
    refined_moments,
    with_own_moments,
)
from dlo_ros.diagnosis.explain.trial_beginnings import TrialBeginning, beginning
from dlo_ros.diagnosis.explain.trials import (
    FIRST_ITERATIONS,
    FIT_ITERATIONS,
    Trial,
    comes_nearer,
    fitted,
    gain_of,
    gains,
)
from dlo_ros.diagnosis.proposals.linear_evidence import (
    PredictedGain,
)
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import (
    CLEARLY_LESS,
    MUCH_LARGER,
    PROMISING,
    SAME_GAIN,
    SMALL_SHARE,
    WORTH,
)

LOG = logging.getLogger(__name__)

Row = TypeVar("Row")
CHECKED = 10
"""Proposals that are simulated in a step at most, those with the largest predicted gain."""
TRIALS = 3
"""Effects of which proposals are fitted: those that come nearest, and that of the largest predicted
gain; of each the start that comes nearest, and that of the largest predicted gain."""


@dataclass(frozen=True)
class Step:
    """A candidate of one step, for the trace.

    Args:
        step: number of the step.
        name: name of the proposal.
        gain: gain in log evidence, fitted, or predicted where it was not fitted.
        err: ERR of the fitted model [m]; None where it was not fitted.
        outcome: the reason why the candidate was kept or dropped.
    """

    step: int
    name: str
    gain: float
    err: float | None
    outcome: str


def best_trials(
    number: int, at: Evaluation, offers: Sequence[tuple[Evaluation, Sequence[PredictedGain]]],
    recordings: Sequence[Recording], least: float = np.inf, begun: Sequence[Trial] = (),
) -> tuple[list[Trial], list[Step]]:  # fmt: skip
    """Fit the proposals of the largest predicted gains; return those that may be worth adding.

    Args:
        number: number of the step, for the trace.
        at: the joint model over which a proposal must gain.
        offers: models from which fits may begin, each with its predictions, best first.
        least: ERR [m], within which one must come by its first steps: otherwise none is fitted, but
            for those of a large gain, and those on which E depends.
        begun: proposals whose fits have begun already, with which the others compete.

    Returns:
        The best trial and those that gain less, of which the last fits have only begun; none where
        the best is not worth it. And what became of each proposal.
    """
    checked, trace = _all_checked(number, offers, recordings)
    chosen, rest = _chosen(checked, at, least)
    trials = list(begun)
    trace += [Step(number, c.label, c.gain, c.err, outcome) for c, outcome in rest]
    for c in [*chosen, *_at_once(chosen, offers, recordings)]:
        LOG.info("%s: its fit begins %.3f mm off", c.label, 1e3 * c.err)
        # It must come near before errors can be separated from the effect.
        found = fitted(c.predicted.model, recordings, FIRST_ITERATIONS, far=True, draft=True)
        if found is None:
            trace.append(Step(number, c.label, c.gain, c.err, "cannot be simulated"))
        else:
            trials.append(_at_own_moments((found, c.predicted.proposal), offers, recordings))
    # A fit that has only begun tells its gain no better than that.
    enough = CLEARLY_LESS * max((gain_of(trial, at) for trial in trials), default=0.0)
    likely = [_continued(t, at, recordings) for t in trials if gain_of(t, at) >= enough]
    others = [t for t in trials if gain_of(t, at) < enough]
    best: list[Trial] = []
    for k, trial in enumerate([*_best_first(likely, at), *_best_first(others, at)]):
        outcome = "fitted, but another gains more"
        if best:
            best.append(trial)
        else:
            if k >= len(likely):
                trial = _continued(trial, at, recordings)
            # A proposal with which predictions stay farther from the shapes is no explanation,
            # whatever its log evidence.
            if not gains(trial, at):
                outcome = "gains too little"
            elif not comes_nearer(trial[0], at, recordings):
                outcome = "makes matters worse"
            else:
                outcome = "added"
                best.append(trial)
        gain = gain_of(trial, at)
        trace.append(Step(number, trial[1].label, gain, trial[0].mean_err, outcome))
    return best, trace


def _all_checked(
    number: int, offers: Sequence[tuple[Evaluation, Sequence[PredictedGain]]],
    recordings: Sequence[Recording],
) -> tuple[list[TrialBeginning], list[Step]]:  # fmt: skip
    """The promising proposals, and what became of the others; see `best_trials`."""
    trace: list[Step] = []
    checked: list[TrialBeginning] = []
    for origin, predictions in offers:
        promising = {id(p) for p in _promising(predictions)}
        for predicted in predictions:
            label, gain = predicted.proposal.label, predicted.gain
            if id(predicted) not in promising:
                trace.append(Step(number, label, gain, None, "predicted to gain less"))
                continue
            try:
                checked.append(beginning(origin, predicted, recordings))
            except SimulationError as reason:
                LOG.info("%s: %s", label, reason)
                trace.append(Step(number, label, gain, None, "cannot be simulated"))
    return checked, trace


def _chosen(
    checked: Sequence[TrialBeginning], at: Evaluation, least: float
) -> tuple[list[TrialBeginning], list[tuple[TrialBeginning, str]]]:
    """Proposals that are fitted, and why the others are not; see `best_trials`."""
    # Proposals that can do each other's work come equally near: the likeliest of them first.
    alike = (1.0 + SMALL_SHARE) * min((c.err for c in checked), default=0.0)
    nearest = sorted(checked, key=lambda c: (max(c.err, alike), -c.gain))
    near = any(c.err <= least for c in checked)
    enough = _various([c for c in nearest if near or c.vital], lambda c: _kind(c.predicted))
    # A few steps tell little of what must leave the set-up's wrong valley first: one trial is that
    # of the largest predicted gain, of another effect.
    kinds = {_kind(c.predicted) for c in enough[: TRIALS - 1]}
    others = [k for k, c in enumerate(enough) if _kind(c.predicted) not in kinds]
    if others:
        most = max(others, key=lambda k: enough[k].gain)
        enough.insert(TRIALS - 1, enough.pop(most))
    first = enough[:TRIALS]
    first = list(dict.fromkeys([*first, *(_likeliest(enough, c) for c in first)]))
    far = MUCH_LARGER * at.mean_err
    outcomes = [(c, "takes too little") for c in nearest if c not in enough]
    outcomes += [(c, "others come nearer") for c in enough if c not in first]
    outcomes += [(c, "makes matters worse") for c in first if c.err > far]
    return [c for c in first if c.err <= far], outcomes


def _at_once(
    chosen: Sequence[TrialBeginning], offers: Sequence[tuple[Evaluation, Sequence[PredictedGain]]],
    recordings: Sequence[Recording],
) -> list[TrialBeginning]:  # fmt: skip
    """Beginnings of sudden events, of effects that are fitted as going on all the time.

    At the wrong moment an event gains less, and no derivative leads to the right one: its fit
    begins at that of the largest predicted gain.
    """
    proposals = [c.predicted.proposal for c in chosen]
    even = {p.effect for p in proposals}
    even -= {p.effect for p in proposals if has_common_moments(p)}
    rows = [(origin, p) for origin, predictions in offers for p in predictions]
    found: list[TrialBeginning] = []
    for origin, predicted in sorted(rows, key=lambda row: -row[1].gain):
        effect = predicted.proposal.effect
        if effect in even and has_common_moments(predicted.proposal):
            even.remove(effect)
            try:
                found.append(beginning(origin, predicted, recordings))
            except SimulationError as reason:
                LOG.info("%s: %s", predicted.proposal.label, reason)
    return found


def _likeliest(checked: Sequence[TrialBeginning], nearest: TrialBeginning) -> TrialBeginning:
    """The start of an effect with the largest predicted gain.

    A softer stretch of a DLO may come nearer by the first steps than the stiffer rest beside it.
    """
    alike = [c for c in checked if _kind(c.predicted) == _kind(nearest.predicted)]
    return max(alike, key=lambda c: c.gain)


def _continued(trial: Trial, at: Evaluation, recordings: Sequence[Recording]) -> Trial:
    """A trial whose fit goes on; where it leaves the shapes by that, it stays where it was.

    Args:
        at: the model without it.
    """
    found, proposal = trial
    longer = fit(found, recordings, FIT_ITERATIONS)
    if longer.mean_err > at.mean_err >= found.mean_err:
        longer = fit(found, recordings, 0)
    return longer, proposal


def _at_own_moments(
    trial: Trial, offers: Sequence[tuple[Evaluation, Sequence[PredictedGain]]],
    recordings: Sequence[Recording],
) -> Trial:  # fmt: skip
    """A trial of what happens once, in each recording at its own moment where that explains more.

    At one moment in all of them it may come nearer to the shapes than anything else, and yet miss
    each motion so much that its log evidence falls.

    Args:
        offers: see `best_trials`; the moments at which they begin are tried.
    """
    at, cause = trial
    if len(recordings) < 2 or not has_common_moments(cause):
        return trial
    proposals = [p.proposal for _, predictions in offers for p in predictions]
    starts = [p.start for p in proposals if p.start is not None and p.effect == cause.effect]
    own_model = with_own_moments(at.model, recordings)
    model = refined_moments(nearest_moments(own_model, recordings, starts), recordings)
    found = fitted(model, recordings, FIRST_ITERATIONS, far=True, draft=True)
    if found is None:
        return trial
    own = found, of_model(cause, model)
    LOG.info("%s at moments of their own: %+.1f", cause.label, gain_of(own, at))
    # A fit that has gone on gains by that, too.
    better = gains(own, at) and gains(own, fit(at, recordings, 2 * FIRST_ITERATIONS, draft=True))
    return own if better else trial


def _promising(predictions: Sequence[PredictedGain]) -> list[PredictedGain]:
    """Proposals worth a simulation, of some predictions that stand by their gains.

    The best of each effect is one of them: gains of effects that act otherwise when they are large,
    as a creep does, are predicted too small.
    """
    worth = [p for p in predictions if p.gain >= WORTH]
    kinds = len({_kind(p) for p in worth})
    various = enumerate(_various(worth, _kind))
    return [p for k, p in various if k < kinds or p.gain >= PROMISING * worth[0].gain][:CHECKED]


def _kind(predicted: PredictedGain) -> str:
    """The effect that a proposal adds, or the number that it frees.

    From one start of an effect, a fit mostly finds what it would have found from another one.
    """
    proposal = predicted.proposal
    return proposal.label if proposal.start is None else proposal.effect


def _various(rows: Sequence[Row], kind: Callable[[Row], str]) -> list[Row]:
    """Rows, best first, with the best of each kind before its others."""
    first: dict[str, Row] = {}
    for row in rows:
        first.setdefault(kind(row), row)
    return [*first.values(), *(row for row in rows if row is not first[kind(row)])]


def _best_first(trials: Sequence[Trial], at: Evaluation) -> list[Trial]:
    """Trials by their log evidence; of those that gain alike, the nearest to the shapes first.

    Where evidence tells nothing, first what is off in every set-up: a board is oftener tilted than
    pulled at.
    """
    most = max((gain_of(trial, at) for trial in trials), default=0.0)
    least = (1.0 - SAME_GAIN) * most

    def order(trial: Trial) -> tuple[bool, bool, float, float]:
        gain, of_set_up = gain_of(trial, at), trial[1].start is None
        likelier = of_set_up and gain > most - WORTH
        return not likelier, gain < least, trial[0].mean_err if gain >= least else 0.0, -gain

    return sorted(trials, key=order)
