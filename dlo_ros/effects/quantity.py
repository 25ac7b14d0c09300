# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A parameter of an effect: its unit, range, role, tolerance and plausible size."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, field
from typing import Any, Literal

Role = Literal["size", "angle", "ratio", "place", "extent", "point"]
"""`size`: how much there is of the effect; `angle`: the same in radians; `ratio`: a factor, fitted
by its logarithm; `place`: where along the DLO, u; `extent`: how long or how large; `point`: a
coordinate in the board frame. The last three say where it acts, not how much."""

NATURAL: Mapping[str, float] = {
    "m": 0.1, "1/m": 3.0, "rad": 0.3, "s": 0.1, "N s/m^2": 10.0,
}  # fmt: skip
"""Plausible size of a cause by its unit, in units of the rope; 1 for every other unit."""
ON_THE_ROPE = (0.0, 1.0)
"""Range of a place, of the length."""
ALONG_THE_ROPE = (0.02, 0.6)
"""Range of an extent, of the length: shorter ones act like a point, longer ones like the whole."""
ALONG_AXES = (
    ("to the right", "to the left"),
    ("away from the camera", "towards the camera"),
    ("up", "down"),
)
"""Words for a move along the board's x, y and z axes, and for one against them."""
TURNED = ("clockwise", "counterclockwise")
"""Words for an angle about the board's y axis, as the camera sees it: positive, negative."""
ABOUT_AXES = (("", ""), TURNED, ("", ""))
"""The same of a rotation vector, of which nobody has words for the other two."""
IN_PLANE = (0, 2)
"""Axes of a vector of two numbers."""
VECTOR, NORMAL = 3, 1  # numbers of a vector in the board's frame, and which of them is across it
LEAST_DRAG = 1e-3  # [s/m] of the weight per length: unit of a drag where none is configured
LEAST_TIME = 1e-4  # [s] unit of a relaxation time where none is configured
MOST_REMOVED = 0.99  # share of a configured damping that an effect may take away


