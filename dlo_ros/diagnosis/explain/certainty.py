# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters that the data put away from neutral for certain, or beyond their tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, freed
from dlo_ros.effects import quantities
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.parameter import Parameter, split_name
from dlo_ros.inference.priors import SLAB

CERTAIN = 3.0
"""Standard deviations from neutral, from which a cause is named."""
SCALES = ("young_modulus", "density")
"""Parameters to which the size of a cause is proportional: their uncertainty makes its presence no
less certain. A force on a DLO that was not weighed is known as a share of the weight, a
mass on one of unknown stiffness likewise."""
BEYOND = 2.0
"""Tolerances from neutral, from which a number of the set-up may be a cause."""
NOTABLE = 0.2
"""Tolerances from neutral, from which a number of the set-up is off by more than two programs that
simulate the same DLO differ by."""


def beyond(at: Evaluation) -> list[Proposal]:
    """Groups of the set-up with a number far beyond its tolerance, or beyond it for certain."""
    return [
        replace(g, parameters=tuple(p for p in at.model.parameters if p.name in g.columns))
        for g in freed(at.model)
        if is_beyond(at, g) or _beyond_for_certain(at, g)
    ]


def _beyond_for_certain(at: Evaluation, group: Proposal) -> bool:
    """Whether a size lies more than one tolerance off, and its uncertainty farther than that.

    A damping that is only guessed has no tolerance.
    """
    tolerated = group.from_nothing and all(p.effect for p in group.parameters)
    return tolerated and any(off > 1.0 + CERTAIN * std for off, std in _sizes(at, group))


def is_beyond(at: Evaluation, group: Proposal, tolerances: float = BEYOND) -> bool:
    """Whether a size of a group, with the priors of a cause, lies so many tolerances off."""
    return group.from_nothing and tolerances_off(at, group) > tolerances


def strains(bare: Evaluation, at: Evaluation) -> bool:
    """Whether the set-up lies beyond its tolerance without a cause, and not with it.

    Args:
        bare: the fit without the cause.
        at: the fit with it.
    """
    return any(
        is_beyond(bare, g) and tolerances_off(bare, g) > tolerances_off(at, g) + BEYOND
        for g in freed(bare.model)
    )


def tolerances_off(at: Evaluation, group: Proposal) -> float:
    """Distance from neutral of the size of a group that is farthest off, in tolerances.

    Args:
        group: group with the priors of a cause.
    """
    return max((off for off, _ in _sizes(at, group)), default=0.0)


def _sizes(at: Evaluation, group: Proposal) -> list[tuple[float, float]]:
    """Distance from neutral and standard deviation of each size of a group, in tolerances."""
    off = dict(zip(at.model.names, np.abs(at.model.offset()), strict=True))
    std = dict(zip(at.model.names, np.sqrt(np.diag(at.posterior.covariance)), strict=True))
    sizes = [p for p in group.parameters if p.name in off and not _geometric(p)]
    return [(SLAB * off[p.name] / p.std, SLAB * std[p.name] / p.std) for p in sizes]


def _geometric(p: Parameter) -> bool:
    """Whether a parameter is a place, of which none is neutral."""
    return bool(p.effect) and quantities(p.effect)[split_name(p.name)[1]].geometric


def certain(at: Evaluation, group: Proposal, held: Sequence[str] = ()) -> bool:
    """Whether a group is away from neutral by more than its uncertainty (Wald).

    Args:
        held: parameters of which what is not known does not count.
    """
    linear = [n for n in group.columns if n in at.model.names]
    if not linear or not group.from_nothing:
        return group.start is not None
    k = [at.model.index(n) for n in linear]
    off = at.model.offset()[k]
    h = [at.model.index(n) for n in held if n in at.model.names]
    # With some parameters held, the rest of the inverse covariance stays as it is.
    covariance = at.posterior.covariance[np.ix_([*k, *h], [*k, *h])]
    information = np.linalg.inv(covariance)[: len(k), : len(k)]
    return float(off @ information @ off) > CERTAIN**2 * len(k)


def departures(at: Evaluation, causes: Sequence[Proposal] = ()) -> int:
    """Number of causes and notable parts of the set-up that are away from neutral for certain.

    Args:
        at: the joint model.
        causes: causes that have been added to the model or freed.
    """
    acting = [c for c in causes if c.start is not None]
    tolerated = replace(
        at.model,
        parameters=tuple(replace(p, tolerated=bool(p.effect)) for p in at.model.parameters),
    )
    own = {p.name for c in acting for p in c.parameters}
    parts = [g for g in freed(tolerated) if g.parameters[0].effect and not own & set(g.columns)]
    return len(acting) + sum(certain(at, g) and is_beyond(at, g, NOTABLE) for g in parts)
