# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The loads on the DLO and its grips in each recording, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dlo_ros.report.elements import UNKNOWN, number, paragraph, table

LONGEST_RADIUS = 1e3
"""Bend radius [m] beyond which a DLO is called straight."""
WORDS = (
    "The largest loads on the DLO and its grips in the model, at the pictures' instants; they are "
    "not measured. The grips are led along a smooth path through the points of the commands, which "
    "would accelerate them in an instant at each corner between straight pieces. Where the DLO is "
    "pulled taut, a millimetre of its length or of the distance of its grips changes much. Forces "
    "are those of the grips on the DLO. The simulator publishes the same live, with an alarm "
    "beyond limits.tension and limits.bend_radius."
)


@dataclass(frozen=True)
class LoadRow:
    """One recording.

    Args:
        name: name of the bag.
        tension: largest [N].
        bend_radius: smallest [m].
        start, end: largest force of the grip there [N]; None where that end is free.
    """

    name: str
    tension: float
    bend_radius: float
    start: float | None
    end: float | None


def loads_table(rows: Sequence[LoadRow]) -> str:
    """The table with its words."""
    head = [
        "recording", "largest tension", "smallest bend radius", "force of the grip at the start",
        "at the end",
    ]  # fmt: skip
    cells = [
        [r.name, number(r.tension, "N", 2), _radius(r.bend_radius), _force(r.start), _force(r.end)]
        for r in rows
    ]
    return table(head, cells) + paragraph(WORDS)


def _radius(radius: float) -> str:
    return "straight" if radius > LONGEST_RADIUS else number(1e3 * radius, "mm")


def _force(force: float | None) -> str:
    return UNKNOWN if force is None else number(force, "N", 2)
