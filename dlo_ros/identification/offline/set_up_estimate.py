# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The estimate with a set-up that may differ from the parameter file within its tolerances.

Nobody measures to a degree how a cable leaves its clamp, hangs a camera perfectly level or knows a
length to a tenth of a per cent, and shapes show such errors: left out of the model, they distort
E/mu. So two models are weighed by their evidence: the set-up exactly as stated, and every number of
it open within its tolerance. The estimate is that of the likelier one, the covariance that of both
(Hoeting et al., Bayesian model averaging: a tutorial, 1999).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import logarithms, with_logarithms
from dlo_ros.identification.offline.material_fit import seen
from dlo_ros.identification.residual_information import determined_directions, model_shifts, widened
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.joint import (
    Evaluation,
    borrowed,
    evaluate,
    rejudged,
    restricted,
    simulate,
)
from dlo_ros.inference.joint_fit import ITERATIONS, fit, settled
from dlo_ros.inference.losses import CORRELATED, TO_REPORT, WHITE, misfit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.priors import DIAMETER_STD, joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.thresholds import CLEARLY_LESS, NAMED, TRACKER_ERROR
from dlo_ros.inference.time_steps import sufficient_time_steps
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

VALLEYS = (0.2, 5.0)
"""Factors of E from which the open set-up is fitted, too, where more is left than a tracker errs:
on the right branch a set-up within its tolerances comes nearer."""
VALLEY_ITERATIONS = 8
RIDGE = 1e-9
"""Information, in units of the likelier model's, that keeps what the other leaves open finite."""


@dataclass(frozen=True)
class SetUp:
    """E, mu and damping, with the estimated numbers of the set-up.

    Args:
        theta: ln (E, mu, c, t_r) of the likelier model.
        information: information of the data on theta, shape (4, 4), averaged over both models.
        settings: settings of the likelier model, the numbers of the set-up as effects.
        values: numbers of the set-up with standard deviations; empty where it is exact.
    """

    theta: FloatArray
    information: FloatArray
    settings: Settings
    values: dict[str, tuple[float, float]]


def weighed(
    train: Sequence[Manipulation],
    settings: Settings,
    theta: FloatArray,
    information: FloatArray,
    ignored: Sequence[np.ndarray],
    spans: Sequence[int],
    given: Settings,
    shifts: Sequence[FloatArray] = (),
    long_steps: float | None = None,
) -> SetUp:
    """Weigh the set-up as stated against one that is open within its tolerances.

    Args:
        train: recordings.
        settings: settings of the fit with the stated set-up, with the tolerance that was needed.
        theta: ln (E, mu, c, t_r) of that fit.
        information: information of that fit, shape (4, 4).
        ignored: outlier pictures of each recording, shape (F,) each.
        spans: knot spans of each recording's simulation.
        given: the parameter file, whose values the priors lie around.
        shifts: shifts by which the simulation's own error may have moved theta, each (4,).
        long_steps: tolerance of the time steps with which a search may begin; None: that of the
            settings.
    """
    exact = SetUp(theta, information, settings, {})
    shortest = settings.simulation.tolerance
    recordings = [
        replace(seen(r, mask, settings), spans=s, tolerance=long_steps or shortest)
        for r, mask, s in zip(train, ignored, spans, strict=True)
    ]
    names = imposed_names(train)
    there = with_logarithms(settings, theta)
    model = joint_model(there, given, scene(there, names, [r.observed for r in recordings]))
    own = [p.name for p in model.parameters if not p.effect]
    if len(own) == len(model.parameters):
        return exact
    try:
        start = evaluate(model, recordings)
        stated = restricted(start, own).evidence
        if start.posterior.evidence < stated - NAMED:
            return exact
        at = _best_valley(settled(start, recordings), start, recordings)
        at = _finished(at, recordings, long_steps or shortest, shortest)
    except SimulationError as err:
        LOG.warning("the set-up is taken as exact: with it open the simulation fails (%s)", err)
        return exact
    probability = float(expit(at.posterior.evidence - stated))
    return _averaged(exact, at, probability, shifts)


