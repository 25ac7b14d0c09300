# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO creeps through a grip while it is moved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class ClampSlip(Effect):
    """Free length gained in proportion to the path that the imposed points have travelled.

    At the end of the commanded motion it is `length`; the material coordinate is spread evenly
    over the longer DLO.
    """

    name: ClassVar[str] = "clamp_slip"
    title: ClassVar[str] = "slip through a clamp"
    phrase: ClassVar[str] = "the DLO slips through a clamp while it moves"
    batched: ClassVar[bool] = False

    length: float = quantity(
        0.0, "m", -1.0, 1.0, "free length gained by the end of the motion", tolerance=0.005
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.slip = (body.slip or 0.0) + self.length
