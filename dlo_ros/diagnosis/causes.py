# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Causes that recordings show beyond the tolerances of a set-up: proposals and their evidence.

The set-up within its tolerances is always part of the model. A proposal frees a number of the
set-up from its tolerance, or adds an effect at one of the places where it is looked for; the
linearised posterior tells by how much it would raise the log evidence, before anything is fitted.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.candidates import starts
from dlo_ros.effects import Scene, Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference import priors
from dlo_ros.inference.joint import (
    Evaluation,
    Field,
    Simulated,
    evaluate,
    fit,
    misfit,
    simulate,
)  # fmt: skip
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.priors import SLAB
from dlo_ros.inference.spectrum import spectrum
from dlo_ros.inference.variances import Posterior, fit_variances, posterior
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

WORTH = 3.0
"""Gain in log evidence for which a cause is added: twenty to one."""
MOST_CAUSES = 6
TRIALS = 3
NEAR = 0.8
"""Proposals that are fitted in a step, those that promise most, and their share of the best
promise: a promise is linear, and no better than that."""
VARIANCE_ITERATIONS = 8
"""Iterations of the error variances for a promise."""
FIRST_ITERATIONS, FIT_ITERATIONS = 4, 12
"""Iterations of each proposal, and of the best of them."""
AMPLITUDE_STD = 1.5
"""Prior standard deviation of the amplitude of an effect that acts from a finite size on."""


@dataclass(frozen=True)
class Proposal:
    """Something that might be a cause.

    Args:
        effect: its name.
        form: tells variants of one effect apart.
        start: of an effect that is added; None: a number of the set-up is freed.
        parameters: with the priors of a cause; all that are fitted.
        columns: names of those in which the effect is linear at first.
    """

    effect: str
    form: str
    start: Start | None
    parameters: tuple[Parameter, ...]
    columns: tuple[str, ...]

    @property
    def label(self) -> str:
        """For people."""
        return f"{self.effect} ({self.form})" if self.form else self.effect


@dataclass(frozen=True)
class Promise:
    """The expectation of the linearised posterior for a proposal.

    Args:
        gain: in log evidence.
        model: from which the fit starts.
    """

    proposal: Proposal
    gain: float
    model: ParametricModel


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
    """

    at: Evaluation
    causes: tuple[Proposal, ...]
    trace: tuple[Step, ...]


def search(at: Evaluation, recordings: Sequence[Recording], scene: Scene, enough: float) -> Search:
    """Add causes one by one, that which raises the log evidence most first.

    Args:
        at: the joint model with its set-up within tolerance, fitted.
        enough: ERR [m] below which nothing is looked for.
    """
    causes: list[Proposal] = []
    dropped: set[str] = set()
    trace: list[Step] = []
    while len(causes) < MOST_CAUSES and at.mean_err > enough:
        known = {c.label for c in causes} | {c.effect for c in causes if c.start is not None}
        known |= dropped
        number = len(causes) + 1
        promises = promised(at, recordings, scene)
        promises = [p for p in promises if not {p.proposal.label, p.proposal.effect} & known]
        found, steps = _best_of(number, at, promises, recordings)
        trace += steps
        if found is None:
            break
        at, causes = found[0], [*causes, found[1]]
        for cause in reversed(causes):
            bare = without(at, cause, recordings)
            if bare is None or at.posterior.evidence - bare.posterior.evidence >= WORTH:
                continue
            loss = at.posterior.evidence - bare.posterior.evidence
            trace.append(Step(number, cause.label, loss, bare.mean_err, "returned: not needed"))
            at, causes = bare, [c for c in causes if c is not cause]
            dropped.add(cause.label)
    return Search(at, tuple(causes), tuple(trace))


def without(
    at: Evaluation, cause: Proposal, recordings: Sequence[Recording], *, wholly: bool = False
) -> Evaluation | None:
    """The joint model fitted without a cause; None where it cannot be simulated.

    Args:
        wholly: whether a number of the set-up becomes neutral, instead of going back to its
            tolerance.
    """
    names = [p.name for p in cause.parameters]
    if cause.start is None and not wholly:
        tolerated = [replace(p, std=p.std / SLAB, tolerated=True) for p in cause.parameters]
        return fitted(at.model.with_prior(tolerated), recordings)
    begins = [at.model.without(names)]
    if cause.start is None or cause.start.neutral:
        # Where the linearised posterior lies once the cause is at neutral.
        held = at.model.with_prior([pinned(p) for p in cause.parameters])
        found = posterior(at.spectra, at.variances, held.offset(), held.precision())
        begins.append(at.model.at(at.model.theta() + found.step).without(names))
    begun: list[Evaluation] = []
    for model in begins:
        try:
            begun.append(evaluate(model, recordings))
        except SimulationError as err:
            LOG.info("without %s: %s", cause.label, err)
    if not begun:
        return None
    nearest = min(begun, key=lambda e: misfit(e, at))
    return fit(nearest, recordings, FIT_ITERATIONS)


def pinned(p: Parameter) -> Parameter:
    """A parameter that is held at its prior's centre."""
    return replace(p, std=1e-6 * p.std)


