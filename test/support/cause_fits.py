# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fits of which nothing is known but what the naming of causes asks for."""

from types import SimpleNamespace

import numpy as np

from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors
from dlo_ros.inference.thresholds import WORTH


def more_evidence(better, other):
    """For `tells_apart`: there are no residuals that evidence could come from by chance."""
    return better.posterior.evidence - other.posterior.evidence > WORTH


def evaluation(evidence, err):
    """A fit to one recording."""
    posterior = SimpleNamespace(evidence=evidence)
    return SimpleNamespace(posterior=posterior, mean_err=err, err=[np.full(9, err)])


def model_of(settings):
    """A model whose material is all that it has for parameters."""
    return ParametricModel(settings, material_priors(settings))
