# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The estimate with a set-up that may differ from the parameter file within its tolerances.

Nobody measures to a degree how a cable leaves its clamp, hangs a camera perfectly level or knows a
length to a tenth of a per cent, and shapes show such errors: left out of the model, they distort
E/mu. So two models are weighed by their evidence: the set-up exactly as stated, and every number of
it open within its tolerance. The estimate is that of the likelier one, the covariance that of both
(Hoeting et al., Bayesian model averaging: a tutorial, 1999). What the parameter file states with a
std is open in both.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import expit

from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import logarithms
from dlo_ros.identification.information import (
    determined_directions,
    diameter_error,
    model_shift,
    widened,
)
from dlo_ros.identification.offline.alternatives import Alternative, alternatives
from dlo_ros.identification.offline.drafts import drafts
from dlo_ros.identification.offline.initial_fit import Beginning, finer
from dlo_ros.identification.offline.without_own_error import without_own_error
from dlo_ros.inference.joint import Evaluation, evaluate, restricted
from dlo_ros.inference.joint_fit import ITERATIONS, best_settled, expected_gain, fit, next_step
from dlo_ros.inference.losses import CORRELATED, TO_REPORT
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.priors import joint_model, uncertain, with_tails
from dlo_ros.inference.scene import scene_of
from dlo_ros.inference.thresholds import NAMED, TRACKER_ERROR
from dlo_ros.inference.variances import posterior
from dlo_ros.inference.widened_covariance import widened_covariance
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

RIDGE = 1e-9
"""Information, in units of the likelier model's, that keeps what the other leaves open finite."""
EXACT = 1e12
"""Inverse variance of a number that is held."""
PER_DENSITY = np.array([[1, -1, 0, 0], [0, 1, 0, 0], [0, -1, 1, 0], [0, 0, 0, 1]])
"""Logarithms of E / mu, mu, c / mu and t_r from those of E, mu, c and t_r: shapes determine all of
these but mu."""


