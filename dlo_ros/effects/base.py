# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The base class of effects, and the rod that an effect may change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from dlo_ros.command import Command
from dlo_ros.effects.equivalence import Equivalence
from dlo_ros.effects.quantity import Quantity, RopeScale, described, quantity
from dlo_ros.effects.start import INNER_PLACES, Block, PlainRod, Scene, Start, Value
from dlo_ros.errors import ParameterError
from dlo_ros.spline import FloatArray, SplineBasis

__all__ = [
    "Body", "Effect", "Peg", "PlainRod", "Quantity", "RopeScale", "Scene", "Start", "Wall",
    "quantity",
]  # fmt: skip

PREFIX = "effects."  # of the names of their parameters
SHORTEST = 0.1  # of the configured length that effects may leave
LOCAL = 0.2  # of the length: extent from which one is looked for
Part = Literal["rod", "command", "measurement"]
ROD: Part = "rod"
COMMAND: Part = "command"
MEASUREMENT: Part = "measurement"
METHODS: Mapping[str, Part] = {
    "shape_body": ROD, "impose": COMMAND, "later": MEASUREMENT, "measured": MEASUREMENT,
    "true": MEASUREMENT,
}  # fmt: skip
"""What an effect acts on that overrides a method."""


class Peg(NamedTuple):
    """A round peg that stands on the board, frictionless."""

    x: float  # [m]
    z: float  # [m]
    radius: float  # of the peg itself [m]


class Wall(NamedTuple):
    """A straight frictionless wall or table that stands on the board."""

    x: float  # of the unit normal, towards the free side
    z: float
    offset: float  # of the wall along the normal [m]


