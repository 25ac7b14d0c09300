# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Causes that recordings show beyond the tolerances of a set-up: a search by evidence.

The set-up within its tolerances is always part of the model. Of the proposals (`linear_evidence`)
the most promising ones are simulated, those that come nearest are fitted, and the one that raises
the log evidence most stays.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from dlo_ros.diagnosis.contact.contact_search import PegBesideSetUp
from dlo_ros.diagnosis.proposals.linear_evidence import (
    Extra,
    Promise,
    Proposal,
    added,
    columns,
    freed,
    linear_posterior,
    pinned,
    promises,
    proposal_of,
    sheets,
    with_sheet,
)
from dlo_ros.effects import Start, quantities
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, borrowed, evaluate, fit, misfit, simulate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.priors import SLAB
from dlo_ros.inference.variances import posterior
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

WORTH = 3.0
"""Gain in log evidence for which a cause is added: twenty to one."""
LOWERS = 0.1
"""Share of ERR that a cause must take away to be named."""
MOST_CAUSES = 6
CHECKED = 10
NEAR = 0.3
"""Proposals that are simulated in a step, those that promise most, and their share of the best
promise: a promise is linear, and no better than that."""
WORSE = 2.0
"""ERR over that without a proposal, from which no fit begins at the values that it promises."""
INDISPENSABLE = 10.0 * WORTH
"""Loss of log evidence without a cause by the linearised posterior, from which no fit without it
need be tried."""
SHARES = (1.0, 0.5)
"""Shares of the way to the promised model that are simulated."""
SIZES, SIZE_TRIALS = 2.2, 6
"""Factor up to which the size of an effect that begins at a finite one may be larger or smaller
where its fit begins, and number of sizes that are simulated: no derivative tells of it."""
TRIALS = 3
"""Proposals that are fitted, those that come nearest in a simulation."""
FIRST_ITERATIONS, FIT_ITERATIONS = 4, 12
"""Iterations of each proposal, and of the best of them."""


@dataclass(frozen=True)
class Offer:
    """Effects that might be added to a model, each simulated where it is looked for.

    Args:
        proposals: of effects that the model does not contain.
        extra: what each of them changes, see `linear_evidence.columns`.
    """

    proposals: tuple[Proposal, ...]
    extra: Extra


@dataclass(frozen=True)
class Step:
    """A candidate of one step, for the trace.

    Args:
        step: number of the step.
        name: of the proposal.
        gain: in log evidence, as fitted, or as promised where it was not.
        err: of the fitted model [m]; None where it was not fitted.
        outcome: why it was kept or dropped.
    """

    step: int
    name: str
    gain: float
    err: float | None
    outcome: str


@dataclass(frozen=True)
class Search:
    """The result of a search.

    Args:
        at: the joint model with all causes.
        causes: in the order in which they were found.
        trace: every candidate of every step.
        offer: what else might be a cause; None where it was not asked for any more.
    """

    at: Evaluation
    causes: tuple[Proposal, ...]
    trace: tuple[Step, ...]
    offer: Offer | None


def best_peg(
    at: Evaluation, recordings: Sequence[Recording], pegs: Sequence[PegBesideSetUp]
) -> tuple[Evaluation, Proposal] | None:
    """The fit with the peg that explains most; each starts from the fit before the impact.

    Args:
        at: the joint model without a peg, fitted to the same recordings, perhaps in another
            minimum.
        pegs: candidates, with the model as it was before the impact.
    """
    found = []
    for candidate in pegs:
        proposal = proposal_of(candidate.before.settings, candidate.peg)
        model, _ = with_sheet(candidate.before, [proposal])
        here = fitted(model, recordings)
        if here is not None and here.mean_err < at.mean_err:
            found.append((here, proposal))
    best = max(found, key=lambda row: row[0].posterior.evidence, default=None)
    gained = best is not None and best[0].posterior.evidence - at.posterior.evidence >= WORTH
    return best if gained else None


