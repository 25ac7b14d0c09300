# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO is not straight at rest: a set from the coil, or a kink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity
from dlo_ros.effects.quantity import TURNED
from dlo_ros.effects.start import INNER_PLACES, Block

PATTERNS = (3, 4, 5)  # numbers of values of a curvature at rest that varies along the DLO

COILED = 0.05  # share of the cables that keep much more of their coil than they should
SETUP_VALUES = 5  # along the DLO, of the curvature that every cable has from its coil


@dataclass(frozen=True)
class IntrinsicCurvature(Effect):
    """A curvature at rest, in the board's plane; in space also across it.

    Moment B (kappa - kappa_0) [N m], kappa_0 in 1/m: a naturally curved rod in Love, A Treatise on
    the Mathematical Theory of Elasticity, 1927. Without load an even kappa_0 makes an arc of radius
    1 / kappa_0; with 0 the DLO is straight.

    Positive where the tangent turns from x towards -z with growing u. One number is constant along
    the DLO, several are equally spaced along u with straight lines between. A kink turns the
    tangent by its angle [rad], spread over the knot spans beside its position, or over 2 % of the
    length to either side.

    `curvature` is about the first material director, the clamp's y axis or without a clamp +y,
    `across` about the second, tangent x first; both turn with the DLO where it is twisted.
    """

    name: ClassVar[str] = "intrinsic_curvature"
    title: ClassVar[str] = "curvature at rest"
    phrase: ClassVar[str] = "the DLO is curved even where nothing bends it"
    remedy: ClassVar[str] = (
        "Straighten the DLO, or leave it as it is and clamp it the same way round in all "
        "recordings."
    )
    in_setup: ClassVar[bool] = True

    curvature: float | tuple[float, ...] = quantity(
        0.0, "1/m", -200.0, 200.0, "curvature at rest, one value or several along u", array=True,
        tolerance=0.5, beyond=COILED, sides=(TURNED,),
    )  # fmt: skip
    kink: float = quantity(0.0, "rad", -3.0, 3.0, "angle of a kink", sides=(TURNED,))
    position: float = quantity(0.0, "m", 0.0, 100.0, "where the kink is, u", role="place")
    across: float | tuple[float, ...] = quantity(
        0.0, "1/m", -200.0, 200.0, "about the section's other axis: one value or several along u",
        array=True, tolerance=0.5, beyond=COILED, spatial=True,
    )  # fmt: skip

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        for director, given in enumerate((self.curvature, self.across)):
            if not given:
                continue
            values = np.atleast_1d(np.asarray(given, dtype=np.float64))
            apart = body.length / max(len(values) - 1, 1)
            at = apart * np.arange(len(values))
            body.bend_rest[:, director] += np.interp(body.points, at, values)
        if self.kink:
            body.within("intrinsic_curvature.position", self.position)
            body.kinks.append((self.kink, self.position))

    @classmethod
    def setup(cls, scene: Scene) -> Block:
        """See the base class: the set of a coil, which changes slowly along the DLO."""
        even = (0.0,) * SETUP_VALUES
        return {"curvature": even, "across": even} if scene.spatial else {"curvature": even}

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """An even curvature, several values along the DLO, and kinks at several places."""
        key = ("curvature",)
        found = [Start(cls.name, {"curvature": 0.0}, key, key, form="even")]
        for count in PATTERNS:
            values = (0.0,) * count
            found.append(Start(cls.name, {"curvature": values}, key, key, form=f"along {count}"))
        for place in INNER_PLACES:
            block = {"kink": 0.0, "position": place * scene.rope.length}
            found.append(Start(cls.name, block, ("kink",), tuple(block), form="kink"))
        if scene.spatial:
            both = {"curvature": 0.0, "across": 0.0}
            found.append(Start(cls.name, both, tuple(both), tuple(both), form="both planes"))
        return found