def _best_of(
    number: int, at: Evaluation, promises: Sequence[Promise], recordings: Sequence[Recording]
) -> tuple[tuple[Evaluation, Proposal] | None, list[Step]]:
    """Fit the proposals that promise most; the one that gains most, if it is worth it."""
    trace: list[Step] = []
    begun: list[tuple[Evaluation, Proposal]] = []
    for k, promise in enumerate(promises):
        name = promise.proposal.label
        if k >= TRIALS or promise.gain < max(WORTH, NEAR * promises[0].gain):
            trace.append(Step(number, name, promise.gain, None, "promised less"))
            continue
        found = fitted(promise.model, recordings, FIRST_ITERATIONS)
        if found is None:
            trace.append(Step(number, name, promise.gain, None, "cannot be simulated"))
        else:
            begun.append((found, promise.proposal))
    begun.sort(key=lambda row: -row[0].posterior.evidence)
    best: tuple[Evaluation, Proposal] | None = None
    for k, (found, proposal) in enumerate(begun):
        outcome = "fitted, but another gains more"
        if k == 0:
            found = fit(found, recordings, FIT_ITERATIONS)
            outcome = "gains too little"
        gain = found.posterior.evidence - at.posterior.evidence
        if k == 0 and gain >= WORTH:
            best, outcome = (found, proposal), "added"
        trace.append(Step(number, proposal.label, gain, found.mean_err, outcome))
    return best, trace


def fitted(
    model: ParametricModel, recordings: Sequence[Recording], iterations: int = FIT_ITERATIONS
) -> Evaluation | None:
    """The model fitted; None where it cannot be simulated."""
    try:
        return fit(evaluate(model, recordings), recordings, iterations)
    except SimulationError as err:
        LOG.info("not fitted: %s", err)
        return None


def promised(
    at: Evaluation, recordings: Sequence[Recording], scene: Scene, *, smooth: bool = False
) -> list[Promise]:
    """The promises of all proposals, best first.

    Args:
        smooth: whether only those that are linear at first.
    """
    proposals = [
        p for p in (*freed(at.model), *added(at.model, scene))
        if not smooth or p.start is None or p.start.neutral
    ]  # fmt: skip
    extra: Extra = {}
    for sheet in sheets(proposals):
        model, names = with_sheet(at.model, sheet)
        try:
            extra |= columns(at, sheet, simulate(model, recordings, names))
        except SimulationError as err:
            LOG.info("%s: %s", ", ".join(p.label for p in sheet), err)
    found = [promise(at, p, extra) for p in proposals if p.start is None or id(p) in extra]
    return sorted(found, key=lambda p: -p.gain)


def freed(model: ParametricModel) -> list[Proposal]:
    """Numbers of the set-up that leave their tolerance, those of one place together."""
    groups: dict[tuple[str, str], list[Parameter]] = {}
    for p in model.parameters:
        if p.effect and p.tolerated:
            key = p.key.partition("[")[0]
            several = p.effect.startswith("clamp")  # each clamp by itself
            groups.setdefault((p.effect, key if several else ""), []).append(p)
    return [
        Proposal(effect, form, None, tuple(p.freed(SLAB) for p in ps), tuple(p.name for p in ps))
        for (effect, form), ps in groups.items()
    ]


def added(model: ParametricModel, scene: Scene) -> list[Proposal]:
    """Effects that the set-up does not contain, where they are looked for."""
    result = []
    for start in starts(scene):
        present = model.settings.effects.get(start.effect, {})
        if any(key in present for key in start.fitted):
            continue  # the set-up has it, see `freed`
        result.append(proposal_of(model.settings, start))
    return result


def proposal_of(settings: Settings, start: Start) -> Proposal:
    """An effect that is added where it is looked for."""
    fitted, names = priors.cause(settings, start)
    return Proposal(start.effect, start.form or _place(start), start, fitted, names)


def _place(start: Start) -> str:
    place = start.block.get("position", start.block.get("centre"))
    return f"at {place:.3g} m" if isinstance(place, float) and start.neutral else ""


Extra = dict[int, tuple[FloatArray, ...]]
"""Derivatives by what a proposal adds, per recording (F, Q, K), by the proposal's identity."""


