# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters that the data put away from neutral for certain, or beyond their tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, freed
from dlo_ros.effects import Quantity, effects, quantities
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.parameter import SLAB, Parameter, ParametricModel, split_name
from dlo_ros.inference.thresholds import BEYOND, CERTAIN, NOTABLE, UNDERSTATED
from dlo_ros.inference.widened_covariance import widened_covariance
from dlo_ros.spline import FloatArray

SCALES = ("young_modulus", "density")
"""Parameters to which the size of a cause is proportional: their uncertainty makes its presence no
less certain. A force on a DLO that was not weighed is known as a share of the weight, a
mass on one of unknown stiffness likewise."""


def beyond(at: Evaluation, covariance: FloatArray | None = None) -> list[Proposal]:
    """Groups of the set-up with a number far beyond its tolerance, or beyond it for certain.

    Args:
        covariance: of all parameters, shape (P, P); None: that of the fit.
    """
    spread = at.posterior.covariance if covariance is None else covariance
    return [
        _own(at, g)
        for g in freed(at.model)
        if is_beyond(at, g) or beyond_for_certain(at, g, spread)
    ]


def beyond_for_certain(at: Evaluation, group: Proposal, covariance: FloatArray) -> bool:
    """Whether a size lies more than one tolerance off, by more than its uncertainty.

    Laws that are not the true ones shift every number in proportion to its standard deviation
    (`UNDERSTATED`), and it must lie that much farther off.

    A damping that is only guessed is such a size where there is more of it: something damps the
    DLO then. Less of it is a guess that was too high, and a little more (`NOTABLE`) what a damping
    takes up of another law.

    Args:
        group: group with the priors of a cause.
        covariance: of all parameters, shape (P, P).
    """
    offset = at.model.offset()
    guessed = [p.name for p in group.parameters if p.guessed]
    less = any(offset[at.model.index(name)] > 0.0 for name in guessed)
    farthest = 1.0 + (NOTABLE if guessed else 0.0)
    sizes = _sizes(at, group, covariance)
    return (
        group.from_nothing
        and not less
        and any(off > farthest + UNDERSTATED * CERTAIN * std for off, std in sizes)
    )


def is_beyond(at: Evaluation, group: Proposal, tolerances: float = BEYOND) -> bool:
    """Whether a size of a group, with the priors of a cause, lies so many tolerances off."""
    return group.from_nothing and tolerances_off(at, group) > tolerances


def far_off(at: Evaluation) -> list[Proposal]:
    """Groups of the set-up with a size more than `BEYOND` tolerances off."""
    return [g for g in freed(at.model) if is_beyond(at, g)]


def strained(bare: Evaluation, at: Evaluation) -> list[Proposal]:
    """Groups of the set-up that lie beyond their tolerance without a cause, and not with it.

    Args:
        bare: the fit without the cause.
        at: the fit with it.
    """
    return [
        g for g in freed(bare.model)
        if is_beyond(bare, g) and tolerances_off(bare, g) > tolerances_off(at, g) + BEYOND
    ]  # fmt: skip


def has_other_stiffness(model: ParametricModel, at: Evaluation, stds: float) -> bool:
    """Whether E / mu of another model is not that of a fit, by more than some standard deviations.

    Args:
        model: the other model.
        at: the fit.
        stds: standard deviations of ln(E / mu) in the fit.
    """
    return _stiffness_stds(model, at, at.posterior.covariance) > stds


def has_certainly_other_stiffness(model: ParametricModel, at: Evaluation) -> bool:
    """Whether E / mu of another model is not that of a fit, however much the recordings disagree.

    A model whose laws are not the true ones fits each recording with another E / mu.
    """
    offset, precision = at.model.offset(), at.model.precision()
    spread = widened_covariance(at.spectra, at.variances, offset, precision)
    return _stiffness_stds(model, at, spread) > CERTAIN


def _stiffness_stds(model: ParametricModel, at: Evaluation, covariance: FloatArray) -> float:
    """Distance of ln(E / mu) of another model from that of a fit, in standard deviations."""
    axis = at.model.axis("young_modulus") - at.model.axis("density")
    ratio = model.settings.rod.specific_modulus / at.model.settings.rod.specific_modulus
    return abs(float(np.log(ratio))) / float(np.sqrt(axis @ covariance @ axis))


def tolerances_off(at: Evaluation, group: Proposal) -> float:
    """Distance from neutral of the size of a group that is farthest off, in tolerances.

    Args:
        group: group with the priors of a cause.
    """
    return max((off for off, _ in _sizes(at, group, at.posterior.covariance)), default=0.0)


