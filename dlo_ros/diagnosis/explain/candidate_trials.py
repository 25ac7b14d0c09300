# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Proposals tried: the largest predicted gains are simulated, the nearest to the shapes fitted."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from dlo_ros.diagnosis.proposals.linear_evidence import PredictedGain, Proposal, joined
from dlo_ros.effects import effects, quantities
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import (
    Evaluation,
    Simulated,
    borrowed,
    compared,
    evaluate,
    simulate,
)
from dlo_ros.inference.joint_fit import approached, fit, nearest_err
from dlo_ros.inference.losses import WHITE
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.thresholds import (
    INDISPENSABLE,
    MUCH_LARGER,
    PROMISING,
    SAME_GAIN,
    WORTH,
)
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

Row = TypeVar("Row")
Trial = tuple[Evaluation, Proposal]
"""A model fitted with a proposal, and the proposal."""

CHECKED = 10
"""Proposals that are simulated in a step at most, those with the largest predicted gain."""
SHARES = (1.0, 0.5)
"""Shares of the way to the predicted model that are simulated, of an effect that begins at a finite
size."""
SIZES, SIZE_TRIALS = 2.2, 6
"""Factor up to which the size of an effect that begins at a finite one may be larger or smaller
where its fit begins, and number of sizes that are simulated: no derivative tells of it."""
PLACE_TRIALS = 25
"""Places that are simulated of something that the DLO hits: no derivative leads to them."""
TRIALS = 3
"""Proposals that are fitted: those of different effects that come nearest, and that of the largest
predicted gain."""
FIRST_ITERATIONS, FIT_ITERATIONS = 4, 12
"""Iterations of each proposal, and of the best of them."""


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


def best_trial(
    number: int, at: Evaluation, offers: Sequence[tuple[Evaluation, Sequence[PredictedGain]]],
    recordings: Sequence[Recording], least: float = np.inf,
) -> tuple[Trial | None, list[Step]]:  # fmt: skip
    """Fit the proposals of the largest predicted gains; return the best, if it is worth adding.

    Args:
        number: number of the step, for the trace.
        at: the joint model over which a proposal must gain.
        offers: models from which fits may begin, each with its predictions, best first.
        least: ERR [m], within which one must come by its first steps: otherwise none is fitted, but
            for one of such a gain that E may depend on it, as on a creep.

    Returns:
        The best trial, None where none is worth it, and what became of each proposal.
    """
    trace: list[Step] = []
    checked: list[tuple[float, PredictedGain]] = []
    for origin, predictions in offers:
        promising = {id(p) for p in _promising(predictions)}
        for predicted in predictions:
            name = predicted.proposal.label
            if id(predicted) not in promising:
                trace.append(Step(number, name, predicted.gain, None, "predicted to gain less"))
                continue
            try:
                checked.append(_checked(origin, predicted, recordings))
            except SimulationError as reason:
                LOG.info("%s: %s", name, reason)
                trace.append(Step(number, name, predicted.gain, None, "cannot be simulated"))
    checked = _various(sorted(checked, key=lambda row: row[0]), lambda row: _kind(row[1]))
    if all(err > least and p.gain < INDISPENSABLE for err, p in checked):
        rows = [(p.proposal.label, p.gain, err) for err, p in checked]
        return None, [*trace, *(Step(number, *row, "takes too little") for row in rows)]
    # A few steps tell little of what must leave the set-up's wrong valley first: one trial is that
    # of the largest predicted gain, of another effect.
    nearest = {_kind(p) for _, p in checked[: TRIALS - 1]}
    others = [k for k, (_, p) in enumerate(checked) if _kind(p) not in nearest]
    if others:
        most = max(others, key=lambda k: checked[k][1].gain)
        checked.insert(TRIALS - 1, checked.pop(most))
    begun: list[Trial] = []
    for k, (err, predicted) in enumerate(checked):
        name = predicted.proposal.label
        LOG.info("%s: its fit begins %.3f mm off", name, 1e3 * err)
        if k >= TRIALS or err > MUCH_LARGER * at.mean_err:
            outcome = "others come nearer" if k >= TRIALS else "makes matters worse"
            trace.append(Step(number, name, predicted.gain, err, outcome))
            continue
        # It must come near before errors can be separated from the effect.
        found = fitted(predicted.model, recordings, FIRST_ITERATIONS, far=True, draft=True)
        if found is None:
            trace.append(Step(number, name, predicted.gain, err, "cannot be simulated"))
        else:
            begun.append((found, predicted.proposal))
    best: Trial | None = None
    for found, proposal in _best_first(begun, at):
        outcome = "fitted, but another gains more"
        if best is None:
            longer = fit(found, recordings, FIT_ITERATIONS)
            # Where the shapes are left by what goes on, the shorter fit is the better explanation.
            shorter = longer.mean_err > at.mean_err >= found.mean_err
            found = fit(found, recordings, 0) if shorter else longer
            # A proposal with which predictions stay farther from the shapes is no explanation,
            # whatever its log evidence.
            if not gains((found, proposal), at):
                outcome = "gains too little"
            elif not comes_nearer(found, at, recordings):
                outcome = "makes matters worse"
            else:
                best, outcome = (found, proposal), "added"
        gain = found.posterior.evidence - at.posterior.evidence
        trace.append(Step(number, proposal.label, gain, found.mean_err, outcome))
    return best, trace


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


