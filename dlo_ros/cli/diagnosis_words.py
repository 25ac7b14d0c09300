# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects and their numbers as text for people: sentences, degrees, millimetres, grams."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis import NamedEffect, Number
from dlo_ros.effects import Quantity, effects, quantities
from dlo_ros.errors import ParameterError
from dlo_ros.report.elements import measured, millimetres, number

AXES = {2: "xz", 3: "xyz"}
"""Names of the components of a vector, by their number."""
SIZES = ("size", "angle", "ratio")
"""Roles of the numbers that say how much there is of an effect."""
CLEAR_STDS = 2.0
"""Standard deviations from neutral, below which a size may as well be none."""
SMALL = 1.0
"""Mass [kg] or time [s] below which it is printed in thousandths."""


def title(effect: str) -> str:
    """Title of an effect."""
    known = effects().get(effect)
    return known.called() if known else effect.replace("_", " ")


def clause(effect: str) -> str:
    """Clause on an effect; its name where the effect is not known (any more)."""
    known = effects().get(effect)
    return known.report_phrase() if known else f"there is an effect of {effect.replace('_', ' ')}"


def amount(value: float, std: float | None, unit: str, *, sparing: bool = True) -> str:
    """A number with its standard deviation in readable units, to as many digits; see `measured`."""
    factor, shown = _units(value, unit)
    if std is None or not math.isfinite(std) or std <= 0.0:
        return f"{number(factor * value)} +- unknown {shown}".rstrip()
    return measured(factor * value, factor * std, shown, sparing=sparing)


def bare(value: float, unit: str) -> str:
    """A number in readable units, such as a tolerance; without a unit in per cent."""
    factor, shown = _units(value, unit) if unit else (100.0, "%")
    return number(factor * value, shown, 2)


def _units(value: float, unit: str) -> tuple[float, str]:
    """Readable unit for a value in an SI unit: its factor and name."""
    if unit == "rad":
        return 180.0 / math.pi, "degrees"
    if unit == "m":
        return 1e3, "mm"
    if unit in ("kg", "s") and abs(value) < SMALL:
        return 1e3, {"kg": "g", "s": "ms"}[unit]
    return 1.0, unit


def off_by(value: float, std: float | None, effect: str, key: str) -> str:
    """Difference of a number from its expected value; without a unit in per cent."""
    q = _quantity(effect, key)
    neutral, unit = (q.neutral, q.unit) if q else (0.0, "")
    if unit:
        return amount(value - neutral, std, unit)
    return amount(100.0 * (value - neutral), None if std is None else 100.0 * std, "%")


def label(name: str, count: int = 1) -> str:
    """A number of the set-up, `EFFECT.KEY` or `EFFECT.KEY[I]`, in words.

    Args:
        count: number of values that KEY has.
    """
    effect, _, full = name.partition(".")
    key, _, index = full.partition("[")
    words = [title(effect)]
    q = _quantity(effect, key)
    known = effects().get(effect)
    of_plane = [] if known is None else [other for other in known.quantities() if not other.spatial]
    if q is not None and (len(of_plane) > 1 or q.spatial):
        words.append(q.description.split(":")[0].split(",")[0])
    if index:
        words.append(_component(q, int(index.rstrip("]")), count))
    return ", ".join(dict.fromkeys(words))


def _component(q: Quantity | None, index: int, count: int) -> str:
    if q is not None and q.counts:
        return AXES[count][index] if count in AXES else str(index + 1)
    return f"{index + 1} of {count} along u"


def _quantity(effect: str, key: str) -> Quantity | None:
    try:
        return quantities(effect).get(key)
    except ParameterError:
        return None


def values(effect: NamedEffect, length: float) -> str:
    """All numbers of an effect in one phrase.

    Args:
        length: length of the DLO [m].
    """
    return ", ".join(_value(effect.name, key, n, length) for key, n in effect.parameters.items())


def rows(effect: NamedEffect, length: float) -> list[tuple[str, str, str]]:
    """Name, value and meaning of each number of an effect; a vector has one for each component.

    Args:
        length: length of the DLO [m].
    """
    table = []
    for key, n in effect.parameters.items():
        q = _quantity(effect.name, key)
        meaning = q.description if q else ""
        several = isinstance(n.value, tuple)
        found = n.value if isinstance(n.value, tuple) else (n.value,)
        stds = n.std if isinstance(n.std, tuple) else (n.std,) * len(found)
        for k, (value, std) in enumerate(zip(found, stds, strict=True)):
            name = f"{key}, {_component(q, k, len(found))}" if several else key
            shown = _known(value, std, n.unit, q, length, sparing=False)
            table.append((name, shown, "" if k else meaning))
    return table


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

    Args:
        length: length of the DLO [m].
    """
    sizes = []
    for key, n in effect.parameters.items():
        q = _quantity(effect.name, key)
        if q is None or q.role not in SIZES:
            continue
        found = n.value if isinstance(n.value, tuple) else (n.value,)
        stds = n.std if isinstance(n.std, tuple) else (n.std,) * len(found)
        sizes += [
            std is None or not math.isfinite(std) or (
                is_determined(value, std, q, length)
                and abs(value - q.neutral) > CLEAR_STDS * std
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
        scale, readable = _units(value, shown)
        fitted = f" ({number(scale * factor * value, readable, 2)} in the file)"
        return f"not determined{'' if sparing else fitted}"
    std = None if std is None else factor * std
    return amount(factor * value, std, shown, sparing=sparing)


def _value(effect: str, key: str, n: Number, length: float) -> str:
    words = key.replace("_", " ")
    q = _quantity(effect, key)
    if q is not None and q.role == "place":
        words = "at u ="
    elif key in ("start", "end"):
        words = f"at the {key}"
    if not isinstance(n.value, tuple):
        assert n.std is None or isinstance(n.std, float)
        return f"{words} {_known(n.value, n.std, n.unit, q, length)}"
    stds = n.std if isinstance(n.std, tuple) else (None,) * len(n.value)
    if q is not None and q.counts:
        parts = [
            f"{_component(q, k, len(n.value))} {amount(v, s, n.unit)}"
            for k, (v, s) in enumerate(zip(n.value, stds, strict=True))
        ]
        return f"{words} {', '.join(parts)}"
    low, high = min(n.value), max(n.value)
    known = [s for s in stds if s is not None and math.isfinite(s)]
    each = f", each +- {number(float(np.median(known)), digits=1)}" if known else ""
    return f"{words} from {number(low, digits=2)} to {number(high, digits=2)} {n.unit}{each}"


def either(phrases: Sequence[str]) -> str:
    """Text that joins phrases of which one holds."""
    return "; or ".join(phrases)


def mm(metres: float | None) -> str:
    """A length in millimetres to two digits."""
    return "unknown" if metres is None else millimetres(metres, digits=2)


def percent(share: float) -> str:
    """A share in per cent, never all or nothing by rounding alone."""
    if 0.99 < share < 1.0:
        return "over 99 %"
    return "under 1 %" if 0.0 < share < 0.01 else f"{100.0 * share:.0f} %"
