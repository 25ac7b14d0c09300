# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How well a number of an effect can be known at best, whose law is simpler than a real DLO.

A drag is nearly quadratic, a part that is stiffer has soft edges, a grip gives way in its own way.
Shapes tell the number with which the law comes nearest, often to a per cent; the real one differs
by more than that, and no residual shows it.
"""

from __future__ import annotations

from dlo_ros.effects import effects, quantities

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
