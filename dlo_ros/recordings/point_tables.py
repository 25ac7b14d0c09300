# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Points of another tracker as tables: a line for each point, CSV or Parquet.

Columns are `stamp_ns` or `time_s`, `x`, `y`, `z` [m] in the board's frame and, where the tracker
states them, `u` and `std` [m]. Lines of one instant are one list, in any order.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import InputError
from dlo_ros.observation import PointList
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.lerobot import library
from dlo_ros.recordings.message_building import BAG_MESSAGES, cloud_message, command_message
from dlo_ros.recordings.tables import (
    LONGEST,
    ORIGIN,
    STAMP,
    TIME,
    numbers,
    read_commands,
    rows_of,
    stamps,
    write_by_stamp,
)
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import FloatArray

PLACE = ("x", "y", "z")
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
        if path.suffix != ".parquet" and "name" in rows_of(path, ())[0]:
            commands += read_commands(path, settings)
        else:
            lists += _lists(path, *(_parquet if path.suffix == ".parquet" else _csv)(path))
    if not lists:
        named = ", ".join(map(str, inputs))
        raise InputError(f"{named}: no file has points; columns {TIME}, {', '.join(PLACE)}")
    at = [c.stamp for c in commands] + [points.stamp for points in lists]
    if max(at) - min(at) > LONGEST * NANOSECONDS:
        raise InputError(
            f"{', '.join(map(str, inputs))}: the times are of different clocks, more than "
            f"{LONGEST:.0e} s apart; give absolute times in every file, or relative ones in every"
        )
    return (
        tuple(sorted(commands, key=lambda c: c.stamp)),
        tuple(sorted(lists, key=lambda points: points.stamp)),
    )


def _csv(path: Path) -> tuple[NDArray[np.int64], dict[str, FloatArray]]:
    rows = rows_of(path, PLACE)
    names = (*PLACE, *(name for name in OPTIONAL if name in rows[0]))
    table = numbers(path, rows, names)
    at = np.array(stamps(path, rows), dtype=np.int64)
    return at, {name: table[:, k] for k, name in enumerate(names)}


def _parquet(path: Path) -> tuple[NDArray[np.int64], dict[str, FloatArray]]:
    parquet = library()
    try:
        table: Any = parquet.read_table(path)
    except (OSError, ValueError) as err:
        raise InputError(f"{path}: cannot be read as Parquet ({err})") from err
    held = set(table.column_names)
    missing = [name for name in PLACE if name not in held]
    if missing or not held & {STAMP, TIME}:
        raise InputError(
            f"{path}: has no column {', '.join(missing) or TIME}; it must have {STAMP} or {TIME}, "
            f"{', '.join(PLACE)}"
        )
    columns = {}
    for name in (*PLACE, *(n for n in OPTIONAL if n in held)):
        try:
            columns[name] = np.array(table.column(name).to_numpy(), dtype=np.float64)
        except (TypeError, ValueError) as err:
            raise InputError(f"{path}: column {name} holds no numbers") from err
        if not np.all(np.isfinite(columns[name])):
            line = int(np.argmax(~np.isfinite(columns[name])))
            raise InputError(f"{path}: row {line}: {name} is no number")
    if STAMP in held:
        return np.array(table.column(STAMP).to_numpy(), dtype=np.int64), columns
    seconds = np.array(table.column(TIME).to_numpy(), dtype=np.float64)
    if not np.all(np.isfinite(seconds)):
        raise InputError(f"{path}: {TIME} holds what is no number")
    before = ORIGIN if np.abs(seconds).max(initial=0.0) < LONGEST else 0
    return before + np.rint(seconds * NANOSECONDS).astype(np.int64), columns


def _lists(path: Path, at: NDArray[np.int64], columns: dict[str, FloatArray]) -> list[PointList]:
    if "std" in columns and np.any(columns["std"] <= 0.0):
        line = int(np.argmax(columns["std"] <= 0.0)) + 2
        raise InputError(f"{path}: line {line}: std must be positive")
    order = np.argsort(at, kind="stable")
    at = at[order]
    place = np.column_stack([columns[name] for name in PLACE])[order]
    optional = {name: columns[name][order] for name in OPTIONAL if name in columns}
    edges = np.flatnonzero(np.diff(at)) + 1
    result = []
    for part in np.split(np.arange(len(at)), edges):
        own = {name: values[part] for name, values in optional.items()}
        result.append(PointList(int(at[part[0]]), place[part], own.get("u"), own.get("std")))
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
