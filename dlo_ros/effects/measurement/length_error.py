# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO is longer or shorter than configured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, quantity


@dataclass(frozen=True)
class LengthError(Effect):
    """True minus configured length; the material coordinate stays that of the configured one."""

    name: ClassVar[str] = "length_error"
    title: ClassVar[str] = "length of the DLO"
    phrase: ClassVar[str] = "the DLO is longer or shorter than the parameter file says"
    remedy: ClassVar[str] = "Measure the free length of the DLO again and correct rod.length."
    batched: ClassVar[bool] = False
    in_setup: ClassVar[bool] = True

    difference: float = quantity(
        0.0,
        "m",
        -1.0,
        1.0,
        "true minus configured length",
        tolerance=0.005,
        search=(-0.5, 0.5),
        stated_by="rod.length_std",
        sides=(("longer", "shorter"),),
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.lengthening += self.difference / body.length