def search(
    at: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start], enough: float,
    first_peg: tuple[Evaluation, Proposal] | None = None,
) -> Search:  # fmt: skip
    """Add causes one by one, the one that raises the log evidence most first.

    The search ends with a cause that takes too little of ERR away to be named. The laws of the
    causes before it differ from the true ones; many effects can compensate for a little of that
    difference, and none of them is its reason.

    Args:
        at: the joint model with its set-up within tolerance, fitted.
        begun: effects that might be added, at their starting values.
        enough: ERR [m] below which no cause is looked for.
        first_peg: the fit with a peg that the DLO has hit, and the peg; see `best_peg`.
    """
    causes: list[Proposal] = []
    dropped: set[str] = set()
    trace: list[Step] = []
    offer: Offer | None = None
    if first_peg is not None:
        gain = first_peg[0].posterior.evidence - at.posterior.evidence
        at, causes = first_peg[0], [first_peg[1]]
        trace.append(Step(1, first_peg[1].label, gain, at.mean_err, "added"))
        _tell(trace)
    while len(causes) < MOST_CAUSES and at.mean_err > enough:
        known = {c.label for c in causes} | {c.effect for c in causes if c.start is not None}
        known |= dropped
        number = len(causes) + 1
        offer = offered(at, recordings, begun)
        candidates = [
            p for p in promised(at, offer) if not {p.proposal.label, p.proposal.effect} & known
        ]
        found, steps = _best_of(number, at, candidates, recordings)
        trace += steps
        _tell(steps)
        if found is None:
            break
        little = found[0].mean_err > (1.0 - LOWERS) * at.mean_err
        at, causes, offer = found[0], [*causes, found[1]], None
        for cause in reversed(causes):
            if linear_loss(at, cause) > INDISPENSABLE:
                continue
            bare = without(at, cause, recordings)
            if bare is None or at.posterior.evidence - bare.posterior.evidence >= WORTH:
                continue
            loss = at.posterior.evidence - bare.posterior.evidence
            trace.append(Step(number, cause.label, loss, bare.mean_err, "returned: not needed"))
            _tell(trace[-1:])
            at, causes = bare, [c for c in causes if c is not cause]
            dropped.add(cause.label)
        if little:
            break
    return Search(at, tuple(causes), tuple(trace), offer)


def _tell(steps: Sequence[Step]) -> None:
    """The candidates of a step, in the log."""
    for s in steps:
        err = "-" if s.err is None else f"{1e3 * s.err:.3f} mm"
        LOG.info("cause %d: %s: %+.1f, ERR %s: %s", s.step, s.name, s.gain, err, s.outcome)


def linear_loss(at: Evaluation, cause: Proposal, *, wholly: bool = False) -> float:
    """Log evidence lost without a cause, by the linearised posterior; 0 where it tells nothing.

    Args:
        wholly: see `without`.
    """
    if cause.start is None and not wholly:
        bare = at.model.with_prior([_tolerated(p) for p in cause.parameters])
    elif cause.from_nothing:
        bare = at.model.with_prior([pinned(p) for p in cause.parameters])
    else:
        return 0.0
    found = linear_posterior(at, at.spectra, bare.offset(), bare.precision())
    return at.posterior.evidence - found.evidence


def _tolerated(p: Parameter) -> Parameter:
    """A freed number of the set-up back within its tolerance."""
    return replace(p, std=p.std / SLAB, tolerated=bool(p.effect))


def without(
    at: Evaluation, cause: Proposal, recordings: Sequence[Recording], *, wholly: bool = False
) -> Evaluation | None:
    """The joint model fitted without a cause; None where it cannot be simulated.

    Args:
        wholly: whether a number of the set-up becomes neutral, instead of going back to its
            tolerance.
    """
    if cause.start is None and not wholly:
        return fitted(at.model.with_prior([_tolerated(p) for p in cause.parameters]), recordings)
    begins = [_neutral(at.model, cause)]
    if cause.from_nothing:
        # Where the linearised posterior lies once the cause is at neutral.
        held = at.model.with_prior([pinned(p) for p in cause.parameters])
        found = posterior(at.spectra, at.variances, held.offset(), held.precision())
        begins.append(_neutral(at.model.at(at.model.theta() + found.step), cause))
    begun: list[Evaluation] = []
    for model in begins:
        try:
            begun.append(borrowed(at, model, recordings))
        except SimulationError as err:
            LOG.info("without %s: %s", cause.label, err)
    if not begun:
        return None
    nearest = min(begun, key=lambda e: misfit(e, at))
    return fit(nearest, recordings, FIT_ITERATIONS, fresh=False)


def _neutral(model: ParametricModel, cause: Proposal) -> ParametricModel:
    """The model without a cause; a damping goes back to the parameter file's value."""
    names = [p.name for p in cause.parameters if p.effect]
    kept = [pinned(p) for p in cause.parameters if not p.effect]
    model = model.with_prior(kept)
    theta = model.theta()
    for p in kept:
        theta[model.index(p.name)] = p.centre
    return model.at(theta).without(names)


