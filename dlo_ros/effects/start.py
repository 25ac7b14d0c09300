# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Starting values of effects for the search in recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.effects.quantity import RopeScale
from dlo_ros.spline import FloatArray

Value = float | tuple[float, ...]
Block = Mapping[str, Value]

TURNS = (1, 3)
"""Numbers of a rotation: an angle about the board's y axis, or a rotation vector."""

PLACES = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
"""Places at which a local effect is tried, over the length."""
INNER_PLACES = PLACES[:-1]
"""The places at which a change of stiffness or of curvature has an effect."""


@dataclass(frozen=True)
class Start:
    """Starting values of one effect.

    Args:
        effect: name of the effect.
        block: values of all keys that are set.
        screened: keys in which the effect is linear at first.
        fitted: keys that are fitted.
        neutral: whether the model is still that without the effect.
        form: label that distinguishes variants of one effect with different open parameters.
    """

    effect: str
    block: Block
    screened: tuple[str, ...]
    fitted: tuple[str, ...]
    neutral: bool = True
    form: str = ""

    @property
    def afar(self) -> bool:
        """Whether it begins far from neutral, where no derivative shows it."""
        return not self.neutral and not self.screened


class PlainRod(NamedTuple):
    """Numbers of a rod without effects that may stand for one with an effect.

    Args:
        young_modulus: [Pa].
        relaxation_time: of Kelvin-Voigt damping [s].
        second_moment: second moment of area of its section [m^4].
        air_drag: linear drag [N s/m^2].
        speed: speed at which a rod of its length swings [m/s].
    """

    young_modulus: float
    relaxation_time: float
    second_moment: float
    air_drag: float = 0.0
    speed: float = 1.0


Reach = tuple[float, float, float]
"""Smallest and largest x, smallest z of some points [m]."""


@dataclass(frozen=True)
class Scene:
    """Size, clamps and reach of the motion in the recordings that a model is fitted to.

    Args:
        rope: length, diameter and material of the plain rope.
        clamps: ends (`start`, `end`) whose direction is imposed in some recording.
        held: ends whose position is imposed in some recording.
        curvature: 90th percentile of the largest curvature of each frame [1/m].
        known: dampings of the parameter file (air_drag, relaxation_time) that are no guesses.
        reach, held_reach: that of the shapes, and of the held ends; None: not known, or nothing is
            held.
        spatial: whether they leave the board's plane, and what acts across it counts.
        in_hands: whether the clamps are commanded by frames of a robot's hands.
    """

    rope: RopeScale
    clamps: tuple[str, ...]
    held: tuple[str, ...]
    curvature: float
    known: tuple[str, ...] = ()
    reach: Reach | None = None
    held_reach: Reach | None = None
    spatial: bool = False
    in_hands: bool = False


def rotation_vector(angle: float | tuple[float, ...]) -> FloatArray:
    """The rotation about x, y, z [rad], shape (3,), of an angle about y or of all three."""
    return np.array(angle if isinstance(angle, tuple) else (0.0, angle, 0.0), dtype=np.float64)


def turned(turn: Rotation, quaternions: FloatArray) -> FloatArray:
    """Quaternions x y z w (T, 4), each followed by a further rotation; their norms stay."""
    x, y, z, w = turn.as_quat()
    product = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    return np.asarray(quaternions @ product.T)


def at_clamps(effect: str, scene: Scene, nothing: Value = 0.0) -> list[Start]:
    """Starts of an effect that has a number for each clamp: each clamp alone, and both.

    Args:
        nothing: the value of a clamp at which it does nothing.
    """
    found = [Start(effect, {end: nothing}, (end,), (end,), form=end) for end in scene.clamps]
    if len(found) == 2:
        both = dict.fromkeys(scene.clamps, nothing)
        found.append(Start(effect, both, tuple(both), tuple(both), form="both"))
    return found
