# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Friction within the DLO: strands or a sheath that rub where it is bent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dlo_ros.effects.base import Body, Effect, PlainRod, Scene, Start, quantity

MOMENTS = (0.01, 0.05)  # of weight per length L^2, from which one is looked for
TURNS = (0.1, 0.4)  # likewise, of the curvatures that occur
TAKEN_SHARE = 0.3  # of the stiffness of a DLO without friction, from where one is looked for in it


@dataclass(frozen=True)
class Hysteresis(Effect):
    """Dahl friction in bending, beside the elastic moment.

    Moment m z [N m] with dz/dkappa = (1 - z sign(dkappa)) / w, kappa the curvature [1/m], m the
    `moment`, w the `curvature` [1/m] within which it turns over: Dahl, A Solid Friction Model,
    1968. Small bends feel a stiffness m / w more, large ones the moment m; w to infinity with m / w
    held is a stiffer DLO, m = 0 a DLO without friction. The first shape is free of it.
    """

    name: ClassVar[str] = "hysteresis"
    title: ClassVar[str] = "friction within the DLO"
    phrase: ClassVar[str] = "friction within the DLO, as of its strands, holds back its bending"
    remedy: ClassVar[str] = "Nothing to mend: strands rub on one another in many cables."
    smooth: ClassVar[bool] = False
    batched: ClassVar[bool] = False

    moment: float = quantity(0.0, "N m", 0.0, 100.0, "largest moment of the friction", natural=0.05)
    curvature: float = quantity(
        1.0, "1/m", 1e-3, 1e4, "change of curvature within which it turns over", natural=1.0
    )

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.inner_friction = (self.moment, self.curvature)

    @classmethod
    def instead_of(
        cls, fitted: PlainRod, guessed: PlainRod, begun: Sequence[Start]
    ) -> tuple[Self, PlainRod] | None:
        """The friction with which a softer rod has small bends as stiff as those of the fitted."""
        return cls.that_gives_way(TAKEN_SHARE, fitted, begun)

    def taken_for(self, beside: PlainRod) -> PlainRod:
        """See the class: the limit of small bends."""
        return self.giving_way(beside)[1]

    def giving_way(self, beside: PlainRod) -> tuple[float, PlainRod]:
        """See the base class: what the friction adds to the stiffness against small bends."""
        more = self.moment / self.curvature / beside.second_moment
        stiff = beside._replace(young_modulus=beside.young_modulus + more)
        return more / stiff.young_modulus, stiff

    @classmethod
    def that_gives_way(
        cls, share: float, stiff: PlainRod, begun: Sequence[Start]
    ) -> tuple[Self, PlainRod]:
        """See the base class."""
        turns = np.array([s.block["curvature"] for s in begun], dtype=np.float64)
        turn = float(np.exp(np.mean(np.log(turns))))
        stiffness = share * stiff.young_modulus * stiff.second_moment
        beside = stiff._replace(young_modulus=(1.0 - share) * stiff.young_modulus)
        return cls(stiffness * turn, turn), beside

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """Small and large moments, each with a fast and a slow reversal."""
        keys, weight = ("moment", "curvature"), scene.rope.unit("N m")
        return [
            Start(
                cls.name, {keys[0]: moment * weight, keys[1]: turn * scene.curvature}, keys, keys,
                neutral=False,
            )
            for moment in MOMENTS
            for turn in TURNS
        ]  # fmt: skip