@dataclass
class Body:
    """The rod during its assembly; an effect changes its numbers in place.

    Args:
        basis: spline basis of the simulation, over the configured length L.
        points: material coordinates of the quadrature points [m], shape (nb,).
        weight: weights of the quadrature points [m], shape (nb,); the cells of this width tile the
            DLO.
        bend: bending stiffness about both principal axes of the section [N m^2], shape (nb, 2).
        section_angle: angle from the first material director to the first principal axis [rad].
        bend_rest: curvature at rest about the material directors [1/m], shape (nb, 2); the first is
            the clamp's y axis.
        twist_rest: twist at rest [rad/m], shape (nb,).
        twisting_ratio: twisting stiffness over that of a round section.
        line_density: mass per length [kg/m].
        air_drag: force per length over velocity [N s/m^2].
        relaxation_time: relaxation time of Kelvin-Voigt damping [s].
        gravity: [m/s^2], shape (3,).
        force: dead force per length [N/m], shape (3,).
        masses: masses fixed to the DLO, each as mass [kg] and place u [m].
        kinks: kinks in the board's plane, each as angle [rad] and place u [m].
        grip_compliance: compliance of the grips at start and end against the DLO's moment [rad/(N
            m)]; None: no grip may give.
        half_curvature: curvature at which the tangent bending stiffness has halved [1/m].
        yield_curvature: elastic curvature past which bending yields [1/m].
        hardening: tangent bending stiffness past the yield over that before it, 0 to 1.
        relaxing: share of the bending stiffness that relaxes, and the time in which it does [s];
            None: none.
        inner_friction: largest moment of friction within the DLO [N m], and the change of curvature
            within which it turns over [1/m]; None: there is none.
        friction: Coulomb friction with the board per length [N/m]; None: the board is not touched.
        pegs: the pegs that the DLO may touch.
        walls: the walls that the DLO may touch.
        quadratic_drag: c of a force per length -c |v_n| v_n [N s^2/m^3]; None: there is none.
        lengthening: true length over configured length.
        slip: free length gained through a grip during the motion [m]; None: no grip slips.
        slip_step: time at which it begins to be gained, from the first frame, and the time that
            takes [s]; None: it is gained evenly.
        hinge: compliance of the grips as one of bending, which is in `bend` and linear: curvature
            over moment [1/(N m^2)], shape (nb,).
    """

    basis: SplineBasis
    points: FloatArray
    weight: FloatArray
    bend: FloatArray
    bend_rest: FloatArray
    twist_rest: FloatArray
    line_density: float
    air_drag: float
    relaxation_time: float
    gravity: FloatArray
    twisting_ratio: float = 1.0
    force: FloatArray = field(default_factory=lambda: np.zeros(3))
    masses: list[tuple[float, float]] = field(default_factory=list)
    kinks: list[tuple[float, float]] = field(default_factory=list)
    grip_compliance: tuple[float, float] | None = None
    half_curvature: float = math.inf
    yield_curvature: float = math.inf
    hardening: float = 0.0
    relaxing: tuple[float, float] | None = None
    inner_friction: tuple[float, float] | None = None
    friction: float | None = None
    pegs: list[Peg] = field(default_factory=list)
    walls: list[Wall] = field(default_factory=list)
    quadratic_drag: float | None = None
    section_angle: float = 0.0
    lengthening: float = 1.0
    slip: float | None = None
    slip_step: tuple[float, float] | None = None
    hinge: FloatArray | float = 0.0

    def check(self) -> None:
        """Refuse a rod that effects have made impossible.

        Raises:
            ParameterError: which quantity is negative or vanishes, its value, what is allowed.
        """
        for name, value, unit in (
            ("damping.air_drag + effects.air_drag.coefficient", self.air_drag, "N s/m^2"),
            (
                "damping.relaxation_time + effects.internal_damping.relaxation_time",
                self.relaxation_time,
                "s",
            ),
            ("the mass per length", self.line_density, "kg/m"),
        ):
            if not value >= 0.0:
                raise ParameterError(f"{name} is {value:g} {unit} in all; it must not be negative")
        if not np.all(self.bend > 0.0):
            raise ParameterError(
                f"effects leave a bending stiffness of {self.bend.min():g} N m^2; it must be "
                "positive"
            )
        least = self.length * self.lengthening + min(self.slip or 0.0, 0.0)
        if not least >= SHORTEST * self.length:
            raise ParameterError(
                f"effects.length_error and effects.clamp_slip leave {least:g} m of a DLO of "
                f"{self.length:g} m; at least {SHORTEST * self.length:g} m must be left"
            )

        if self.bend_matrix[:, 2].any() and (
            math.isfinite(self.half_curvature) or math.isfinite(self.yield_curvature)
        ):
            raise ParameterError(
                f"effects.anisotropy.angle is {self.section_angle:g} rad, and the DLO softens or "
                "yields; give the angle 0 there, or leave effects.nonlinear_stiffness and "
                "effects.plasticity out"
            )

    @property
    def hinged(self) -> np.ndarray:
        """Whether a point bends as a grip does that gives, shape (nb,)."""
        return np.broadcast_to(np.asarray(self.hinge) != 0.0, self.weight.shape)

    @property
    def bend_matrix(self) -> FloatArray:
        """Bending stiffness about the material directors, 11, 22 and 12 [N m^2], shape (nb, 3)."""
        if self.section_angle == 0.0:
            return np.column_stack([self.bend, np.zeros(len(self.bend))])
        c, s = math.cos(self.section_angle), math.sin(self.section_angle)
        soft, stiff = self.bend.T
        return np.column_stack(
            [c * c * soft + s * s * stiff, s * s * soft + c * c * stiff, c * s * (soft - stiff)]
        )

    @property
    def length(self) -> float:
        """Configured length L [m], over which u counts."""
        return self.basis.length

    def within(self, key: str, place: float) -> None:
        """Refuse a place that is not on the DLO.

        Raises:
            ParameterError: names effects.KEY, the place and the length.
        """
        if not -1e-3 * self.length <= place <= 1.001 * self.length:
            raise ParameterError(
                f"effects.{key} is {place:g} m; it must lie on the DLO, 0 to {self.length:g} m"
            )

    def hat(self, place: float, least: float = 0.0) -> FloatArray:
        """1 at a place, 0 a knot span or `least` [m] away, at the quadrature points, (nb,)."""
        away = np.abs(self.points - place) / max(self.basis.span_length, least)
        return np.maximum(1.0 - away, 0.0)

    def give_at_grips(self) -> None:
        """Add the compliance of the grips to that of bending in the first knot span beside them.

        A hinge of compliance c at an end is a compliance c w(u) per length with integral 1 of w,
        which falls from the end over a knot span h. The DLO turns about a point that is h / 3 from
        the end; spans there are short, see `SplineBasis.halvings`.
        """
        h = self.basis.breaks[1]
        ends, compliances = (0.0, self.basis.length), self.grip_compliance or (0.0, 0.0)
        for end, compliance in zip(ends, compliances, strict=True):
            if compliance == 0.0:
                continue
            turn = compliance / self.lengthening  # curvature counts per true length
            share = 2.0 / h * np.maximum(1.0 - np.abs(self.points - end) / h, 0.0)
            self.bend /= 1.0 + turn * share[:, None] * self.bend
            self.hinge = self.hinge + turn * share

    def coverage(self, start: float, stop: float) -> FloatArray:
        """Share in [start, stop] at the quadrature points, shape (nb,).

        It rises and falls over a knot span to either side, since the spline's curvature cannot
        jump; what of that would lie beyond an end of the DLO is folded back. So its integral is
        that of the interval, and an interval up to an end is whole there.
        """
        start, stop = (min(max(u, 0.0), self.length) for u in (start, stop))
        at = np.array([self.points, -self.points, 2.0 * self.length - self.points])
        return np.asarray((self._step(at - start) - self._step(at - stop)).sum(axis=0))

    def _step(self, beyond: FloatArray) -> FloatArray:
        """The integral of a hat as wide as two knot spans: 0 far before and 1 far behind 0."""
        s = np.clip(beyond / self.basis.span_length, -1.0, 1.0)
        result: FloatArray = 0.5 + s - 0.5 * s * np.abs(s)
        return result


