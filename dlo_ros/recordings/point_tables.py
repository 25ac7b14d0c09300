# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Points of another tracker as tables: a line for each point, CSV or Parquet.

Columns are `stamp_ns` or `time_s`, `x`, `y`, `z` [m] in the board's frame and, where the tracker
states them, `u` and `std` [m]. Lines of one instant are one list, in any order.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import InputError
from dlo_ros.observation import PointList
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.lerobot import library
from dlo_ros.recordings.message_building import BAG_MESSAGES, cloud_message, command_message
from dlo_ros.recordings.table_rows import (
    PLACE,
    STAMP,
    TIME,
    Row,
    check_clocks,
    measured,
    rows_of,
)
from dlo_ros.recordings.tables import read_commands, write_by_stamp
from dlo_ros.recordings.write import BagWriter

OPTIONAL = ("u", "std")
"""Columns that a tracker may leave away."""


def read_point_tables(
    inputs: Sequence[Path], settings: Settings
) -> tuple[tuple[Command, ...], tuple[PointList, ...]]:
    """Lists of points, and commands where a file has them.

    Args:
        inputs: CSV and Parquet files; one with a column `name` is a `command.csv`.
        settings: settings with the number of control points and the frame of the commands.

    Raises:
        InputError: a file is unusable, or none has points.
    """
    commands: list[Command] = []
    lists: list[PointList] = []
    for path in inputs:
        rows = parquet_rows(path) if path.suffix.lower() == ".parquet" else rows_of(path, ())
        if "name" in rows[0]:
            commands += read_commands(path, settings)
        else:
            lists += _lists(path, rows)
    if not lists:
        named = ", ".join(map(str, inputs))
        raise InputError(f"{named}: no file has points; columns {TIME}, {', '.join(PLACE)}")
    commands.sort(key=lambda c: c.stamp)
    lists.sort(key=_form)
    joined = tuple(_joined(list(parts)) for _, parts in groupby(lists, key=_form))
    check_clocks(inputs, commands, [points.stamp for points in joined])
    return tuple(commands), joined


def _form(points: PointList) -> tuple[int, bool, bool]:
    """The instant of a list and what it states: lists that have both in common are one."""
    return points.stamp, points.u is None, points.std is None


def _joined(parts: Sequence[PointList]) -> PointList:
    """Lists of one form from several files as one."""
    u = [p.u for p in parts if p.u is not None]
    std = [p.std for p in parts if p.std is not None]
    return replace(
        parts[0],
        positions=np.concatenate([p.positions for p in parts]),
        u=np.concatenate(u) if u else None,
        std=np.concatenate(std) if std else None,
    )


def parquet_rows(path: Path) -> list[Row]:
    """The rows of a Parquet file as those of a CSV file; dates and durations become stamps.

    Raises:
        InputError: it cannot be read, or has no row.
    """
    parquet, arrow = library(), importlib.import_module("pyarrow")
    try:
        table: Any = parquet.read_table(path)
        columns = [
            _cells(arrow, name, column)
            for name, column in zip(table.column_names, table.columns, strict=True)
        ]
    except (OSError, ValueError, NotImplementedError) as err:  # pyarrow's own errors are such
        raise InputError(f"{path}: cannot be read as Parquet ({err})") from err
    if not len(table):
        raise InputError(f"{path}: has no row")
    names = [name for name, _ in columns]
    return [
        Row(f"row {k}", dict(zip(names, cells, strict=True)))
        for k, cells in enumerate(zip(*(cells for _, cells in columns), strict=True))
    ]


def _cells(arrow: Any, name: str, column: Any) -> tuple[str, list[str]]:
    """Name and cells of a column of pyarrow as a CSV file would have them, '' where there is none.

    Dates are nanoseconds, durations seconds, and stamps that pandas holds as floats whole numbers.
    """
    form, kind = "{}", column.type
    if arrow.types.is_timestamp(kind):
        name = STAMP if name == TIME else name
        column = column.cast(arrow.timestamp("ns", kind.tz)).cast("int64")
    elif arrow.types.is_duration(kind):
        form, column = "{}e-9", column.cast(arrow.duration("ns")).cast("int64")
    elif arrow.types.is_floating(kind) and name == STAMP:
        form = "{:.0f}"
    return name, ["" if v is None else form.format(v) for v in column.to_pylist()]


def _lists(path: Path, rows: Sequence[Row]) -> list[PointList]:
    missing = [name for name in PLACE if name not in rows[0]]
    if missing:
        raise InputError(
            f"{path}: has no column {', '.join(missing)} (it has {', '.join(rows[0])}); it must "
            f"have {STAMP} or {TIME}, {', '.join(PLACE)}"
        )
    names = (*PLACE, *(name for name in OPTIONAL if name in rows[0]))
    at, values = measured(path, rows, names)
    order = np.argsort(at, kind="stable")
    at, values = at[order], values[order]
    result = []
    for part in np.split(np.arange(len(at)), np.flatnonzero(np.diff(at)) + 1):
        own = dict(zip(names[3:], values[part, 3:].T, strict=True))
        result.append(PointList(int(at[part[0]]), values[part, :3], own.get("u"), own.get("std")))
    return result


def write_points_bag(
    output: Path,
    settings: Settings,
    commands: Sequence[Command],
    lists: Sequence[PointList],
    *,
    force: bool = False,
) -> None:
    """Write commands and lists of points as a bag.

    Args:
        output: the bag.
        settings: settings whose `frame_id` the messages carry.
        commands: commands by growing stamp.
        lists: lists of points by growing stamp.
        force: whether an older bag is replaced.

    Raises:
        InputError: it cannot be written, or a number is unusable.
    """
    messages = [(topics.COMMAND, command_message(BAG_MESSAGES, c)) for c in commands]
    for each in lists:
        optional = {"u": each.u, "std": each.std}
        names = [*PLACE, *(n for n, values in optional.items() if values is not None)]
        columns = [each.positions, *(v for v in optional.values() if v is not None)]
        cloud = cloud_message(
            BAG_MESSAGES, each.stamp, settings.frame_id, names, np.column_stack(columns)
        )
        messages.append((topics.POINTS, cloud))
    with BagWriter(output, force=force) as writer:
        write_by_stamp(writer, messages)
