# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Properties that an effect shares with a plain rod, or with another effect.

A fit finds what does nearly the same work first, in a minimum of its own, from which no derivative
leads to the effect. Where effects state them, a search begins there as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

from dlo_ros.effects.start import PlainRod, Start


class Equivalence:
    """Base class of effects; by default an effect has nothing in common with anything.

    Class variables:
        twins: names of effects that do the same to first order, so that no shapes tell them apart.
        mends: names of effects beside which a little of it may only mend their law, where the real
            one runs otherwise along the DLO.
    """

    twins: ClassVar[frozenset[str]] = frozenset()
    mends: ClassVar[frozenset[str]] = frozenset()

    @classmethod
    def instead_of(
        cls, fitted: PlainRod, guessed: PlainRod, begun: Sequence[Start]
    ) -> tuple[Self, PlainRod] | None:
        """The effect for which a fitted plain rod may stand, where no derivative leads to it, and
        the plain rod beside that effect.

        Args:
            guessed: that of the parameter file.
            begun: the effect's starts, whose sizes suit the recordings.
        """
        return None

    def taken_for(self, beside: PlainRod) -> PlainRod:
        """The plain rod that may stand for one with this effect, see `instead_of`."""
        return beside

    def giving_way(self, beside: PlainRod) -> tuple[float, PlainRod] | None:
        """Share of the bending stiffness that gives way as the DLO is bent for long, or far, and
        the rod that has all of it, as in small and fast bends.

        Laws by which as much gives way do much of each other's work.
        """
        return None

    @classmethod
    def that_gives_way(
        cls, share: float, stiff: PlainRod, begun: Sequence[Start]
    ) -> tuple[Self, PlainRod] | None:
        """The effect by which a share of the stiffness of a rod gives way, and the plain rod beside
        it: the inverse of `giving_way`.

        Args:
            begun: the effect's starts, whose sizes suit the recordings.
        """
        return None
