# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A stretch of the DLO bends otherwise: a splice, tape, a damaged spot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dlo_ros.effects.base import Body, Effect, quantity
from dlo_ros.spline import FloatArray

STEPS = 4
"""Stretches of a tapered end, in each of which the stiffness is even."""


@dataclass(frozen=True)
class StiffSegment(Effect):
    """Bending stiffness times `ratio` over `extent` around `centre`.

    kappa = M / (ratio B) within the segment and M / B beside it [1/m], M continuous: a stepped beam
    in Timoshenko, Strength of Materials, 1955. With the ratio 1 or the extent 0 the DLO is even.
    At either end of it the stiffness may change over a stretch of `taper` times `extent`, in whose
    middle the end is, evenly in its logarithm.
    """

    name: ClassVar[str] = "stiff_segment"
    title: ClassVar[str] = "stiffer or softer segment"
    phrase: ClassVar[str] = "one part of the DLO is stiffer or softer than the rest"
    remedy: ClassVar[str] = (
        "Look there for tape, a splice or damage and remove it, or leave it as it is."
    )
    mends: ClassVar[frozenset[str]] = frozenset({"stiffness_gradient"})

    centre: float = quantity(0.0, "m", 0.0, 100.0, "its middle, u", role="place")
    extent: float = quantity(0.0, "m", 0.0, 100.0, "its length", role="extent")
    ratio: float = quantity(
        1.0, "", 0.01, 1000.0, "stiffness there over that elsewhere", role="ratio", tolerance=0.3,
        sides=(("stiffer", "softer"),),
    )  # fmt: skip
    taper: float = quantity(
        0.0, "", 0.0, 1.0, "stretch over which it begins, over its length", role="extent",
        search=(0.0, 0.5),
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.within("stiff_segment.centre", self.centre)
        # It is the compliance that adds up: the moment is continuous, the curvature jumps.
        body.bend /= 1.0 + self._compliance(body)[:, None]

    def _compliance(self, body: Body) -> FloatArray:
        """The compliance that the segment adds, over that of the DLO, shape (nb,)."""
        ends = 0.5 * self.extent * (1.0 + self.taper * np.linspace(1.0, -1.0, STEPS + 1))
        within = [body.coverage(self.centre - half, self.centre + half) for half in ends]
        shares = np.append((np.arange(STEPS) + 0.5) / STEPS, 1.0)
        added = np.diff(self.ratio**-shares - 1.0, prepend=0.0)
        return np.asarray(added @ np.array(within))
