# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A board on which the DLO rubs: an effect without a derivative where it does nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects import Body, Effect, Scene, Start, quantity

TRIED = (0.02, 0.2)  # felt on a smooth and on a rough board


@dataclass(frozen=True)
class RoughBoard(Effect):
    """Coulomb friction with a board that is pressed by a share of the DLO's weight.

    A DLO that sticks answers to no small change, so `smooth` is False and `starts` says which
    coefficients are tried.
    """

    name: ClassVar[str] = "rough_board"
    smooth: ClassVar[bool] = False

    coefficient: float = quantity(
        0.0, "", 0.0, 10.0, "friction per length over weight per length", tolerance=0.02
    )

    def shape_body(self, body: Body) -> None:
        """Change the rod."""
        weight = 9.81 * body.line_density
        body.friction = (body.friction or 0.0) + self.coefficient * weight

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """A smooth board and a rough one."""
        key = ("coefficient",)
        return [Start(cls.name, {key[0]: tried}, key, key, neutral=False) for tried in TRIED]