@dataclass(frozen=True)
class RopeScale:
    """The plain rope, which gives the units for the numbers of an effect.

    Args:
        length: L [m].
        weight: weight per length [N/m].
        mass: mass of the whole rope [kg].
        air_drag: configured force per length over velocity [N s/m^2].
        relaxation_time: configured, of Kelvin-Voigt damping [s].
    """

    length: float
    weight: float
    mass: float
    air_drag: float
    relaxation_time: float

    def unit(self, unit: str) -> float:
        """Size of an SI unit's quantity for this rope, in that unit: L for m, 1/L for 1/m ..."""
        sizes = {
            "m": self.length,
            "1/m": 1.0 / self.length,
            "kg": self.mass,
            "kg/m": self.mass / self.length,
            "N": self.weight * self.length,
            "N/m": self.weight,
            "N m": self.weight * self.length**2,
            "rad/(N m)": 1.0 / (self.weight * self.length**2),
            "N s^2/m^3": self.mass / self.length**2,
            "N s/m^2": max(self.air_drag, LEAST_DRAG * self.weight),
        }
        return sizes.get(unit, 1.0)


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect.

    Args:
        name: key in reports and, after `effects.NAME.`, in the parameter file.
        neutral: value with which the effect does nothing (for a place: any).
        unit: SI unit, empty where there is none.
        lower, upper: range, both ends allowed.
        description: a few words.
        array: whether several values, equally spaced along u, may be given.
        counts: numbers of values that must be given, such as the components of a vector, the first
            as long as nothing is said; 1 is a number by itself; empty: one value, or any number of
            an array.
        role: kind of number, see `Role`.
        tolerance: standard deviation within which a set-up is as careful people build it, in units
            of the rope (of the logarithm for a ratio); None: there is no such thing.
        beyond: probability that a DLO is far beyond the tolerance, of which nobody takes care.
        natural: plausible size for a cause, in units of the rope; None: as for others of the unit.
        search: range within which the value is looked for, in units of the rope; None: as for
            others of the role.
        adds_to: damping of the parameter file to which the value is added: air_drag or
            relaxation_time; empty: none.
        stated_by: parameter of the file that states the tolerance where it is positive, besides
            `effects.NAME.KEY_std`; empty: none.
        spatial: whether it makes a DLO leave the board's plane, or is seen only outside of it: it
            is then left alone where recordings stay there.
        sides: words for a value above neutral and for one below it, such as longer and shorter; of
            a vector for each of the board's axes; empty: there are none.
        axes: letters of the components of a vector; empty: x and z of two, x, y and z of three.
        once: whether it says when something happens, which each recording may see at another time.
    """

    name: str
    neutral: float
    unit: str
    lower: float
    upper: float
    description: str
    array: bool = False
    counts: tuple[int, ...] = ()
    role: Role = "size"
    tolerance: float | None = None
    beyond: float = 0.0
    natural: float | None = None
    search: tuple[float, float] | None = None
    adds_to: str = ""
    stated_by: str = ""
    spatial: bool = False
    sides: tuple[tuple[str, str], ...] = ()
    axes: str = ""
    once: bool = False

    @property
    def bracketed(self) -> str:
        """The unit in brackets, with a space before it; 1 where there is none."""
        return f" [{self.unit or '1'}]"

    def side(self, value: float, index: int | None = None, count: int = 1) -> str:
        """The word for the side of neutral on which a value lies; empty: there is none.

        Args:
            value: the number.
            index: its index in a parameter of several numbers; None: it is the only one.
            count: how many numbers the parameter has.
        """
        if not self.sides or value == self.neutral:
            return ""
        axis = 0
        if len(self.sides) == VECTOR:
            axis = NORMAL if index is None else (IN_PLANE[index] if count < VECTOR else index)
        above, below = self.sides[axis]
        return below if value < self.neutral else above

    @property
    def geometric(self) -> bool:
        """Whether it is the place of the effect rather than its size."""
        return self.role in ("place", "extent", "point")

    @property
    def from_neutral(self) -> bool:
        """Whether its distance from neutral says how much there is of the effect.

        A place says nothing of it, nor does a scale that is never zero, such as a time.
        """
        return not self.geometric and (self.neutral == 0.0 or self.role == "ratio")

    @property
    def is_strength(self) -> bool:
        """Whether a size says how much there is of the effect: at neutral, or far from it where
        neutral is a limit, there is none. Other sizes are scales, such as a time or a curvature.
        """
        return self.from_neutral or not self.lower < self.neutral < self.upper

    @property
    def logarithmic(self) -> bool:
        """Whether a fit sees the value's logarithm."""
        return self.lower > 0.0

    def transformed(self, value: float) -> float:
        """A value in the units of the fit: the value itself, or its logarithm."""
        return math.log(value) if self.logarithmic else value

    def restored(self, seen: float) -> float:
        """The inverse of `transformed`."""
        return math.exp(seen) if self.logarithmic else seen

    @property
    def nothing(self) -> float | tuple[float, ...]:
        """The neutral value in the form in which it must be given."""
        return self.filled(self.neutral)

    def filled(self, value: float) -> float | tuple[float, ...]:
        """One value, repeated for all numbers that must be given."""
        count = self.counts[0] if self.counts else 1
        return (value,) * count if count > 1 else value

    def sideways(self, index: int | None, count: int) -> bool:
        """Whether one of the numbers acts out of the board's plane.

        Args:
            index: index of the number; None: it is the only one.
            count: how many numbers the parameter has.
        """
        if not self.counts or index is None or count != VECTOR:
            return self.spatial
        return self.spatial or (index == NORMAL) != (self.unit == "rad")

    def scale(self, rope: RopeScale) -> float:
        """Size of the unit of the rope in which tolerance, natural and search are given [SI]."""
        if self.role == "ratio":
            return 1.0
        if self.adds_to == "relaxation_time":
            return max(rope.relaxation_time, LEAST_TIME)
        return rope.unit(self.unit)

    def tolerance_for(self, rope: RopeScale) -> float | None:
        """Standard deviation of the number in an ordinary set-up, in `unit`.

        That of a ratio is of its logarithm. None: no tolerance.
        """
        return None if self.tolerance is None else self.tolerance * self.scale(rope)

    def natural_for(self, rope: RopeScale) -> float:
        """A plausible size for a cause, in `unit`; 1 of what is fitted by its logarithm."""
        if self.logarithmic:
            return 1.0
        share = NATURAL.get(self.unit, 1.0) if self.natural is None else self.natural
        return share * self.scale(rope)

    def plausible_for(self, rope: RopeScale, side: float) -> float:
        """Value with a plausible size for a cause, in `unit`.

        Args:
            side: 1 or -1, above or below neutral; of no meaning where `natural` says the value of a
                number that is fitted by its logarithm.
        """
        if not self.logarithmic:
            value = self.neutral + side * self.natural_for(rope)
        elif self.natural is None:
            value = self.neutral * math.exp(side)
        else:
            value = self.natural * self.scale(rope)
        low, high = self.search_for(rope)
        return min(max(value, low), high)

    def search_for(self, rope: RopeScale) -> tuple[float, float]:
        """Lowest and highest value of the search, in `unit`, within the range."""
        if self.adds_to:
            return -MOST_REMOVED * getattr(rope, self.adds_to), self.upper
        shares = self.search
        if shares is None and self.unit == "m":
            shares = {"place": ON_THE_ROPE, "extent": ALONG_THE_ROPE}.get(self.role)
        if shares is None:
            return self.lower, self.upper
        low, high = (share * self.scale(rope) for share in shares)
        return max(low, self.lower), min(high, self.upper)

    def range_around(self, value: float, rope: RopeScale) -> tuple[float, float]:
        """Lowest and highest value between which the number means the same as a value, in `unit`.

        It is the range of the search where the value lies in that, else all of the range: beyond an
        end of the DLO a place is that end, and a moment before the first frame may stand for none.
        """
        low, high = self.search_for(rope)
        return (low, high) if low <= value <= high else (self.lower, self.upper)


