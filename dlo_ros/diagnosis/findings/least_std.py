# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How well a number of an effect can be known at best, by whatever shapes.

A drag is nearly quadratic, a part that is stiffer has soft edges, a grip gives way in its own way.
Shapes tell the number with which the law comes nearest, often to a per cent; the real one differs
by more than that, and no residual shows it. Masses, forces and moments they tell over the weight of
the DLO, which goes with the square of its diameter.
"""

from __future__ import annotations

import math

from dlo_ros.effects import effects, quantities
from dlo_ros.identification.force_scale import POWERS
from dlo_ros.identification.information import diameter_error
from dlo_ros.rod_settings import RodParameters

LAW_ERROR = 0.05
"""Standard deviation of a law's number, over the number: of 179 fitted to laws of another form, or
beside others, 75 % lie within twice what the shapes alone tell, and 88 % with this added."""
PLACE_ERROR = 0.003
"""Standard deviation of where something lies or how far it reaches, over the length: of 72 places,
79 % lie within twice what the shapes alone tell, and 93 % with this added."""


def law_error(effect: str, key: str, value: float, length: float) -> float:
    """Standard deviation that the simplicity of an effect's law leaves in a number, in its unit.

    Args:
        effect, key: name of the effect and key of the number.
        value: the number.
        length: L [m].
    """
    quantity = quantities(effect)[key]
    if not effects()[effect].idealised:
        return 0.0
    if quantity.geometric:
        return PLACE_ERROR * length if quantity.unit == "m" else 0.0
    if quantity.role == "angle":
        return 0.0
    return LAW_ERROR * abs(value - quantity.neutral if quantity.from_neutral else value)


def least_std(effect: str, key: str, value: float, rod: RodParameters) -> float:
    """Standard deviation of a number that its law and the DLO's diameter leave, in its unit.

    Args:
        effect, key: name of the effect and key of the number.
        value: the number.
        rod: the DLO as the parameter file has it.
    """
    power = POWERS.get(quantities(effect)[key].unit, 0.0)
    weight = 2.0 * power * diameter_error(rod, usual=True) * value
    return math.hypot(law_error(effect, key, value, rod.length), weight)
