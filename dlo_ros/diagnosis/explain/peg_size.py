# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The size of a peg, of which a DLO that touches it in one point shows little.

Pegs of other sizes that touch the DLO in the same point nearly explain the same. Simulations of an
impact are rough, so that a fit stops at the size with which it began, and no derivative tells how
well that is known: other sizes are fitted.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis.explain.candidate_trials import fitted
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.losses import misfit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel, value_of
from dlo_ros.inference.thresholds import WORTH
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

PEG = X, Z, RADIUS = tuple(Obstacle.parameter(key) for key in ("x", "z", "radius"))
SIZES = (0.25, 0.5, 2.0)
"""Sizes that are fitted instead, over that of a fit: the largest peg that explains the data comes
nearest to what is known before the impact, so that fits tend to be too large."""
SCALES = (4.0, 2.0)
"""Factors by which a size is changed either way, to see how well it is known."""
LEAST_LOSS = 0.5
"""Log posterior that one std costs."""
PLACES = 50
"""Places along the DLO at which it may touch."""


def best_sized(at: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """A fit with the size of its peg that explains most; the fit itself where there is no peg.

    Args:
        at: a fit to the recordings.
    """
    if not set(PEG) <= set(at.model.names):
        return at
    tried = [fitted(resized(at, size), recordings) for size in SIZES]
    best = max([at, *(e for e in tried if e)], key=lambda e: e.posterior.evidence)
    if best is at:
        return at
    found = fitted(best.model.with_prior(at.model.parameters), recordings)
    if found is None or found.posterior.evidence < at.posterior.evidence + WORTH:
        return at
    LOG.info("the peg is %.3g times as large", _radius(found.model) / _radius(at.model))
    return found


def peg_factors(at: Evaluation, recordings: Sequence[Recording]) -> dict[str, float]:
    """Factors, at least 1, by which the std of a peg's numbers must grow; none without a peg.

    A peg that explains the data as well with another size is known no better than that, its place
    neither.

    Args:
        at: a fit; where it is not one to these recordings, nothing is told.
    """
    if not set(PEG) <= set(at.model.names) or len(at.err) != len(recordings):
        return {}
    for scale in SCALES:
        models = [resized(at, size) for size in (1.0 / scale, scale)]
        losses = [_loss(at, model, recordings) for model in models]
        loss = min(losses)
        if loss < WORTH:
            moves = np.abs(models[losses.index(loss)].theta() - at.model.theta())
            std = np.sqrt(np.diag(at.posterior.covariance))
            far = moves / np.sqrt(2.0 * max(loss, LEAST_LOSS)) / std
            return {name: max(1.0, float(far[at.model.index(name)])) for name in PEG}
    return {}


def _loss(at: Evaluation, model: ParametricModel, recordings: Sequence[Recording]) -> float:
    """Loss of log posterior with a model whose peg keeps its size, all else fitted anew."""
    found = fitted(model, recordings)
    return np.inf if found is None else misfit(found, at) - misfit(at, at)


def resized(at: Evaluation, size: float) -> ParametricModel:
    """The model with a peg of another size, which is held, in touch with the same point of the DLO.

    Args:
        size: radius over that of the model's peg.
    """
    model, radius = at.model, _radius(at.model)
    centre = np.array([value_of(model.settings, name) for name in (X, Z)])
    away = _curves(at) - centre
    nearest = away[np.argmin(np.sum(away**2, axis=1))]
    outwards = nearest / np.linalg.norm(nearest)
    k = model.index(RADIUS)
    theta = model.theta()
    theta[k] = model.parameters[k].inner(model.parameters[k].outer(theta[k] + np.log(size)))
    there = centre + (radius - model.parameters[k].outer(theta[k])) * outwards
    for name, value in zip((X, Z), there, strict=True):
        theta[model.index(name)] = value
    return model.at(theta).with_prior([model.parameters[k].held(float(theta[k]))])


def _curves(at: Evaluation) -> FloatArray:
    """Points x, z of all predicted shapes [m], shape (K, 2)."""
    rod = at.model.settings.rod
    basis = SplineBasis(rod.control_points, rod.length)
    matrix = basis.matrix(np.linspace(0.0, rod.length, PLACES), 0)
    return np.concatenate([(matrix @ p[..., [0, 2]]).reshape(-1, 2) for p in at.predicted])


def _radius(model: ParametricModel) -> float:
    """Radius of the peg [m]."""
    return value_of(model.settings, RADIUS)
