# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO is moved later than the command says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Effect, quantity


@dataclass(frozen=True)
class CommandDelay(Effect):
    """Time between the commanded and the true motion, positive where the DLO moves later."""

    name: ClassVar[str] = "command_delay"
    title: ClassVar[str] = "delay of the motion"
    phrase: ClassVar[str] = "the DLO does not move when the command says, but later or earlier"
    remedy: ClassVar[str] = (
        "Let camera and robot share one clock, and stamp pictures when they are taken."
    )
    group: ClassVar[str] = "time"
    in_setup: ClassVar[bool] = True

    delay: float = quantity(
        0.0, "s", -2.0, 2.0, "of the true motion", tolerance=0.02, sides=(("later", "earlier"),)
    )

    def later(self) -> float:
        """See the base class."""
        return self.delay