def _best_of(
    number: int, at: Evaluation, promises: Sequence[Promise], recordings: Sequence[Recording]
) -> tuple[tuple[Evaluation, Proposal] | None, list[Step]]:
    """Fit the most promising proposals; return the one that gains most, if it is worth adding."""
    trace: list[Step] = []
    checked: list[tuple[float, Promise]] = []
    for k, promise in enumerate(promises):
        name = promise.proposal.label
        if k >= CHECKED or promise.gain < max(WORTH, NEAR * promises[0].gain):
            trace.append(Step(number, name, promise.gain, None, "promised less"))
            continue
        there = _checked(promise, recordings)
        if there is None:
            trace.append(Step(number, name, promise.gain, None, "cannot be simulated"))
        else:
            checked.append(there)
    checked.sort(key=lambda row: row[0])
    begun: list[tuple[Evaluation, Proposal]] = []
    for k, (err, promise) in enumerate(checked):
        name = promise.proposal.label
        if k >= TRIALS or err > WORSE * at.mean_err:
            outcome = "others come nearer" if k >= TRIALS else "makes matters worse"
            trace.append(Step(number, name, promise.gain, err, outcome))
            continue
        found = fitted(promise.model, recordings, FIRST_ITERATIONS)
        if found is None:
            trace.append(Step(number, name, promise.gain, err, "cannot be simulated"))
        else:
            begun.append((found, promise.proposal))
    # A proposal with which predictions lie farther from the shapes is no explanation, whatever its
    # log evidence.
    begun.sort(key=lambda row: (row[0].mean_err > at.mean_err, -row[0].posterior.evidence))
    best: tuple[Evaluation, Proposal] | None = None
    for k, (found, proposal) in enumerate(begun):
        outcome = "fitted, but another gains more"
        if k == 0:
            found = fit(found, recordings, FIT_ITERATIONS)
            outcome = "gains too little"
        gain = found.posterior.evidence - at.posterior.evidence
        if found.mean_err > at.mean_err:
            outcome = "makes matters worse"
        elif k == 0 and gain >= WORTH:
            best, outcome = (found, proposal), "added"
        trace.append(Step(number, proposal.label, gain, found.mean_err, outcome))
    return best, trace


def _checked(promise: Promise, recordings: Sequence[Recording]) -> tuple[float, Promise] | None:
    """ERR [m] of a proposal where it promises most, and from where it is fitted; None: nowhere."""
    begin, end = promise.begin.theta(), promise.model.theta()
    found: list[tuple[float, Promise]] = []

    def tried(theta: FloatArray) -> float:
        model = promise.begin.at(theta)
        try:
            err = simulate(model, recordings, ()).mean_err
        except SimulationError as reason:
            LOG.info("%s: %s", promise.proposal.label, reason)
            return float(np.finfo(float).max)
        found.append((err, replace(promise, model=model)))
        return err

    for share in SHARES:
        tried(begin + share * (end - begin))
    size = _size(promise.proposal)
    if size is not None and found:
        here = min(found, key=lambda row: row[0])[1].model
        k, theta, most = here.index(size.name), here.theta(), float(np.log(SIZES))
        value = size.outer(theta[k])

        def resized(factor: float) -> float:
            theta[k] = size.inner(value * float(np.exp(factor)))
            return tried(theta)

        minimize_scalar(
            resized, bounds=(-most, most), method="bounded", options={"maxiter": SIZE_TRIALS}
        )
    return min(found, key=lambda row: row[0], default=None)


def _size(proposal: Proposal) -> Parameter | None:
    """The size of an effect that begins at a finite value; None where it has no size, as a peg."""
    start = proposal.start
    if start is None or start.neutral or not start.screened:
        return None
    key = start.screened[0]
    if quantities(start.effect)[key].geometric:
        return None
    return next((p for p in proposal.parameters if p.key == key), None)


def fitted(
    model: ParametricModel, recordings: Sequence[Recording], iterations: int = FIT_ITERATIONS
) -> Evaluation | None:
    """The model fitted; None where it cannot be simulated."""
    try:
        return fit(evaluate(model, recordings), recordings, iterations)
    except SimulationError as err:
        LOG.info("not fitted: %s", err)
        return None


def offered(at: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start]) -> Offer:
    """Simulate every effect that might be added to a model."""
    proposals = added(at.model, begun)
    extra: Extra = {}
    for sheet in sheets(proposals):
        model, names = with_sheet(at.model, sheet)
        try:
            extra |= columns(at, sheet, simulate(model, recordings, names))
        except SimulationError as err:
            LOG.info("%s: %s", ", ".join(p.label for p in sheet), err)
    return Offer(tuple(p for p in proposals if id(p) in extra), extra)


def promised(at: Evaluation, offer: Offer, *, smooth: bool = False) -> list[Promise]:
    """The promises of all proposals, best first.

    Args:
        offer: of the same model, or of one with more causes, which differs by little.
        smooth: whether only those that are linear at first.
    """
    proposals = [
        p for p in (*freed(at.model), *offer.proposals)
        if not smooth or p.from_nothing
    ]  # fmt: skip
    return sorted(promises(at, proposals, offer.extra), key=lambda p: -p.gain)
