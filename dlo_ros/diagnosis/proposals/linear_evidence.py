# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Proposals of causes, and the gain in log evidence that a linearised posterior predicts for each.

A proposal frees a number of the set-up from its tolerance, or adds an effect at one of the places
where it is looked for. Nothing is fitted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from dlo_ros.command import END, START
from dlo_ros.effects import Start, damping_effect
from dlo_ros.inference import priors
from dlo_ros.inference.joint import Evaluation, Field, Simulated, linear_posterior
from dlo_ros.inference.parameter import SLAB, Parameter, ParametricModel
from dlo_ros.inference.spectrum import Spectrum, spectra
from dlo_ros.parameters import Settings
from dlo_ros.rod.compiled_rod import is_linear
from dlo_ros.spline import FloatArray

AMPLITUDE_STD = 1.5
"""Prior standard deviation of the amplitude of an effect that acts from a finite size on."""


@dataclass(frozen=True)
class Proposal:
    """A possible cause of what the model gets wrong.

    Args:
        effect: name of the effect.
        form: name of the variant of the effect.
        start: values with which an added effect begins; None: a number of the set-up is freed.
        parameters: all parameters that are fitted, with the priors of a cause.
        columns: names of the parameters in which the effect is linear at first.
    """

    effect: str
    form: str
    start: Start | None
    parameters: tuple[Parameter, ...]
    columns: tuple[str, ...]

    @property
    def label(self) -> str:
        """Name of the proposal for terminal and report."""
        return f"{self.effect} ({self.form})" if self.form else self.effect

    @property
    def from_nothing(self) -> bool:
        """Whether the shapes change smoothly as the effect grows from nothing."""
        return self.start is None or self.start.neutral


@dataclass(frozen=True)
class PredictedGain:
    """The gain in log evidence that the linearised posterior predicts for a proposal.

    Args:
        gain: predicted increase of the log evidence.
        begin: the model with the proposal at its first values.
        model: the model at the linearised optimum.
        columns: derivatives of the shapes by what the proposal adds, see `columns`.
    """

    proposal: Proposal
    gain: float
    begin: ParametricModel
    model: ParametricModel
    columns: tuple[FloatArray, ...] = ()


def freed(model: ParametricModel) -> list[Proposal]:
    """Proposals that free numbers of the set-up from their tolerance, those of one place together.

    A damping that the parameter file only guesses is such a number, too.
    """
    groups: dict[tuple[str, str], list[Parameter]] = {}
    for p in model.parameters:
        if p.tolerated:
            key = p.key.partition("[")[0]
            end = key if key in (START, END) else ""  # each end by itself
            groups.setdefault((p.effect, end), []).append(p)
        elif p.guessed and (effect := reported_effect(p)):
            groups[effect, ""] = [p]
    return [
        Proposal(effect, form, None, tuple(p.freed(SLAB) for p in ps), tuple(p.name for p in ps))
        for (effect, form), ps in groups.items()
    ]


def reported_effect(p: Parameter) -> str:
    """Name of the effect that reports give to a parameter that is off; empty for E and mu."""
    return p.effect or damping_effect(p.name)


def added(model: ParametricModel, begun: Sequence[Start]) -> list[Proposal]:
    """Proposals of effects that the set-up does not contain, one for each place of the search."""
    return [proposal_of(model.settings, s) for s in begun if not is_present(model, s)]


def is_present(model: ParametricModel, start: Start) -> bool:
    """Whether a model has a number of an effect already, see `freed`."""
    present = model.settings.effects.get(start.effect, {})
    return any(key in present for key in start.fitted)


def proposal_of(settings: Settings, start: Start) -> Proposal:
    """The proposal that adds an effect at one place of the search."""
    fitted, names = priors.cause_priors(settings, start)
    return Proposal(start.effect, start.form or _place(start), start, fitted, names)


def _place(start: Start) -> str:
    place = start.block.get("position", start.block.get("centre"))
    return f"at {place:.3g} m" if isinstance(place, float) and start.neutral else ""


Extra = dict[int, tuple[FloatArray, ...]]
"""Derivatives by what a proposal adds, per recording (F, Q, K), by the proposal's identity."""


def simulated_together(settings: Settings, proposals: Sequence[Proposal]) -> list[list[Proposal]]:
    """Groups of added effects that share a simulation: neutral ones, one of each kind.

    Effects beside which a rod is no longer linear have groups of their own: they would make the
    derivatives by all others of their group expensive.

    Args:
        settings: settings of the rod.
    """
    waiting = [p for p in proposals if p.start is not None]
    result = [[p] for p in waiting if not p.from_nothing]
    kinds: dict[bool, dict[str, list[Proposal]]] = {True: {}, False: {}}
    for p in waiting:
        if p.start is not None and p.from_nothing:
            alone = settings.with_effects({p.effect: p.start.block})
            kinds[is_linear(alone)].setdefault(p.effect, []).append(p)
    for neutral in kinds.values():
        result += [[p for p in group if p] for group in zip_longest(*neutral.values())]
    return result