def quantity(
    neutral: float,
    unit: str,
    lower: float,
    upper: float,
    description: str,
    *,
    array: bool = False,
    counts: tuple[int, ...] = (),
    role: Role | None = None,
    tolerance: float | None = None,
    beyond: float = 0.0,
    natural: float | None = None,
    search: tuple[float, float] | None = None,
    adds_to: str = "",
    stated_by: str = "",
    spatial: bool = False,
    sides: tuple[tuple[str, str], ...] = (),
    axes: str = "",
    once: bool = False,
) -> Any:
    """A dataclass field that is a parameter of an effect; see `Quantity`.

    Args:
        neutral, unit, lower, upper, description, array, counts, tolerance, beyond, natural,
            search, adds_to, stated_by, spatial, sides, axes, once: as there.
        role: as in `Quantity`; default: `angle` in radians, else `size`.

    Raises:
        ValueError: the tolerance or the natural size is not positive, a range is empty, or beyond
            is no probability.
    """
    if not lower < upper or (search is not None and not search[0] < search[1]):
        raise ValueError(f"{description}: the range is empty")
    for what, value in (("tolerance", tolerance), ("natural", natural)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{description}: {what} is {value}; it must be positive")
    if not 0.0 <= beyond < 1.0:
        raise ValueError(f"{description}: beyond is {beyond}; it must be a probability below 1")
    data = {
        "unit": unit, "lower": lower, "upper": upper, "description": description, "array": array,
        "counts": counts, "role": role or ("angle" if unit == "rad" else "size"),
        "tolerance": tolerance, "beyond": beyond, "natural": natural, "search": search,
        "adds_to": adds_to, "stated_by": stated_by, "spatial": spatial, "sides": sides,
        "axes": axes, "once": once,
    }  # fmt: skip
    several = bool(counts) and counts[0] > 1
    return field(default=(neutral,) * counts[0] if several else neutral, metadata=data)


def described(made: Field[Any]) -> Quantity:
    """The parameter that a dataclass field stands for."""
    default: Any = made.default
    neutral = default[0] if isinstance(default, tuple) else default
    return Quantity(made.name, neutral, **made.metadata)
