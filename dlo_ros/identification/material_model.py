# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The plain model, whose material alone is open: E, mu and damping; given effects stay."""

from __future__ import annotations

from dataclasses import replace

from dlo_ros.identification.estimate import SEARCH_STD
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.priors import believed, material_priors
from dlo_ros.parameters import Settings


def material_model(start: Settings, given: Settings) -> ParametricModel:
    """The plain model, with priors about the parameter file's values.

    What was measured beforehand stays near its value: a fit that pushes it further does the work of
    a cause that nobody names.

    Args:
        start: values from where a fit begins.
        given: the parameter file.
    """
    return ParametricModel(start, tuple(map(_sought, material_priors(given))))


def _sought(p: Parameter) -> Parameter:
    """A parameter as a fit of the material alone looks for it."""
    if p.guessed:
        return replace(p, std=SEARCH_STD[p.name])
    lower, upper = believed(p)
    return replace(p, lower=lower, upper=upper)
