# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The plain model, whose material alone is open: E, mu and damping; given effects stay."""

from __future__ import annotations

from dataclasses import replace

from dlo_ros.identification.estimate import SEARCH_STD
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import believed, material_priors
from dlo_ros.parameters import Settings


def material_model(start: Settings, given: Settings) -> ParametricModel:
    """The plain model, with priors about the parameter file's values.

    What was measured beforehand stays near its value, see `BELIEVED`.

    Args:
        start: values from where a fit begins.
        given: the parameter file.
    """
    model = believed(ParametricModel(start, material_priors(given)))
    return model.with_prior(
        [replace(p, std=SEARCH_STD[p.name]) for p in model.parameters if p.guessed]
    )
