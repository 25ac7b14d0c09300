# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects and single numbers as text for people: clauses, degrees, millimetres, grams."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dlo_ros.effects import Quantity, effects, quantities
from dlo_ros.errors import ParameterError
from dlo_ros.report.elements import measured, millimetres, number

AXES = {2: "xz", 3: "xyz"}
"""Names of the components of a vector, by their number, where its parameter has none."""
RIGHT_HAND = "by the right-hand rule"
"""Sign of a turn about an axis, for which there is no word."""
ALONG = {0.0: "at the start", 0.5: "in the middle", 1.0: "at the end"}
"""Places along the DLO that have a word, by their share of the length from its start."""
SMALL = 1.0
"""Mass [kg] or time [s] below which it is printed in thousandths."""


def title(effect: str, side: str = "") -> str:
    """Title of an effect.

    Args:
        side: word for the side of neutral on which it is; empty: not known.
    """
    known = effects().get(effect)
    return known.called(side) if known else effect.replace("_", " ")


def clause(effect: str, side: str = "") -> str:
    """Clause on an effect; its name where the effect is not known (any more).

    Args:
        side: word for the side of neutral on which it is; empty: not known.
    """
    known = effects().get(effect)
    if known is None:
        return f"there is an effect of {effect.replace('_', ' ')}"
    return known.report_phrase(side)


def remedy(effect: str) -> str:
    """Sentence on what a person can do by hand about an effect; empty: nothing is known."""
    known = effects().get(effect)
    return known.remedy if known else ""


def positive(q: Quantity | None, index: int | None = None, count: int = 1) -> str:
    """Words for what a positive number means in the files; empty: there are none.

    Args:
        q: the parameter; None: not known (any more).
        index: index of the number in a parameter of several; None: it is the only one.
        count: how many numbers the parameter has.
    """
    if q is None:
        return ""
    word = q.side(q.neutral + 1.0, index, count)
    if word:
        return f"above {q.neutral:g}: {word}" if q.neutral else word
    return RIGHT_HAND if q.sides and q.unit == "rad" else ""


def amount(value: float, std: float | None, unit: str, *, sparing: bool = True) -> str:
    """A number with its standard deviation in readable units, to as many digits; see `measured`."""
    factor, shown = readable(value, unit)
    if std is None or not math.isfinite(std) or std <= 0.0:
        return f"{number(factor * value)} +- unknown {shown}".rstrip()
    return measured(factor * value, factor * std, shown, sparing=sparing)


def bare(value: float, unit: str) -> str:
    """A number in readable units, such as a tolerance; without a unit in per cent."""
    factor, shown = readable(value, unit) if unit else (100.0, "%")
    return number(factor * value, shown, 2)


def interval(first: float, last: float, unit: str) -> str:
    """Two numbers in the readable unit of the larger one."""
    factor, shown = readable(max(abs(first), abs(last)), unit) if unit else (100.0, "%")
    return f"{number(factor * first, digits=2)} to {number(factor * last, shown, 2)}"


def spread(low: float, high: float, unit: str, q: Quantity | None) -> str:
    """The smallest and the largest of several numbers along the DLO, as one where they are alike.

    Words for their sides stand in the place of signs where there are some.

    Args:
        q: the parameter; None: not known (any more).
    """
    sides = [q.side(v) if q else "" for v in (low, high)]
    if sides[0] != sides[1]:
        ends = [f"{number(abs(v), unit, 2)} {s}" for v, s in zip((low, high), sides, strict=True)]
        return f"from {' to '.join(ends)}"
    if sides[0]:
        low, high = sorted((abs(low), abs(high)))
    if number(low, digits=2) == number(high, digits=2):
        return " ".join(filter(None, [number(high, unit, 2), sides[0], "everywhere"]))
    return f"from {number(low, digits=2)} to {number(high, unit, 2)} {sides[0]}".rstrip()


def readable(value: float, unit: str) -> tuple[float, str]:
    """Readable unit for a value in an SI unit: its factor and name."""
    if unit == "rad":
        return 180.0 / math.pi, "degrees"
    if unit == "m":
        return 1e3, "mm"
    if unit in ("kg", "s") and abs(value) < SMALL:
        return 1e3, {"kg": "g", "s": "ms"}[unit]
    return 1.0, unit


def off_by(
    value: float, std: float | None, effect: str, key: str, index: int | None = None, count: int = 1
) -> str:
    """Difference of a number from its expected value, such as 2.1 +- 0.3 mm shorter.

    Without a unit it is in per cent; a sign tells the side where there is no word for it.

    Args:
        value, std: the number and its standard deviation.
        effect, key: names of the effect and of its parameter.
        index: index of the number in a parameter of several; None: it is the only one.
        count: how many numbers the parameter has.
    """
    q = quantity_of(effect, key)
    neutral, unit = (q.neutral, q.unit) if q else (0.0, "")
    if unit:
        return sided(value - neutral, std, unit, q.side(value, index, count) if q else "")
    percentage = None if std is None else 100.0 * std
    side = q.side(value, index, count) if q else ""
    return sided(100.0 * (value - neutral), percentage, "%", side)


def sided(value: float, std: float | None, unit: str, side: str) -> str:
    """A number with its standard deviation, and the word for its side in the place of its sign.

    Args:
        side: the word; empty: there is none, and the sign stays.
    """
    return f"{amount(abs(value), std, unit)} {side}" if side else amount(value, std, unit)


def label(name: str, count: int = 1) -> str:
    """A number of the set-up, `EFFECT.KEY` or `EFFECT.KEY[I]`, in words.

    Args:
        count: number of values that KEY has.
    """
    effect, _, full = name.partition(".")
    key, _, index = full.partition("[")
    words = [title(effect)]
    q = quantity_of(effect, key)
    known = effects().get(effect)
    several = () if known is None else known.quantities()
    of_plane = [other for other in several if not other.spatial]
    if q is not None and len(several) > 1 and (len(of_plane) > 1 or q.spatial):
        words.append(q.description.split(":")[0].split(",")[0])
    if index:
        words.append(component(q, int(index.rstrip("]")), count))
    return ", ".join(dict.fromkeys(words))


def component(q: Quantity | None, index: int, count: int) -> str:
    """Words for a number of a parameter that has several.

    Args:
        q: the parameter; None: not known (any more).
        index, count: index of the number, and how many there are.
    """
    if q is not None and q.counts:
        axes = q.axes or AXES.get(count, "")
        return axes[index] if axes else str(index + 1)
    share = index / max(count - 1, 1)
    return ALONG.get(share, f"at {100.0 * share:.0f} % of the length")


def quantity_of(effect: str, key: str) -> Quantity | None:
    """A parameter of an effect; None where either is not known (any more)."""
    try:
        return quantities(effect).get(key)
    except ParameterError:
        return None


def either(phrases: Sequence[str]) -> str:
    """Text that joins phrases of which one holds."""
    return "; or ".join(phrases)


def mm(metres: float | None, digits: int = 2) -> str:
    """A length in millimetres, to two digits unless more are wanted."""
    return "unknown" if metres is None else millimetres(metres, digits=digits)