@dataclass(frozen=True)
class MaterialFit:
    """E, mu and damping as recordings determine them.

    Args:
        at: the likelier model, fitted to the recordings.
        recordings: the recordings without grossly wrong pictures, and what is compared of them.
        information: information of the data on ln (E, mu, c, t_r), shape (4, 4), averaged over both
            models.
        set_up: numbers of the set-up with standard deviations; empty where it is exact.
        error: the simulation's own error while the fit was looked for, root mean square distance
            [m]; NaN where it was not judged.
        left_out: number of pictures of each recording that are grossly wrong and left out.
        alternatives: effects that this material rather stands for; the information allows for them.
        diameter: standard deviation of the diameter over it, which the information allows for.
        converged: whether another step of the fit to shapes would move no number by its standard
            deviation.
    """

    at: Evaluation
    recordings: tuple[Recording, ...]
    information: FloatArray
    set_up: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    error: float = np.nan
    left_out: tuple[int, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    diameter: float = 0.0
    converged: bool = True

    @property
    def settings(self) -> Settings:
        """The settings with the fitted numbers, those of the set-up as effects."""
        return self.at.model.settings

    @property
    def theta(self) -> FloatArray:
        """Logarithms of (E, mu, c, t_r), shape (4,)."""
        return logarithms(self.settings)


def weighed(begun: Beginning, given: Settings) -> MaterialFit:
    """Weigh the set-up as stated against one that is open within its tolerances.

    Args:
        begun: the plain model's fit.
        given: the parameter file, whose values the priors lie around.
    """
    exact, recordings = begun.at, begun.recordings
    known = uncertain(given)
    report = partial(_reported, begun, stated={p.name for p in known})
    try:
        if known:
            model = replace(exact.model, parameters=(*exact.model.parameters, *known))
            exact = fit(evaluate(model, recordings), recordings, ITERATIONS)
        rough = drafts(recordings, exact)
        start = _open(exact, rough, given)
        stated = restricted(start, exact.model.names).evidence if start else np.inf
        if not start or restricted(start, start.model.names).evidence < stated - NAMED:
            return report(exact, recordings, alternatives(exact, recordings))
        at = best_settled(start, rough)
        others = alternatives(at, rough)
        probability = float(expit(at.posterior.evidence - stated))
        at = evaluate(at.model, recordings, at.variances)
        if probability <= 0.5:
            return report(exact, recordings, others, at, probability)
        sharper = finer(begun, at.model, {})
        if sharper is not None:
            recordings = sharper.recordings
            at = evaluate(at.model, recordings, at.variances)
        return report(at, recordings, others, exact, 1.0 - probability)
    except SimulationError as err:
        LOG.warning("the set-up is taken as exact: with it open the simulation fails (%s)", err)
        return report(begun.at, begun.recordings)


def _open(exact: Evaluation, recordings: Sequence[Recording], given: Settings) -> Evaluation | None:
    """The set-up open at its stated values; None where no number of it has a tolerance."""
    view = scene_of(exact.model.settings, recordings)
    model = with_tails(joint_model(exact.model.settings, given, view), given)
    if not any(p.effect for p in model.parameters):
        return None
    return evaluate(model, recordings, exact.variances)


def _reported(
    begun: Beginning, likelier: Evaluation, recordings: Sequence[Recording],
    others: Sequence[Alternative] = (), other: Evaluation | None = None, probability: float = 0.0,
    *, stated: Collection[str],
) -> MaterialFit:  # fmt: skip
    """The likelier of two models, fitted to its end without its simulation's error, and the
    information of both.

    Args:
        others: effects that the material rather stands for.
        probability: posterior probability of the other model.
        stated: names of what the parameter file states with a std.
    """
    at, compared = without_own_error(likelier, recordings)
    at = fit(at, compared, ITERATIONS, loss=TO_REPORT)
    information = _information(at, stated)
    if other is not None:
        apart = logarithms(at.model.settings) - logarithms(other.model.settings)
        apart = np.where(np.isfinite(apart), apart, 0.0)
        information = mixed(information, _information(other, stated), probability, apart)
    for a in others:
        information = widened(information, a.shift)
    spread = np.sqrt(np.diag(at.posterior.covariance))
    set_up = {
        p.name: (float(p.outer(float(x))), p.outer_std(float(x), float(std)))
        for p, x, std in zip(at.model.parameters, at.model.theta(), spread, strict=True)
        if p.effect
    }
    diameter = diameter_error(at.model.settings.rod, usual=_by_eye(at, stated))
    return MaterialFit(
        at,
        tuple(compared),
        information,
        set_up,
        begun.error,
        begun.left_out,
        tuple(others),
        diameter,
        expected_gain(at, CORRELATED) < CORRELATED.least_gain(at),
    )


def _information(at: Evaluation, stated: Collection[str] = ()) -> FloatArray:
    """Information of the data on the material, with possible errors of theory and diameter.

    What a fit has not reached is another possible error: the step that is expected to lead there.
    Where a model misses by more than any tracker errs, it is wrong: each std is as much larger.

    Args:
        stated: see `_reported`.
    """
    wrong = max(1.0, at.mean_err / (TRACKER_ERROR * at.model.settings.rod.length))
    data = marginal_information(at) / wrong**2
    known = widened(data, model_shift(at.model.settings, usual=_by_eye(at, stated)))
    return widened(known, at.model.of_material(next_step(at, CORRELATED), 0.0))


def _by_eye(at: Evaluation, stated: Collection[str]) -> bool:
    """Whether a number of the set-up is open whose tolerance nobody states."""
    return any(p.effect and p.name not in stated for p in at.model.parameters)


def marginal_information(at: Evaluation) -> FloatArray:
    """Information of the data on the material, the set-up open with its priors, shape (4, 4).

    It is less where recordings disagree by more than their errors explain.
    """
    information = at.model.on_material(CORRELATED.normal_equations(at)[0])
    # Shapes determine the ratio of E and mu alone: their disagreement on it shows with mu held.
    held, offset = at.model.precision(), at.model.offset()
    held[at.model.index("density")] = EXACT
    alike = posterior(at.spectra, at.variances, offset, held).covariance
    wide = widened_covariance(at.spectra, at.variances, offset, held)
    factor = at.model.of_material(np.sqrt(np.diag(wide) / np.diag(alike)), 1.0)
    factor[MATERIAL.index("density")] = factor[MATERIAL.index("young_modulus")]
    # A density that is open stays so: what shapes say of the others is said of them over it.
    back = np.linalg.inv(PER_DENSITY)
    known = back.T @ information @ back / np.outer(factor, factor)
    return np.asarray(PER_DENSITY.T @ known @ PER_DENSITY)


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
    # A direction with hardly any information is no exact one: without its share, the std along
    # the others would be too large.
    return np.asarray(likelier + back @ (np.linalg.inv(covariance) - np.diag(values)) @ back.T)
