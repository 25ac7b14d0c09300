# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that a diagnosis names, with all their numbers, as text for people."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dlo_ros.cli.effect_words import (
    amount,
    bare,
    clause,
    component,
    interval,
    positive,
    quantity_of,
    readable,
    remedy,
    sided,
    spread,
    title,
)
from dlo_ros.diagnosis import NamedEffect, Number
from dlo_ros.effects import Quantity, effects
from dlo_ros.report.elements import number

SPATIAL = 3
"""Components of a vector in space, each of which is named by its axis."""
ENDS = ("start", "end")
SIZES = ("size", "angle", "ratio")
"""Roles of the numbers that say how much there is of an effect."""
LOOK = "Of causes that the data do not tell apart, look first which of them is there."
CLEAR_STDS = 2.0
"""Standard deviations from neutral, below which a size may as well be none."""


def _is_clear(value: float, std: float, q: Quantity) -> bool:
    """Whether a number is clearly not neutral."""
    return abs(value - q.neutral) > CLEAR_STDS * std


def _is_beside(value: float, std: float, q: Quantity) -> bool:
    """Whether a number clearly is on its side of neutral, as a fit sees it: by its logarithm, a
    ratio of 11 +- 10 is as far from 1 as one of 1 / 11 is, and not less.
    """
    seen = std / value if q.logarithmic else std
    return abs(q.transformed(value) - q.transformed(q.neutral)) > CLEAR_STDS * seen


def clear_side(effect: NamedEffect) -> str:
    """Word for the side of neutral on which an effect clearly is; empty: there is none."""
    for key, n in effect.parameters.items():
        q = quantity_of(effect.name, key)
        if q is None or isinstance(n.value, tuple) or isinstance(n.std, tuple):
            continue
        side = q.side(n.value)
        if side and (n.std is None or _is_beside(n.value, n.std, q)):
            return side
    return ""


def values(effect: NamedEffect, length: float) -> str:
    """All numbers of an effect in one phrase, but for a form that the data hardly tell.

    Args:
        length: length of the DLO [m].
    """
    side = clear_side(effect)
    said = side if clause(effect.name, side) != clause(effect.name) else ""
    numbers = [(k, n) for k, n in effect.parameters.items() if not _is_faint(effect.name, k, n)]
    texts = [_value(effect.name, key, n, length, said) for key, n in numbers]
    differing = any(n.own for _, n in numbers)
    return ", ".join([*texts, *(["depending on the recording"] if differing else [])])


def _is_faint(effect: str, key: str, n: Number) -> bool:
    """Whether a number tells of a form only, such as how tapered an end is, and may be neutral."""
    q = quantity_of(effect, key)
    if q is None or q.role != "extent" or q.unit or not isinstance(n.value, float):
        return False
    return isinstance(n.std, float) and not _is_clear(n.value, n.std, q)


def rows(effect: NamedEffect, length: float) -> list[tuple[str, str, str]]:
    """Name, value and meaning of each number of an effect; a vector has one for each component.

    A value has the word of its side in the place of a sign, as in a sentence. The meaning says
    which side is positive in the files.

    Args:
        length: length of the DLO [m].
    """
    table = []
    for key, n in effect.parameters.items():
        q = quantity_of(effect.name, key)
        meaning = q.description if q else ""
        several = isinstance(n.value, tuple)
        found = n.value if isinstance(n.value, tuple) else (n.value,)
        stds = n.std if isinstance(n.std, tuple) else (n.std,) * len(found)
        for k, (value, std) in enumerate(zip(found, stds, strict=True)):
            name = f"{key}, {component(q, k, len(found))}" if several else key
            index = k if several else None
            told = is_determined(value, std, q, length)
            side = q.side(value, index, len(found)) if q and told else ""
            signless = bool(q and side and not q.neutral)
            shown = _known(abs(value) if signless else value, std, n.unit, q, length, sparing=False)
            if n.own:
                shown = ", ".join(f"{bare(x, n.unit)} in {name}" for name, x in n.own.items())
            if side:
                shown += f" {side}" if signless else f" ({side})"
            above = positive(q, index, len(found))
            sign = f"positive: {above}" if above and q and not q.neutral else above
            words = ("" if k else meaning, sign)
            table.append((name, shown, "; ".join(filter(None, words))))
    return table


