# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that an identified plain DLO may stand for, with another Young's modulus.

`identify` looks for no causes. But where a DLO creeps, the E that it finds is that of slow motion,
several times too small at a small standard deviation, beside a damping that nobody has guessed; and
where its strands rub on each other, that of small bends, half as large again. So such an effect is
fitted in place of the plain DLO; where the recordings prefer it, what it would change is not known.
Where they do not, the plain DLO stays: a creep that is over at once is a damping.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.effects import quantities, starts
from dlo_ros.effects.start import Block
from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import logarithms
from dlo_ros.inference.joint import Evaluation, evaluate
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import certain_gain, log_bayes_factor
from dlo_ros.inference.plain_rod import instead_of_plain
from dlo_ros.inference.scene import scene_of
from dlo_ros.inference.thresholds import NAMED
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

ITERATIONS = 12


@dataclass(frozen=True)
class Alternative:
    """An effect with which another material explains the recordings better.

    Args:
        effect: name of the effect.
        values: its values by key.
        specific_modulus: E / mu beside it [m^2/s^2].
        shift: change of ln (E, mu, c, t_r), shape (4,).
    """

    effect: str
    values: Block
    specific_modulus: float
    shift: FloatArray


def alternatives(at: Evaluation, recordings: Sequence[Recording]) -> tuple[Alternative, ...]:
    """Effects that the material of a fit rather stands for.

    As for a cause that `diagnose` names, the recordings must speak for one of K that are tried by
    `NAMED`, and by ln K more.

    Args:
        at: the fit of the plain DLO with its set-up.
    """
    settings = at.model.settings
    absent = [s for s in starts(scene_of(settings, recordings)) if s.effect not in settings.effects]
    found: list[tuple[float, Alternative]] = []
    begun = instead_of_plain(at.model, absent)
    for start, model in begun:
        try:
            other = fit(evaluate(model, recordings), recordings, ITERATIONS, draft=True)
        except SimulationError as err:
            LOG.info("%s: %s", start.effect, err)
            continue
        gain = log_bayes_factor(other, at)
        LOG.info("%s, instead of a plain DLO: %+.1f", start.effect, gain)
        there = other.model.settings
        if gain < certain_gain(len(begun)) or _does_nothing(start.effect, there):
            continue
        shift = np.nan_to_num(logarithms(there) - logarithms(settings), posinf=0.0, neginf=0.0)
        values = there.effects[start.effect]
        modulus = there.rod.specific_modulus
        found.append((gain, Alternative(start.effect, values, modulus, shift)))
    # An effect for which the recordings speak far less than for another one is none.
    least = max((gain for gain, _ in found), default=0.0) - NAMED
    return tuple(other for gain, other in found if gain >= least)


def _does_nothing(effect: str, settings: Settings) -> bool:
    """Whether the strength of an effect is at neutral: what is better is then the plain DLO."""
    known, values = quantities(effect), settings.effects[effect]
    return any(q.is_strength and values.get(key) == q.neutral for key, q in known.items())