class Effect(Equivalence):
    """One cause of a difference between the plain model and a real DLO.

    A subclass is a frozen dataclass whose fields are made by `quantity`. It overrides what it
    changes; everything else stays as it is. What fits and searches must know of it stands on the
    class, too; every default is the careful one.

    Class variables:
        name: in reports and parameter files.
        title: what it is, for people; its name where it says nothing.
        phrase: the same as a clause that says what is so: "a mass is fixed to the DLO".
        remedy: what a person can do about it by hand, in a short sentence or two.
        group: the part of an experiment that it belongs to, such as clamps or camera.
        acts_on: rod, command or measurement, found from the methods that are overridden.
        smooth: whether shapes have useful derivatives by its sizes where it does nothing. It is
            then looked for by a linear test; otherwise by trial of plausible sizes.
        differentiable: whether they have any once it acts. An impact has none: a DLO that hits
            something and leaves it again answers to small changes in jumps.
        batched: whether it may be present where several parameter sets are simulated at once
            (`dlo_ros.rod.batch.parameter_sets`), with the same values in all. Never where it
            changes the measurement, which such a run knows nothing of.
        in_setup: whether every real set-up has a little of it, within its tolerances.
        idealised: whether real DLOs follow its law in the rough only, which is so for all that acts
            on the rod but for plain errors of a set-up.
        of_commanded_frames: whether `impose` needs the clamps' rotations as they were commanded.
    """

    name: ClassVar[str]
    title: ClassVar[str] = ""
    phrase: ClassVar[str] = ""
    remedy: ClassVar[str] = ""
    group: ClassVar[str] = "DLO"
    acts_on: ClassVar[frozenset[Part]] = frozenset()
    smooth: ClassVar[bool] = True
    differentiable: ClassVar[bool] = True
    batched: ClassVar[bool] = True
    in_setup: ClassVar[bool] = False
    idealised: ClassVar[bool] = False
    of_commanded_frames: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.acts_on = frozenset(
            part for method, part in METHODS.items()
            if getattr(cls, method) is not getattr(Effect, method)
        )  # fmt: skip
        cls.batched = cls.batched and MEASUREMENT not in cls.acts_on
        cls.smooth = cls.smooth and cls.differentiable
        cls.idealised = cls.idealised or (ROD in cls.acts_on and not cls.in_setup)

    @classmethod
    def called(cls, side: str = "") -> str:
        """The title, or the name in words.

        Args:
            side: see `report_phrase`.
        """
        return cls._on_side(cls.title or cls.name.replace("_", " "), side)

    @classmethod
    def report_phrase(cls, side: str = "") -> str:
        """The phrase for reports, or the name in words.

        Args:
            side: one of the words of a parameter's `sides`: it takes the place of both in the
                phrase, where that names both ("longer or shorter"); empty: it is not known.
        """
        return cls._on_side(cls.phrase or f"there is an effect of {cls.called()}", side)

    @classmethod
    def _on_side(cls, words: str, side: str) -> str:
        """Words in which a known side takes the place of both."""
        for above, below in (pair for q in cls.quantities() for pair in q.sides):
            if side in (above, below):
                words = words.replace(f"{above} or {below}", side)
        return words

    def shape_body(self, body: Body) -> None:
        """Change the rod: stiffness, rest strain, mass, load, damping, surroundings."""

    def impose(self, command: Command) -> Command:
        """The true command where `command` was commanded."""
        return command

    def later(self) -> float:
        """Delay of the DLO's seen motion after its command [s]."""
        return 0.0

    def measured(self, points: FloatArray) -> FloatArray:
        """Points (m, 3) of the board frame as the camera measures them, truly at `points`."""
        return points

    def true(self, points: FloatArray) -> FloatArray:
        """The inverse of `measured`."""
        return points

    @classmethod
    @cache
    def quantities(cls) -> tuple[Quantity, ...]:
        """The effect's parameters."""
        return tuple(described(f) for f in fields(cls))  # type: ignore[arg-type]  # a dataclass

    @classmethod
    def parameter(cls, key: str) -> str:
        """Full name of a parameter, `effects.NAME.KEY`."""
        return f"{PREFIX}{cls.name}.{key}"

    @classmethod
    def setup(cls, scene: Scene) -> Block:
        """Neutral values of the numbers by which the effect is a small error of every set-up.

        They are always open within their tolerances where the joint model is fitted; empty: an
        effect that a careful set-up does not have.
        """
        return {q.name: q.nothing for q in cls.seen_in(scene)} if cls.in_setup else {}

    @classmethod
    def seen_in(cls, scene: Scene) -> tuple[Quantity, ...]:
        """The parameters, those alone that act in the board's plane where recordings stay there."""
        return tuple(q for q in cls.quantities() if scene.spatial or not q.spatial)

    @classmethod
    def starts(cls, scene: Scene) -> list[Start]:
        """From where the effect is looked for in recordings; empty: nowhere.

        By default all parameters are fitted, from several places where there is one. A smooth
        effect begins neutral, one that is not with its natural sizes to either side. What is added
        to a damping is not looked for where that damping is a guess, which is fitted anyway.
        """
        keys = cls.seen_in(scene)
        neutral = {q.name: q.nothing for q in keys if not q.geometric}
        if not neutral or any(q.adds_to and q.adds_to not in scene.known for q in keys):
            return []
        local = any(q.role == "place" and q.unit == "m" for q in keys)
        found = []
        for place in INNER_PLACES if local else (0.5,):
            for side in (0.0,) if cls.smooth else (1.0, -1.0):
                block = {q.name: _beginning(q, scene.rope, place, side) for q in keys}
                if not cls.smooth and neutral.items() <= block.items():
                    continue  # a side on which it does nothing
                sought = tuple(neutral) if cls.smooth else ()
                start = Start(cls.name, block, sought, tuple(block), neutral=cls.smooth)
                if start not in found:
                    found.append(start)
        return found


def _beginning(q: Quantity, rope: RopeScale, place: float, side: float) -> Value:
    """Value of a parameter at the start of a search.

    Args:
        place: the place along the DLO at which the effect starts, over the length.
        side: 0: nothing; 1 or -1: the natural size above or below that.
    """
    if q.role in ("place", "extent") and q.unit == "m":
        low, high = q.search_for(rope)
        value = place * rope.length if q.role == "place" else LOCAL * rope.length
        return min(max(value, low), high)
    if q.geometric or not side:
        return q.nothing
    value = q.plausible_for(rope, side)
    return q.filled(value)
