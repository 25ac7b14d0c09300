# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The numbers of a set-up, as far as a diagnosis has determined them, as lines of a table."""

from __future__ import annotations

from collections import Counter

from dlo_ros.cli.effect_words import amount, bare, label, off_by, positive
from dlo_ros.diagnosis import Diagnosis, SetupNumber
from dlo_ros.effects import effects, quantities
from dlo_ros.inference.parameter import split_name
from dlo_ros.inference.thresholds import BEYOND, CERTAIN
from dlo_ros.report.diagnosis_content import SetupRow

NOT_DETERMINED = "not determined"
IF_DENSITY = ", at the extended file's density"
"""Condition under which a number is known of which the data determine the ratio to the density."""
GUESSED = "none"
"""Tolerance of what nobody states beforehand, such as a damping that is only guessed."""


def setup_lines(found: Diagnosis) -> tuple[SetupRow, ...]:
    """Lines on the numbers of the set-up, the most clearly wrong first.

    Notably off is what differs from neutral for certain, and what lies far beyond its tolerance as
    fitted, of which the data determine less. Those of an effect that is named stand among the
    causes.
    """
    labels = labels_of(found)
    counts = _counts(found)
    named = {e.name for e in found.effects}
    numbers = {k: n for k, n in found.setup.items() if split_name(k)[0] not in named}
    off = {name: _deviations(name, n) for name, n in numbers.items()}
    notable = {name: off[name] > CERTAIN or is_far_off(name, n) for name, n in numbers.items()}
    return tuple(
        _row(name, labels[name], numbers[name], counts[name], notable=notable[name])
        for name in sorted(off, key=lambda name: (not notable[name], -off[name]))
    )


def set_up_is_off(found: Diagnosis) -> bool:
    """Whether a number of the set-up is notably off."""
    return any(row.notable for row in setup_lines(found))


def _counts(found: Diagnosis) -> dict[str, int]:
    """Number of values that the key of each number of the set-up has, by its name."""
    keys = {name: name.partition("[")[0] for name in found.setup}
    counts = Counter(keys.values())
    return {name: counts[key] for name, key in keys.items()}


def labels_of(found: Diagnosis) -> dict[str, str]:
    """Label of each number of the set-up, by its name; keys with several values are numbered."""
    return {name: label(name, count) for name, count in _counts(found).items()}


def _deviations(name: str, n: SetupNumber) -> float:
    """Difference of a number from its expected value, in standard deviations.

    A place or a time has no expected value, and what the data do not determine is not off.
    """
    effect, key, _ = split_name(name)
    std = n.std or n.held_std
    if not std or not quantities(effect)[key].from_neutral:
        return 0.0
    return distance_off(name, n) / std


def is_far_off(name: str, n: SetupNumber) -> bool:
    """Whether a number lies far beyond its tolerance, certain or not, see `BEYOND`."""
    return n.tolerance is not None and distance_off(name, n) > BEYOND * n.tolerance


def distance_off(name: str, n: SetupNumber) -> float:
    """Distance of a number from neutral, in its unit."""
    effect, key, _ = split_name(name)
    return abs(n.value - quantities(effect)[key].neutral)


def _row(name: str, text: str, n: SetupNumber, count: int, *, notable: bool) -> SetupRow:
    """A number of the set-up in words.

    Args:
        text: its label.
        count: how many numbers its parameter has.
    """
    effect, key, index = split_name(name)
    std = n.std or n.held_std
    if std is None or (n.tolerance is None and std > CERTAIN * distance_off(name, n)):
        off = NOT_DETERMINED
    elif not quantities(effect)[key].from_neutral:
        off = amount(n.value, n.std, n.unit)
    else:
        off = off_by(n.value, std, effect, key, index, count)
        if n.std is None:
            off += IF_DENSITY
    tolerance = GUESSED if n.tolerance is None else bare(n.tolerance, n.unit)
    above = positive(quantities(effect)[key], index, count)
    return SetupRow(text, off, tolerance, notable, effects()[effect].group, above)