def _sizes(
    at: Evaluation, group: Proposal, covariance: FloatArray
) -> list[tuple[float, float]]:  # fmt: skip
    """Distance from neutral and standard deviation of each size of a group, in tolerances."""
    off = dict(zip(at.model.names, np.abs(at.model.offset()), strict=True))
    std = dict(zip(at.model.names, np.sqrt(np.diag(covariance)), strict=True))
    sizes = [p for p in group.parameters if p.name in off and not _geometric(p)]
    return [(SLAB * off[p.name] / p.std, SLAB * std[p.name] / p.std) for p in sizes]


def _geometric(p: Parameter) -> bool:
    """Whether a parameter is a place, of which none is neutral."""
    return bool(p.effect) and _quantity(p).geometric


def _quantity(p: Parameter) -> Quantity:
    """The quantity of an effect that a parameter is."""
    return quantities(p.effect)[split_name(p.name)[1]]


def certain(
    at: Evaluation, group: Proposal, held: Sequence[str] = (), covariance: FloatArray | None = None
) -> bool:
    """Whether a group is away from neutral by more than its uncertainty (Wald).

    Where neutral is a limit of the range, and so infinitely far for a logarithm, a size must be
    known to a factor.

    Args:
        held: parameters of which what is not known does not count.
        covariance: of all parameters, shape (P, P); None: that of the fit.
    """
    spread = at.posterior.covariance if covariance is None else covariance
    h = [at.model.index(n) for n in held if n in at.model.names]

    def information(k: list[int], also: Sequence[int] = ()) -> FloatArray:
        # With some parameters held, the rest of the inverse covariance stays as it is.
        each = [*k, *h, *also]
        return np.asarray(np.linalg.inv(spread[np.ix_(each, each)])[: len(k), : len(k)])

    k = [at.model.index(n) for n in group.columns or _numbers(group) if n in at.model.names]
    if not k:
        return group.start is not None
    if group.from_nothing:
        off = at.model.offset()[k]
        return float(off @ information(k) @ off) > CERTAIN**2 * len(k)
    # At neutral a strength does nothing, whatever the effect's scales are: their values count.
    strengths = [j for j in k if _quantity(at.model.parameters[j]).is_strength]
    scales = [j for j in k if j not in strengths]
    known = [
        _from_neutral(at, j) ** 2 * float(information([j], scales)[0, 0]) for j in strengths
    ]  # fmt: skip
    return group.start is not None and max(known, default=0.0) > CERTAIN**2


def _numbers(group: Proposal) -> list[str]:
    """Sizes and extents of a group that has no derivative where it begins; none of what is hit.

    How large a peg is, is next to nothing of what it does.
    """
    if not effects()[group.effect].differentiable:
        return []
    keys = quantities(group.effect)
    return [p.name for p in group.parameters if keys[split_name(p.name)[1]].role != "place"]


def _from_neutral(at: Evaluation, index: int) -> float:
    """Distance of an effect's size from neutral, as the fit sees it; 1 where neutral is a limit
    that the logarithm does not reach.
    """
    p = at.model.parameters[index]
    q = _quantity(p)
    if p.logarithmic and not q.lower < q.neutral < q.upper:
        return 1.0
    return float(at.model.theta()[index]) - p.inner(q.neutral)


def departures(at: Evaluation, causes: Sequence[Proposal] = ()) -> int:
    """Number of causes and notable parts of the set-up that are away from neutral for certain.

    Args:
        at: the joint model.
        causes: causes that have been added to the model or freed.
    """
    return sum(c.start is not None for c in causes) + len(_departing(at, causes))


def _departing(at: Evaluation, causes: Sequence[Proposal]) -> list[Proposal]:
    """Notable parts of the set-up that are away from neutral for certain, those freed, too."""
    model = at.model.with_prior(
        [p.returned(SLAB) for p in at.model.parameters if p.effect and not p.tolerated]
    )
    own = {p.name for c in causes if c.start is not None for p in c.parameters}
    parts = [g for g in freed(model) if g.parameters[0].effect and not own & set(g.columns)]
    return [g for g in parts if certain(at, g) and is_beyond(at, g, NOTABLE)]


def _own(at: Evaluation, group: Proposal) -> Proposal:
    """A group with the model's own priors."""
    own = tuple(p for p in at.model.parameters if p.name in group.columns)
    return replace(group, parameters=own)
