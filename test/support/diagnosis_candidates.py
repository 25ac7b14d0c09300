# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Candidates of a diagnosis that nobody has simulated, to try what is decided of them."""

from dataclasses import replace

import numpy as np
from rods import PAPER

from dlo_ros.diagnosis.fitting.candidate_model import baseline
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation
from dlo_ros.diagnosis.selection.effect_search import Candidate

KNOWN = replace(
    PAPER,
    rod=replace(PAPER.rod, density_std=20.0),
    damping=replace(PAPER.damping, air_drag_std=1e-4, relaxation_time_std=1e-4),
)


def evaluation(residuals, jacobians=None):
    """Residuals as if a simulation had left them."""
    power = sum(float(np.sum(r**2)) for r in residuals)
    model = baseline(KNOWN)
    parameters = len(model.free)
    if jacobians is None:
        jacobians = [np.zeros((len(r), parameters, r.shape[1])) for r in residuals]
    empty = tuple(np.zeros((len(r), 4, 4)) for r in residuals)
    err = tuple(np.zeros(len(r)) for r in residuals)
    return CandidateEvaluation(model, tuple(residuals), tuple(jacobians), power, power, empty, err)


def candidate(names, root_autocovariance, score, residuals, err=1e-3):
    """A candidate with effects, whose residuals are correlated, with ERR [m] in every picture."""
    at = evaluation(residuals)
    at = replace(at, err=tuple(np.full(len(r), err) for r in residuals))
    settings = KNOWN.with_effects({n: {} for n in names})
    at = replace(at, model=replace(at.model, settings=settings))
    return Candidate("+".join(names), "", at, score, root_autocovariance)