def with_proposals(
    model: ParametricModel, together: Sequence[Proposal]
) -> tuple[ParametricModel, tuple[str, ...]]:
    """The model with the effects of a group, and the parameters whose derivatives are wanted."""
    names: list[str] = []
    for p in together:
        assert p.start is not None
        model = model.extended(p.effect, dict(p.start.block), p.parameters)
        names += p.columns if p.from_nothing else ()
    return model, tuple(names)


def columns(at: Simulated, together: Sequence[Proposal], found: Simulated) -> Extra:
    """Derivatives by what each proposal of a group adds; its whole change where it has none.

    Args:
        found: the simulation of `with_proposals`.
    """
    result: Extra = {}
    first = 0
    for p in together:
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
    """The residuals with further derivatives."""
    return tuple(
        (r, np.concatenate([j, c], axis=1)) for (r, j), c in zip(fields, extra, strict=True)
    )


def linear_prior(settings: Settings, proposal: Proposal) -> tuple[FloatArray, FloatArray]:
    """Prior offset and precision of the numbers in which an added effect is linear at first.

    Of an effect that starts from a finite size, that number is the amplitude of its whole change.
    """
    assert proposal.start is not None
    if not proposal.from_nothing:
        return np.zeros(1), np.array([AMPLITUDE_STD**-2])
    linear = tuple(p for p in proposal.parameters if p.name in proposal.columns)
    block = {proposal.effect: dict(proposal.start.block)}
    own = ParametricModel(settings.with_effects(block), linear)
    return own.offset(), own.precision()


def predicted_gains(
    at: Evaluation, proposals: Sequence[Proposal], extra: Extra
) -> list[PredictedGain]:
    """The gain in log evidence that the linearised posterior predicts for each proposal.

    A proposal whose derivatives are too steep for a likelihood has none.

    Args:
        extra: derivatives of all proposals but those that free a number of the set-up.
    """
    adding = [p for p in proposals if p.start is not None]
    bins = at.spectra
    if adding:
        n = at.model.settings.rod.control_points
        wide = joined(
            at.fields,
            [np.concatenate(x, axis=1) for x in zip(*(extra[id(p)] for p in adding), strict=True)],
        )
        bins = spectra(wide, n, at.motions)
    own = len(at.model.parameters)
    first, result = own, []
    for p in proposals:
        if p.start is None:
            result.append(_freed(at, p))
            continue
        last = first + extra[id(p)][0].shape[1]
        pick = [*range(own), *range(first, last)]
        first = last
        try:
            found = _added(at, p, tuple(s.chosen(pick) for s in bins))
        except np.linalg.LinAlgError:  # derivatives so steep that priors vanish beside them
            continue
        result.append(replace(found, columns=extra[id(p)]))
    return result


def _freed(at: Evaluation, proposal: Proposal) -> PredictedGain:
    """The predicted gain of numbers of the set-up that leave their tolerance."""
    model = at.model.with_prior(proposal.parameters)
    found = linear_posterior(at, at.spectra, model.offset(), model.precision())
    gain = found.evidence - at.promised
    return PredictedGain(proposal, gain, model, model.at(model.theta() + found.step))


def _added(at: Evaluation, proposal: Proposal, bins: Sequence[Spectrum]) -> PredictedGain:
    """The predicted gain of an effect, whose changes are the last columns of the bins."""
    assert proposal.start is not None
    offset, precision = linear_prior(at.model.settings, proposal)
    found = linear_posterior(
        at, bins, np.append(at.model.offset(), offset),
        np.append(at.model.precision(), precision),
    )  # fmt: skip
    names, step = at.model.names, found.step
    if proposal.from_nothing:
        names = (*names, *(p.name for p in proposal.parameters if p.name in proposal.columns))
    else:
        amplitude = step[-1]
        if amplitude <= 0.0:
            return PredictedGain(proposal, 0.0, at.model, at.model)
        step = min(1.0 / amplitude, 1.0) * step[:-1]
    model = at.model.extended(proposal.effect, dict(proposal.start.block), proposal.parameters)
    theta = model.theta()
    for name, x in zip(names, step, strict=True):
        theta[model.index(name)] += x
    gain = found.evidence - at.promised
    return PredictedGain(proposal, gain, model, model.at(theta))