def _best_first(begun: Sequence[Trial], at: Evaluation) -> list[Trial]:
    """Trials by their log evidence; of those that gain alike, the nearest to the shapes first."""
    most = max((trial[0].posterior.evidence for trial in begun), default=0.0)
    least = most - SAME_GAIN * (most - at.posterior.evidence)

    def order(trial: Trial) -> tuple[bool, float]:
        evidence = trial[0].posterior.evidence
        return evidence < least, trial[0].mean_err if evidence >= least else -evidence

    return sorted(begun, key=order)


def _checked(
    at: Evaluation, predicted: PredictedGain, recordings: Sequence[Recording]
) -> tuple[float, PredictedGain]:
    """ERR [m] of a proposal where its fit begins, and that beginning.

    Gains are predicted linearly, for correlated errors: the step to the predicted model is often
    too long, and what it gains may be but the rapid part of the residuals. A few steps with the
    same derivatives tell how near to the shapes the proposal leads.

    Args:
        at: the model without the proposal.

    Raises:
        SimulationError: it cannot be simulated there.
    """
    smooth = predicted.proposal.from_nothing
    begin = _with_columns(at, predicted)
    if not smooth:
        begin = borrowed(begin, _nearest_size(predicted, recordings), recordings)
    model = _held(begin.model, {*at.model.names, *(predicted.proposal.columns if smooth else ())})
    found = approached(replace(begin, model=model), recordings)
    return found.mean_err, replace(predicted, model=predicted.begin.at(found.model.theta()))


def _with_columns(at: Evaluation, predicted: PredictedGain) -> Evaluation:
    """The model with a proposal at its first values, and the derivatives that are known there."""
    names, fields, model = at.model.names, at.fields, predicted.begin
    if predicted.columns and predicted.proposal.from_nothing:
        names, fields = (*names, *predicted.proposal.columns), joined(fields, predicted.columns)
    # Of other parameters no derivative is known yet: a column of zeros stands behind the others.
    place = [names.index(n) if n in names else len(names) for n in model.names]
    known = tuple((r, np.pad(j, ((0, 0), (0, 1), (0, 0)))[:, place]) for r, j in fields)
    return compared(Simulated(model, known, at.err, at.predicted, at.motions), at.variances)


def _held(model: ParametricModel, known: Collection[str]) -> ParametricModel:
    """The model with those parameters held of which no derivative is known.

    Their priors alone would say where they go: places to the middle of their range.
    """
    pairs = zip(model.parameters, model.theta(), strict=True)
    return model.with_prior([p.held(float(x)) for p, x in pairs if p.name not in known])


