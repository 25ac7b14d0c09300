# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A steady force acts along the whole DLO, such as a draught."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity
from dlo_ros.effects.quantity import ALONG_AXES

TOLERANCE = 0.02  # of the weight: draught of a room in which nobody feels any


@dataclass(frozen=True)
class ConstantForce(Effect):
    """Uniform force per length f = (x, y, z) [N/m]; y leaves the board's plane.

    A dead load: internal force n with dn/du = -f, Antman, Nonlinear Problems of Elasticity, 1995.
    Along gravity it is another density without another inertia; with 0 there is none.
    """

    name: ClassVar[str] = "constant_force"
    title: ClassVar[str] = "even force"
    phrase: ClassVar[str] = "an even force, such as a draught, acts on all of the DLO"
    remedy: ClassVar[str] = (
        "Keep draughts away, and look for what pulls at the DLO all along, such as a tilted board."
    )
    group: ClassVar[str] = "surroundings"
    twins: ClassVar[frozenset[str]] = frozenset({"gravity_tilt"})

    x: float = quantity(
        0.0, "N/m", -100.0, 100.0, "along x", tolerance=TOLERANCE, sides=ALONG_AXES[:1]
    )
    z: float = quantity(
        0.0, "N/m", -100.0, 100.0, "along z", tolerance=TOLERANCE, sides=ALONG_AXES[2:]
    )
    y: float = quantity(
        0.0, "N/m", -100.0, 100.0, "along y", tolerance=TOLERANCE, spatial=True,
        sides=ALONG_AXES[1:2],
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.force += [self.x, self.y, self.z]
