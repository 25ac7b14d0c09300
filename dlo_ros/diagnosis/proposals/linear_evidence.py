# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Proposals: what might be a cause, and what the linearised posterior promises of it.

A proposal frees a number of the set-up from its tolerance, or adds an effect at one of the places
where it is looked for. Nothing is fitted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.effects import Start, damping_effect
from dlo_ros.inference import priors
from dlo_ros.inference.joint import Evaluation, Field, Simulated
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.priors import SLAB
from dlo_ros.inference.spectrum import Spectrum, spectrum
from dlo_ros.inference.variances import Posterior, fit_variances
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

VARIANCE_ITERATIONS = 8
"""Iterations of the error variances for a promise."""
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

    @property
    def from_nothing(self) -> bool:
        """Whether a little of it changes the shapes a little, so that derivatives tell of it."""
        return self.start is None or self.start.neutral


@dataclass(frozen=True)
class Promise:
    """The expectation of the linearised posterior for a proposal.

    Args:
        gain: in log evidence.
        begin: the model with the proposal where it begins.
        model: where it promises most, from which the fit starts.
    """

    proposal: Proposal
    gain: float
    begin: ParametricModel
    model: ParametricModel


def freed(model: ParametricModel) -> list[Proposal]:
    """Numbers of the set-up that leave their tolerance, those of one place together.

    Damping that the parameter file only guesses is one, too.
    """
    groups: dict[tuple[str, str], list[Parameter]] = {}
    for p in model.parameters:
        if p.tolerated:
            key = p.key.partition("[")[0]
            several = p.effect.startswith("clamp")  # each clamp by itself
            groups.setdefault((p.effect, key if several else ""), []).append(p)
        elif p.guessed and (effect := told_as(p)):
            groups[effect, ""] = [p]
    return [
        Proposal(effect, form, None, tuple(p.freed(SLAB) for p in ps), tuple(p.name for p in ps))
        for (effect, form), ps in groups.items()
    ]


def told_as(p: Parameter) -> str:
    """Effect as which a parameter that is off is told; empty for E and mu."""
    return p.effect or damping_effect(p.name)


def pinned(p: Parameter) -> Parameter:
    """A parameter that is held at its prior's centre."""
    return replace(p, std=1e-6 * p.std)


def added(model: ParametricModel, begun: Sequence[Start]) -> list[Proposal]:
    """Effects that the set-up does not contain, where they are looked for."""
    result = []
    for start in begun:
        present = model.settings.effects.get(start.effect, {})
        if any(key in present for key in start.fitted):
            continue  # the set-up has it, see `freed`
        result.append(proposal_of(model.settings, start))
    return result


def proposal_of(settings: Settings, start: Start) -> Proposal:
    """An effect that is added where it is looked for."""
    fitted, names = priors.cause_priors(settings, start)
    return Proposal(start.effect, start.form or _place(start), start, fitted, names)


def _place(start: Start) -> str:
    place = start.block.get("position", start.block.get("centre"))
    return f"at {place:.3g} m" if isinstance(place, float) and start.neutral else ""


Extra = dict[int, tuple[FloatArray, ...]]
"""Derivatives by what a proposal adds, per recording (F, Q, K), by the proposal's identity."""


def sheets(proposals: Sequence[Proposal]) -> list[list[Proposal]]:
    """Added effects that share a simulation: those that do nothing at first, one of each kind."""
    waiting = [p for p in proposals if p.start is not None]
    result = [[p] for p in waiting if not p.from_nothing]
    neutral = [p for p in waiting if p.from_nothing]
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
        names += p.columns if p.from_nothing else ()
    return model, tuple(names)


def columns(at: Evaluation, sheet: Sequence[Proposal], found: Simulated) -> Extra:
    """Derivatives by what each proposal of a sheet adds; its whole change where it has none.

    Args:
        found: the simulation of `with_sheet`.
    """
    result: Extra = {}
    first = 0
    for p in sheet:
        if not p.from_nothing:
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
    assert proposal.start is not None
    if not proposal.from_nothing:
        return np.zeros(1), np.array([AMPLITUDE_STD**-2])
    linear = tuple(p for p in proposal.parameters if p.name in proposal.columns)
    block = {proposal.effect: dict(proposal.start.block)}
    own = ParametricModel(settings.with_effects(block), linear)
    return own.offset(), own.precision()


def promises(at: Evaluation, proposals: Sequence[Proposal], extra: Extra) -> list[Promise]:
    """The linearised gain of each proposal.

    Args:
        extra: contains the proposals, but for those that free a number of the set-up.
    """
    adding = [p for p in proposals if p.start is not None]
    spectra = at.spectra
    if adding:
        n = at.model.settings.rod.control_points
        wide = joined(
            at.fields,
            [np.concatenate(x, axis=1) for x in zip(*(extra[id(p)] for p in adding), strict=True)],
        )
        spectra = tuple(spectrum(r, j, n) for r, j in wide)
    own = len(at.model.parameters)
    first, result = own, []
    for p in proposals:
        if p.start is None:
            result.append(_freed(at, p))
            continue
        last = first + extra[id(p)][0].shape[1]
        pick = [*range(own), *range(first, last)]
        result.append(_added(at, p, tuple(s.chosen(pick) for s in spectra)))
        first = last
    return result


def _freed(at: Evaluation, proposal: Proposal) -> Promise:
    """The promise of numbers of the set-up that leave their tolerance."""
    model = at.model.with_prior(proposal.parameters)
    found = linear_posterior(at, at.spectra, model.offset(), model.precision())
    gain = found.evidence - at.posterior.evidence
    return Promise(proposal, gain, model, model.at(model.theta() + found.step))


def _added(at: Evaluation, proposal: Proposal, spectra: Sequence[Spectrum]) -> Promise:
    """The promise of an effect, with what it changes as last columns of the spectra."""
    assert proposal.start is not None
    offset, precision = linear_prior(at.model.settings, proposal)
    found = linear_posterior(
        at, spectra, np.append(at.model.offset(), offset),
        np.append(at.model.precision(), precision),
    )  # fmt: skip
    count = len(at.model.parameters)
    step, amount = found.step[:count], found.step[count:]
    gain = found.evidence - at.posterior.evidence
    if not proposal.from_nothing and amount[0] <= 0.0:
        return Promise(proposal, 0.0, at.model, at.model)
    model = at.model.extended(proposal.effect, dict(proposal.start.block), proposal.parameters)
    if not proposal.from_nothing:
        share = min(1.0 / amount[0], 1.0)
        return Promise(proposal, gain, model, model.at(_moved(model, at.model, share * step)))
    theta = _moved(model, at.model, step)
    linear = [p.name for p in proposal.parameters if p.name in proposal.columns]
    for name, x in zip(linear, amount, strict=True):
        theta[model.index(name)] += x
    return Promise(proposal, gain, model, model.at(theta))


def _moved(model: ParametricModel, before: ParametricModel, step: FloatArray) -> FloatArray:
    """Values of a larger model where those of a smaller one have moved."""
    theta = model.theta()
    for name, x in zip(before.names, step, strict=True):
        theta[model.index(name)] += x
    return theta


def linear_posterior(
    at: Evaluation, spectra: Sequence[Spectrum], offset: FloatArray, precision: FloatArray
) -> Posterior:
    """The posterior of a model that is linear around its values; the error variances follow."""
    _, found = fit_variances(
        spectra, offset, precision, at.model.settings.rod.length, at.variances,
        VARIANCE_ITERATIONS,
    )  # fmt: skip
    return found