def _nearest_size(predicted: PredictedGain, recordings: Sequence[Recording]) -> ParametricModel:
    """The model on the way to the predicted one, of the size that comes nearest to the shapes.

    What the DLO hits has a place instead, to which no derivative leads.

    Raises:
        SimulationError: none can be simulated.
    """
    begin, end = predicted.begin.theta(), predicted.model.theta()
    found: list[tuple[float, ParametricModel]] = []

    def tried(theta: FloatArray) -> float:
        model = predicted.begin.at(theta)
        try:
            err = simulate(model, recordings, ()).mean_err
        except SimulationError as reason:
            LOG.info("%s: %s", predicted.proposal.label, reason)
            return float(np.finfo(float).max)
        found.append((err, model))
        return err

    for share in SHARES:
        tried(begin + share * (end - begin))
    if not found:
        raise SimulationError("no beginning can be simulated")
    here = min(found, key=lambda row: row[0])[1]
    size = _size(predicted.proposal)
    if size is not None:
        k, most = here.index(size.name), float(np.log(SIZES))
        value = size.outer(here.theta()[k])

        def resized(factor: float) -> float:
            theta = here.theta()
            theta[k] = size.inner(value * float(np.exp(factor)))
            return tried(theta)

        minimize_scalar(
            resized, bounds=(-most, most), method="bounded", options={"maxiter": SIZE_TRIALS}
        )
    elif not effects()[predicted.proposal.effect].differentiable:
        parameters = predicted.proposal.parameters
        places = [here.index(p.name) for p in parameters]
        corners = np.vstack([np.zeros(len(places)), np.diag([p.step for p in parameters])])

        def placed(moves: FloatArray) -> float:
            theta = here.theta()
            theta[places] += moves
            return tried(theta)

        minimize(
            placed, corners[0], method="Nelder-Mead",
            options={"maxfev": PLACE_TRIALS, "initial_simplex": corners},
        )  # fmt: skip
    return min(found, key=lambda row: row[0])[1]


def _size(proposal: Proposal) -> Parameter | None:
    """The size of an effect that begins at a finite value; None where it has no size, as a peg."""
    start = proposal.start
    if start is None or start.neutral or not start.screened:
        return None
    key = start.screened[0]
    if quantities(start.effect)[key].geometric:
        return None
    return next((p for p in proposal.parameters if p.key == key), None)


def gains(trial: Trial, at: Evaluation) -> bool:
    """Whether a trial is worth its cause, over a model without it."""
    return trial[0].posterior.evidence >= at.posterior.evidence + WORTH


def best_gain(
    trials: Sequence[Trial], at: Evaluation, recordings: Sequence[Recording]
) -> Trial | None:
    """The trial that explains most, nearer to the shapes than a model; None where none gains."""
    worth = [trial for trial in trials if gains(trial, at)]
    worth.sort(key=lambda trial: -trial[0].posterior.evidence)
    return next((trial for trial in worth if comes_nearer(trial[0], at, recordings)), None)


def comes_nearer(found: Evaluation, at: Evaluation, recordings: Sequence[Recording]) -> bool:
    """Whether a fit lies nearer to the shapes than another one, or can come nearer."""
    if found.mean_err <= at.mean_err:
        return True
    return nearest_err(found, recordings) <= nearest_err(at, recordings)


def fitted(
    model: ParametricModel, recordings: Sequence[Recording], iterations: int = FIT_ITERATIONS, *,
    far: bool = False, draft: bool = False,
) -> Evaluation | None:  # fmt: skip
    """The model fitted; None where it cannot be simulated.

    Args:
        far: whether all that is left counts as white noise at first, see `joint_fit.fit`.
        draft: see `joint_fit.fit`.
    """
    try:
        begin = evaluate(model, recordings)
        if far:
            begin = fit(begin, recordings, iterations, loss=WHITE, draft=True)
        return fit(begin, recordings, iterations, draft=draft)
    except SimulationError as err:
        LOG.info("not fitted: %s", err)
        return None
