# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects: what a real DLO, its grips, its surroundings or its camera do beyond the plain model.

One file is one effect, with its parameters and what it adds. `physics` holds those that change the
rod or what holds it, `measurement` those that change only how and when it is seen. Other packages
add theirs through the entry point group `dlo_ros.effects`.
"""

from dlo_ros.effects.base import (
    Body,
    Effect,
    Peg,
    PlainRod,
    Quantity,
    RopeScale,
    Scene,
    Start,
    Wall,
    quantity,
)
from dlo_ros.effects.registry import (
    Values,
    added_to_damping,
    build,
    damping_effect,
    effects,
    quantities,
    starts,
)

__all__ = [
    "Body",
    "Effect",
    "Peg",
    "PlainRod",
    "Quantity",
    "RopeScale",
    "Scene",
    "Start",
    "Values",
    "Wall",
    "added_to_damping",
    "build",
    "damping_effect",
    "effects",
    "quantities",
    "quantity",
    "starts",
]