def _best_valley(at: Evaluation, start: Evaluation, recordings: Sequence[Recording]) -> Evaluation:
    """The fit, or a better local minimum: far away a shape may lie on another branch."""
    if at.mean_err < TRACKER_ERROR * at.model.settings.rod.length:
        return at
    best = at
    for factor in VALLEYS:
        theta = start.model.theta()
        theta[start.model.index("young_modulus")] += np.log(factor)
        try:
            found = evaluate(start.model.at(theta), recordings)
            found = fit(found, recordings, VALLEY_ITERATIONS, loss=WHITE)
        except SimulationError as err:
            LOG.info("from %g times E: %s", factor, err)
            continue
        if misfit(found, best, WHITE) < CLEARLY_LESS * misfit(best, best, WHITE):
            best = settled(found, recordings)
    return best


def _finished(
    at: Evaluation, recordings: Sequence[Recording], longest: float, shortest: float
) -> Evaluation:
    """The fit with time steps that are short enough for what an open set-up leaves, to its end.

    Args:
        longest: tolerance of the time steps with which it was found.
        shortest: tolerance of the time steps below which none are needed.
    """

    def residuals(tolerance: float) -> Sequence[FloatArray]:
        steps = [replace(r, tolerance=tolerance) for r in recordings]
        return [r for r, _ in simulate(at.model, steps, ()).fields]

    if longest > shortest:
        found = max(sufficient_time_steps(residuals, [r for r, _ in at.fields]), shortest)
        if found < longest:
            recordings = [replace(r, tolerance=found) for r in recordings]
            at = rejudged(borrowed(at, at.model, recordings))
    return fit(at, recordings, ITERATIONS, loss=TO_REPORT)


def _averaged(
    exact: SetUp, at: Evaluation, probability: float, shifts: Sequence[FloatArray]
) -> SetUp:
    """The likelier of two models, and the covariance with both."""
    model, settings = at.model, at.model.settings
    theta, information = logarithms(settings), marginal_information(at)
    place = [MATERIAL.index(p.name) for p in model.parameters if not p.effect]
    rough = 0.0 if settings.rod.diameter_std else 2.0 * DIAMETER_STD
    young_modulus = np.eye(len(MATERIAL))[MATERIAL.index("young_modulus")]
    for shift in (*shifts, *model_shifts(settings, len(MATERIAL)), rough * young_modulus):
        information = widened(information, shift)
    apart = np.zeros(len(theta))
    apart[place] = theta[place] - exact.theta[place]
    if probability <= 0.5:
        information = mixed(exact.information, information, probability, apart)
        return replace(exact, information=information)
    information = mixed(information, exact.information, 1.0 - probability, apart)
    spread = np.sqrt(np.diag(at.posterior.covariance))
    found = {
        p.name: (float(p.outer(float(x))), p.outer_std(float(x), float(std)))
        for p, x, std in zip(model.parameters, model.theta(), spread, strict=True)
        if p.effect
    }
    return SetUp(theta, information, settings, found)


def marginal_information(at: Evaluation) -> FloatArray:
    """Information of the data on the material, the set-up open with its priors, shape (4, 4)."""
    return at.model.on_material(CORRELATED.normal_equations(at)[0])


def mixed(
    likelier: FloatArray, other: FloatArray, probability: float, apart: FloatArray
) -> FloatArray:
    """Information of a mixture of two models about the mean of the likelier.

    Args:
        likelier, other: information of the two models, shape (P, P); what the likelier one leaves
            open stays so.
        probability: posterior probability of the other model.
        apart: difference of the two models' means, shape (P,).
    """
    scale, values, basis = determined_directions(likelier)
    theirs = basis.T @ (other * np.outer(scale, scale)) @ basis + RIDGE * np.eye(basis.shape[1])
    off = basis.T @ (apart / scale)
    covariance = (1.0 - probability) * np.diag(1.0 / values)
    covariance += probability * (np.linalg.inv(theirs) + np.outer(off, off))
    back = basis / scale[:, None]
    return np.asarray(back @ np.linalg.inv(covariance) @ back.T)
