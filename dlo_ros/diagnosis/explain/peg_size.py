# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The size of a peg, of which a DLO that touches it in one point shows little.

Pegs of other sizes that touch the DLO in the same point nearly explain the same. Simulations of an
impact are rough, so that a fit stops at the size with which it began, and no derivative tells how
well that is known: other sizes are fitted.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.contact.peg_places import true_points
from dlo_ros.diagnosis.explain.profile_loss import fitted_beside, refitted_loss
from dlo_ros.diagnosis.explain.trials import FIT_ITERATIONS
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import HELD, ParametricModel, value_of
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

PEG = X, Z, RADIUS = tuple(Obstacle.parameter(key) for key in ("x", "z", "radius"))
STEPS = (2.0, 2.0**0.5)
"""Factors by which a size is changed either way as long as that explains more, one after the
other."""
THINNEST = 0.25
"""Smallest radius that is tried, in diameters of the DLO: a thinner peg touches it no otherwise."""
SCALES = (4.0, 2.0)
"""Factors by which a size is changed either way, to see how well it is known."""
PLACES = 50
"""Places along the DLO at which it may touch."""


def best_sized(at: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """A fit with the size of its peg that explains most, which is held.

    With a size that is open evidence is that of derivatives of an impact, and means little.

    Args:
        at: a fit to the recordings; it stays as it is where there is no peg.
    """
    if not set(PEG) <= set(at.model.names):
        return at
    best = fitted_beside(at, resized(at, 1.0), recordings)
    if best is None:
        return at
    for step in STEPS:
        larger = _resized_while_better(best, step, recordings)
        best = larger or _resized_while_better(best, 1.0 / step, recordings) or best
    LOG.info("the peg is %.3g times as large", _radius(best.model) / _radius(at.model))
    return fit(best, recordings, FIT_ITERATIONS)


def _resized_while_better(
    at: Evaluation, factor: float, recordings: Sequence[Recording]
) -> Evaluation | None:
    """A fit with a peg whose size is changed by a factor as long as that explains more; None where
    it never does.
    """
    best = None
    while True:
        here = best or at
        other = fitted_beside(here, resized(here, factor), recordings)
        if other is None or other.posterior.evidence <= here.posterior.evidence:
            return best
        best = other


def peg_factors(at: Evaluation, recordings: Sequence[Recording]) -> dict[str, float]:
    """Factors, at least 1, by which the std of a peg's numbers must grow; none without a peg.

    A peg is known as far as others explain less that touch the same point, its place no better.

    Args:
        at: a fit; where it is not one to these recordings, nothing is told.
    """
    if not set(PEG) <= set(at.model.names) or len(at.err) != len(recordings):
        return {}
    tried = {size: resized(at, size) for scale in SCALES for size in (1.0 / scale, scale)}
    # A peg as large as one is looked for has no larger one beside it, which would do as well.
    k = at.model.index(RADIUS)
    models = {s: m for s, m in tried.items() if not np.isclose(m.theta()[k], at.model.theta()[k])}
    refits = {size: refitted_loss(at, model, recordings) for size, model in models.items()}
    least = min(0.0, *(r.loss for r in refits.values()))  # beside an impact none may be the best
    for scale in SCALES:
        sizes = models.keys() & {1.0 / scale, scale}
        size = min(sizes, key=lambda size: refits[size].loss)
        if refits[size].does_as_well(least):
            break
    moves = np.abs(models[size].theta() - at.model.theta())
    far = moves / refits[size].stds_away(least) / np.sqrt(np.diag(at.posterior.covariance))
    return {name: max(1.0, float(far[at.model.index(name)])) for name in PEG}


def resized(at: Evaluation, size: float) -> ParametricModel:
    """The model with a peg of another size, which is held, in touch with the same point of the DLO.

    Args:
        size: radius over that of the model's peg.
    """
    model, radius = at.model, _radius(at.model)
    centre = np.array([value_of(model.settings, name) for name in (X, Z)])
    away = curves(at) - centre
    nearest = away[np.argmin(np.sum(away**2, axis=1))]
    outwards = nearest / np.linalg.norm(nearest)
    k = model.index(RADIUS)
    p, theta = model.parameters[k], model.theta()
    thinnest = min(radius, THINNEST * model.settings.rod.diameter)
    resized_to = p.outer(p.inner(max(size * radius, thinnest)))  # within its range
    theta[k] = p.inner(resized_to)
    there = centre + (radius - resized_to) * outwards
    for name, value in zip((X, Z), there, strict=True):
        theta[model.index(name)] = value
    held = replace(p, centre=float(theta[k]), std=HELD)
    return model.at(theta).with_prior([held])


def curves(at: Evaluation) -> FloatArray:
    """True points x, z of all predicted shapes [m], shape (K, 2)."""
    settings = at.model.settings
    points = true_points(settings, at.predicted, np.linspace(0.0, settings.rod.length, PLACES))
    return np.concatenate([p.reshape(-1, 2) for p in points])


def _radius(model: ParametricModel) -> float:
    """Radius of the peg [m]."""
    return value_of(model.settings, RADIUS)
