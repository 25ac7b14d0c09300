# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A mass fixed to the DLO: a connector, a marker, a hung weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dlo_ros.effects.base import Body, Effect, Scene, Start, quantity
from dlo_ros.effects.start import PLACES


@dataclass(frozen=True)
class PointMass(Effect):
    """A point mass at the DLO's axis, with weight and inertia but no moment of inertia.

    Weight m g [N] and force of inertia -m a [N] at u = position: a lumped mass on a beam in
    Meirovitch, Fundamentals of Vibrations, 2001. With m = 0 there is none; at an end that is held
    it shows in nothing but the grip's force.
    """

    name: ClassVar[str] = "point_mass"
    title: ClassVar[str] = "mass on the DLO"
    phrase: ClassVar[str] = "a mass is fixed to the DLO"
    remedy: ClassVar[str] = (
        "Take the mass off, or weigh it and enter it with its place under effects.point_mass."
    )

    mass: float = quantity(0.0, "kg", 0.0, 10.0, "the mass", tolerance=0.1)
    position: float = quantity(0.0, "m", 0.0, 100.0, "where it is fixed, u", role="place")

    def shape_body(self, body: Body) -> None:
        """See the base class."""
        body.within("point_mass.position", self.position)
        body.masses.append((self.mass, self.position))

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """No mass at several places, and a mass equal to the rope's at its end.

        A mass that outweighs the rope changes the estimate of E so much that no linear test from
        nothing finds it.
        """
        rope, keys = scene.rope, ("mass", "position")
        found = [
            Start(cls.name, {"mass": 0.0, "position": place * rope.length}, keys[:1], keys)
            for place in PLACES
        ]
        heavy = {"mass": rope.mass, "position": rope.length}
        return [*found, Start(cls.name, heavy, (), keys, neutral=False, form="heavy")]
