# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Standard deviations confirmed by simulation, where a linearised model may understate them.

A parameter that moves alone, by the std that it would have with all others known, lowers the log
posterior by one half. Where a motion is unstable, or sticks and slips, the derivatives at one point
may be far larger than any change that the parameter really makes, and it does not; a std taken from
them is too small.

By how much is not known: with all others free it is mostly what other derivatives tell that limits
a parameter. What has been seen is a fit without the cause. A cause of a size known no better than
that would be missed less.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.explain.peg_size import PEG, peg_factors
from dlo_ros.diagnosis.explain.turned_walls import WALL
from dlo_ros.diagnosis.findings.wall_direction import wall_factors
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, borrowed
from dlo_ros.inference.losses import misfit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import MUCH_LARGER
from dlo_ros.spline import FloatArray

LONGEST = 256.0
"""Largest distance that is tried, in std."""


@dataclass(frozen=True)
class Widening:
    """Factors, at least 1, by which standard deviations must grow.

    Args:
        parameters: name of a parameter and its factor; of others none is known.
        material: that of ln(E / mu), which serves for E and mu, too.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    material: float = 1.0


def confirmed(
    at: Evaluation, recordings: Sequence[Recording], causes: Sequence[Cause]
) -> Widening:  # fmt: skip
    """The factors of the parameters of some causes and of the material.

    Args:
        at: a fit; where it is not one to these recordings, nothing can be confirmed.
        causes: the causes; parameters that the model does not contain have no factor.
    """
    if len(at.err) != len(recordings):
        return Widening()
    ratio = at.model.axis("young_modulus") - at.model.axis("density")
    factors: dict[str, float] = {}
    for cause in causes:
        names, most = [n for n in cause.names if n in at.model.names], _largest(at, cause)
        for n in names:
            wider = factor_along(at, recordings, at.model.axis(n)) if most > 1.0 else 1.0
            factors[n] = min(wider, most)
    for hit, factors_of in ((WALL, wall_factors), (PEG, peg_factors)):
        of_it = factors_of(at, recordings) if set(hit) & set(factors) else {}
        factors |= {n: max(factor, factors.get(n, 1.0)) for n, factor in of_it.items()}
    return Widening(factors, factor_along(at, recordings, ratio))


def _largest(at: Evaluation, cause: Cause) -> float:
    """The factor with which a cause would be missed as little as it was; infinite where neutral is
    not where its parameters' priors lie.
    """
    if cause.evidence <= 0.0:
        return math.inf
    k = [at.model.index(n) for n in cause.names if n in at.model.names]
    known = [at.model.parameters[j] for j in k]
    if not known or not all(p.tolerated or p.guessed for p in known):
        return math.inf
    off = at.model.offset()[k]
    expected = float(off @ np.linalg.solve(at.posterior.covariance[np.ix_(k, k)], off)) / 2.0
    return max(1.0, math.sqrt(expected / cause.evidence))


def factor_along(at: Evaluation, recordings: Sequence[Recording], weights: FloatArray) -> float:
    """Factor, at least 1, by which the std of parameters that move together must grow.

    It grows where it is much too small: less may be an accident of the simulation's steps. The
    distances that are tried grow by the square of that.

    Args:
        weights: direction of their move, shape (P,).
    """
    information = np.linalg.inv(at.posterior.covariance)
    step = weights / np.sqrt(float(weights @ information @ weights))
    distance = 1.0
    while distance <= LONGEST:
        loss = _loss(at, recordings, distance * step)
        if loss is None:
            break
        shorter = np.sqrt(2.0 * max(loss, 0.0))  # the distance that loses as much, in std
        if shorter >= 1.0 / MUCH_LARGER:
            return max(1.0, distance / float(shorter))
        distance *= MUCH_LARGER**2
    return max(1.0, distance / MUCH_LARGER**2)


def _loss(at: Evaluation, recordings: Sequence[Recording], step: FloatArray) -> float | None:
    """Mean loss of log posterior a step either way; None where it cannot be simulated."""
    here, losses = misfit(at, at), []
    for side in (1.0, -1.0):
        model = at.model.at(at.model.theta() + side * step)
        if not np.allclose(model.theta() - at.model.theta(), side * step):
            continue  # a bound of a parameter lies nearer
        try:
            losses.append(misfit(borrowed(at, model, recordings), at) - here)
        except SimulationError:
            return None
    return float(np.mean(losses)) if losses else None