def remedies(causes: Sequence[NamedEffect]) -> tuple[str, ...]:
    """Remedies by hand for causes and their rivals, a sentence or two for each."""
    named = {e.name: title(e.name, clear_side(e)) for e in causes}
    named |= {r: title(r) for e in causes for r in e.rivals if r not in named}
    told = [f"{what}: {remedy(name)}" for name, what in named.items() if remedy(name)]
    first = [LOOK] if told and len(named) > len(causes) else []
    return (*first, *(f"{text[0].upper()}{text[1:]}" for text in told))


def is_determined(value: float, std: float | None, q: Quantity | None, length: float) -> bool:
    """Whether the data determine a number at all.

    A place is not determined where it is spread as far as anywhere along the DLO. A number that
    means nothing by being zero, such as a radius or a ratio, is not where it is as uncertain as it
    is large.

    Args:
        length: length of the DLO [m].
    """
    if q is None or std is None or not math.isfinite(std):
        return True
    if q.role in ("place", "point"):
        return q.unit != "m" or std < length / math.sqrt(12.0)  # of what lies anywhere on it
    return (q.neutral == 0.0 and q.role != "extent") or std < abs(value)


def is_sized(effect: NamedEffect, length: float) -> bool:
    """Whether the data determine how strong an effect is, and not only that it acts.

    A peg or a wall that is hit has a place, and no strength.

    Args:
        length: length of the DLO [m].
    """
    if not effects()[effect.name].differentiable:
        return True
    sizes = []
    for key, n in effect.parameters.items():
        q = quantity_of(effect.name, key)
        if q is None or q.role not in SIZES or not q.is_strength:
            continue
        found = n.value if isinstance(n.value, tuple) else (n.value,)
        stds = n.std if isinstance(n.std, tuple) else (n.std,) * len(found)
        sizes += [
            std is None or not math.isfinite(std) or (
                is_determined(value, std, q, length) and _is_clear(value, std, q)
            )
            for value, std in zip(found, stds, strict=True)
        ]  # fmt: skip
    return any(sizes) or not sizes


def _known(
    value: float, std: float | None, unit: str, q: Quantity | None, length: float, *,
    sparing: bool = True,
) -> str:  # fmt: skip
    """A number with its standard deviation, or the statement that the data do not determine it.

    Args:
        sparing: whether it stands in a sentence, where fewer digits are enough.
    """
    percentage = q is not None and q.role == "size" and not unit
    factor, shown = (100.0, "%") if percentage else (1.0, unit)
    if not is_determined(value, std, q, length):
        scale, unit_shown = readable(value, shown)
        fitted = f" ({number(scale * factor * value, unit_shown, 2)} in the file)"
        return f"not determined{'' if sparing else fitted}"
    std = None if std is None else factor * std
    return amount(factor * value, std, shown, sparing=sparing)


def _value(effect: str, key: str, n: Number, length: float, said: str) -> str:
    """A number of an effect in a phrase.

    Args:
        length: length of the DLO [m].
        said: word for its side that the clause before already has; empty: there is none.
    """
    words, where = key.replace("_", " "), ""
    q = quantity_of(effect, key)
    if q is not None and q.role == "place":
        words, where = "at", "" if n.unit == "s" else " from the start"
    elif key in ENDS:
        words = f"at the {key}"
    if n.own:
        return f"{words} {interval(min(n.own.values()), max(n.own.values()), n.unit)}"
    if not isinstance(n.value, tuple):
        assert n.std is None or isinstance(n.std, float)
        side = q.side(n.value) if q is not None and not q.neutral else ""
        shown = _known(abs(n.value) if side else n.value, n.std, n.unit, q, length)
        if not is_determined(n.value, n.std, q, length):
            return f"{'where' if where else words} {shown}"
        if not side:
            return f"{words} {shown}{where}"
        if side == said:
            return f"by {shown}"
        # The side tells which number it is, but for those of the two ends.
        return f"{words} {shown} {side}" if key in ENDS else f"{shown} {side}"
    stds = n.std if isinstance(n.std, tuple) else (None,) * len(n.value)
    if q is not None and q.counts:
        parts = []
        for k, (v, s) in enumerate(zip(n.value, stds, strict=True)):
            side = q.side(v, k, len(n.value))
            plain = side and len(n.value) < SPATIAL  # the side tells the axis of the plane
            axis = "" if plain else f"{component(q, k, len(n.value))} "
            parts.append(f"{axis}{sided(v, s, n.unit, side)}")
        return f"{words} {', '.join(parts)}"
    low, high = min(n.value), max(n.value)
    known = [s for s in stds if s is not None and math.isfinite(s)]
    each = f", each +- {number(float(np.median(known)), digits=1)}" if known else ""
    return f"{words} {spread(low, high, n.unit, q)}{each}"
