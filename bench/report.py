# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rows of the comparison, as JSON and as a table on the terminal."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Row:
    """One goal.

    Args:
        name: the goal: the quantity that is measured.
        ours, unit: our value; None where no setting of ours reaches the error.
        peer, peer_value: whom or what it is held against; None where the peer has no setting.
        goal: largest ratio of ours to the peer's that meets it.
    """

    name: str
    ours: float | None
    unit: str
    peer: str
    peer_value: float | None
    goal: float

    @property
    def ratio(self) -> float | None:
        """Ours over the peer's."""
        if self.ours is None or self.peer_value is None:
            return None
        return self.ours / self.peer_value

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None where there is nothing to hold it against."""
        if self.ours is None:
            return False
        return None if self.ratio is None else self.ratio <= self.goal


def write(path: Path, rows: Sequence[Row], details: Mapping[str, Any]) -> None:
    """Write the rows to `path`, and all that led to them to `*_details.json` beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table = [
        {
            "name": row.name, "ours": row.ours, "unit": row.unit, "peer": row.peer,
            "peer_value": row.peer_value, "ratio": row.ratio, "goal": row.goal,
        }
        for row in rows
    ]  # fmt: skip
    path.write_text(json.dumps(table, indent=1) + "\n")
    beside = path.with_name(f"{path.stem}_details.json")
    beside.write_text(json.dumps(details, indent=1, default=_plain) + "\n")


def _plain(value: Any) -> Any:
    if hasattr(value, "__dataclass_fields__"):
        return asdict(value)
    return value.item() if hasattr(value, "item") else str(value)


def show(console: Console, rows: Sequence[Row]) -> None:
    """The table of goals, missed ones named as such."""
    table = Table(title="Goals: ratio = ours / peer, met where ratio <= goal")
    for name in ("measurement", "ours", "unit", "peer", "peer's", "ratio", "goal", ""):
        table.add_column(
            name, justify="left" if name in ("measurement", "peer", "unit") else "right"
        )
    words = {True: "[green]met[/]", False: "[red]missed[/]", None: "[yellow]no peer[/]"}
    for row in rows:
        table.add_row(
            row.name, number(row.ours), row.unit, row.peer, number(row.peer_value),
            number(row.ratio), number(row.goal), words[row.met],
        )  # fmt: skip
    console.print(table)


def number(value: float | None) -> str:
    """Three digits, or a dash."""
    return "-" if value is None else f"{value:.3g}"