def sheets(proposals: Sequence[Proposal]) -> list[list[Proposal]]:
    """Added effects that share a simulation: those that do nothing at first, one of each kind."""
    waiting = [p for p in proposals if p.start is not None]
    result = [[p] for p in waiting if p.start is not None and not p.start.neutral]
    neutral = [p for p in waiting if p.start is not None and p.start.neutral]
    while neutral:
        sheet: list[Proposal] = []
        for p in neutral:
            if p.effect not in {s.effect for s in sheet}:
                sheet.append(p)
        neutral = [p for p in neutral if p not in sheet]
        result.append(sheet)
    return result


def with_sheet(
    model: ParametricModel, sheet: Sequence[Proposal]
) -> tuple[ParametricModel, tuple[str, ...]]:
    """The model with the effects of a sheet, and the parameters of which derivatives are wanted."""
    names: list[str] = []
    for p in sheet:
        assert p.start is not None
        model = model.extended(p.effect, dict(p.start.block), p.parameters)
        names += p.columns if p.start.neutral else ()
    return model, tuple(names)


def columns(at: Evaluation, sheet: Sequence[Proposal], found: Simulated) -> Extra:
    """Derivatives by what each proposal of a sheet adds; its whole change where it has none.

    Args:
        found: the simulation of `with_sheet`.
    """
    result: Extra = {}
    first = 0
    for p in sheet:
        if p.start is not None and not p.start.neutral:
            result[id(p)] = tuple(
                (here[0] - there[0])[:, None, :]
                for here, there in zip(at.fields, found.fields, strict=True)
            )
            continue
        last = first + len(p.columns)
        result[id(p)] = tuple(j[:, first:last] for _, j in found.fields)
        first = last
    return result


def joined(fields: Sequence[Field], extra: Sequence[FloatArray]) -> tuple[Field, ...]:
    """Residuals with further derivatives."""
    return tuple(
        (r, np.concatenate([j, c], axis=1)) for (r, j), c in zip(fields, extra, strict=True)
    )


def linear_prior(settings: Settings, proposal: Proposal) -> tuple[FloatArray, FloatArray]:
    """Prior offset and precision of what an added effect is linear in at first.

    Of one that starts from a finite size that is the amplitude of its whole change.
    """
    if proposal.start is None or not proposal.start.neutral:
        return np.zeros(1), np.array([AMPLITUDE_STD**-2])
    linear = tuple(p for p in proposal.parameters if p.name in proposal.columns)
    block = {proposal.effect: dict(proposal.start.block)}
    own = ParametricModel(settings.with_effects(block), linear)
    return own.offset(), own.precision()


def promise(at: Evaluation, proposal: Proposal, extra: Extra) -> Promise:
    """The linearised gain of a proposal.

    Args:
        extra: contains the proposal, unless it frees a number of the set-up.
    """
    if proposal.start is None:
        model = at.model.with_prior(proposal.parameters)
        found = _posterior(at, at.fields, model.offset(), model.precision())
        gain = found.evidence - at.posterior.evidence
        return Promise(proposal, gain, model.at(model.theta() + found.step))
    offset, precision = linear_prior(at.model.settings, proposal)
    found = _posterior(
        at, joined(at.fields, extra[id(proposal)]), np.append(at.model.offset(), offset),
        np.append(at.model.precision(), precision),
    )  # fmt: skip
    count = len(at.model.parameters)
    step, amount = found.step[:count], found.step[count:]
    gain = found.evidence - at.posterior.evidence
    if not proposal.start.neutral and amount[0] <= 0.0:
        return Promise(proposal, 0.0, at.model)
    model = at.model.extended(proposal.effect, dict(proposal.start.block), proposal.parameters)
    if not proposal.start.neutral:
        share = min(1.0 / amount[0], 1.0)
        return Promise(proposal, gain, model.at(_moved(model, at.model, share * step)))
    theta = _moved(model, at.model, step)
    linear = [p.name for p in proposal.parameters if p.name in proposal.columns]
    for name, x in zip(linear, amount, strict=True):
        theta[model.index(name)] += x
    return Promise(proposal, gain, model.at(theta))


def _moved(model: ParametricModel, before: ParametricModel, step: FloatArray) -> FloatArray:
    """Values of a larger model where those of a smaller one have moved."""
    theta = model.theta()
    for name, x in zip(before.names, step, strict=True):
        theta[model.index(name)] += x
    return theta


def _posterior(
    at: Evaluation, fields: Sequence[Field], offset: FloatArray, precision: FloatArray
) -> Posterior:
    n = at.model.settings.rod.control_points
    same = len(offset) == len(at.model.parameters)
    spectra = at.spectra if same else tuple(spectrum(r, j, n) for r, j in fields)
    _, found = fit_variances(
        spectra, offset, precision, at.model.settings.rod.length, at.variances,
        VARIANCE_ITERATIONS,
    )  # fmt: skip
    return found
