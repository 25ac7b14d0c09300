# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A flat section in the form in which E is that of its soft axis.

A section with B about one axis and r times B about the other is one with r B and 1 / r: a fit finds
the form from which it began. They differ in how much the DLO stretches alone.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace

from dlo_ros.effects.physics.anisotropy import Anisotropy
from dlo_ros.effects.physics.twisting_stiffness import TwistingStiffness
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, evaluate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel, value_of, with_values
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

RATIO, ANGLE = (Anisotropy.parameter(key) for key in ("ratio", "angle"))
TWIST = TwistingStiffness.parameter("ratio")


def with_soft_axis(at: Evaluation, recordings: Sequence[Recording], given: Settings) -> Evaluation:
    """The evaluation of the same rod with E of the axis about which it bends more easily.

    Args:
        recordings: those that it was fitted to.
        given: the parameter file; the form of a section that it states stays, and so does one whose
            other form a search for the first equilibrium does not find.
    """
    model = at.model
    found = RATIO in model.names and Anisotropy.name not in given.effects
    if not found or value_of(model.settings, RATIO) >= 1.0:
        return at
    turned = ParametricModel(about_other_axis(model.settings), model.parameters)
    try:
        return evaluate(turned, recordings, at.variances)
    except SimulationError as err:
        LOG.info("with E of the other axis: %s", err)
        return at


def about_other_axis(settings: Settings) -> Settings:
    """Settings of a flat section with E that of the other axis: the same rod."""
    ratio, angle = (value_of(settings, name) for name in (RATIO, ANGLE))
    effects = {k: dict(v) for k, v in settings.effects.items()}
    effects.setdefault(TwistingStiffness.name, {"ratio": 1.0})
    rod = replace(settings.rod, young_modulus=ratio * settings.rod.young_modulus)
    settings = replace(settings, effects=effects, rod=rod)
    # Torsion is that of a round section with E, times this.
    values = {
        TWIST: value_of(settings, TWIST) / ratio, RATIO: 1.0 / ratio,
        ANGLE: angle - math.copysign(0.5 * math.pi, angle),
    }  # fmt: skip
    return with_values(settings, values)
