# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rows of tables: their numbers and stamps, and which of them are usable."""

from __future__ import annotations

import csv
import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import InputError
from dlo_ros.recordings.command_spans import Span, unseen_motion
from dlo_ros.recordings.message_building import STD_ALONG
from dlo_ros.recordings.messages import MAX_DISTANCE
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

STAMP, TIME = "stamp_ns", "time_s"
PLACE = ("x", "y", "z")
ORIGIN = 1_750_000_000 * NANOSECONDS
"""Stamp [ns] of the time 0 where times count from the beginning of a recording."""
LONGEST = 1e6  # [s] longest recording; later times are those of a clock
LATEST = 2**31 * NANOSECONDS  # [ns] a message's stamp has seconds of 32 bits

T = TypeVar("T")


class Row(dict[str, str]):
    """A line of a table by the names of its columns.

    Args:
        place: where it stands in the file, for people.
    """

    def __init__(self, place: str, cells: Mapping[str, str]) -> None:
        super().__init__(cells)
        self.place = place


def rows_of(path: Path, needed: Sequence[str]) -> list[Row]:
    """The lines of a CSV file by the names in its first line.

    Raises:
        InputError: it cannot be read, has no line, lacks a column or has one twice.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, restval="", skipinitialspace=True)
            head = [name for name in reader.fieldnames or () if name]
            twice = next((name for name in head if head.count(name) > 1), None)
            if twice is not None:
                raise InputError(
                    f"{path}: its first line names the column '{twice}' twice; each needs a name "
                    "of its own"
                )
            missing = [name for name in needed if name not in head]
            if missing:
                raise InputError(
                    f"{path}: its first line has no {', '.join(missing)}; it must name "
                    f"{', '.join(needed)}, with commas between them"
                )
            rows = [
                Row(f"line {reader.line_num}", {str(k): v for k, v in row.items() if k is not None})
                for row in reader
            ]
    except OSError as err:
        raise InputError(f"{path}: cannot be read ({err.strerror})") from err
    except (UnicodeDecodeError, csv.Error) as err:
        raise InputError(f"{path}: is no CSV file in UTF-8 ({err})") from err
    if not rows:
        raise InputError(f"{path}: has no line but the first")
    return rows


def numbers(path: Path, rows: Sequence[Row], names: Sequence[str]) -> FloatArray:
    """Columns as numbers, shape (rows, names).

    Raises:
        InputError: one is no finite number; with its line and column.
    """
    result = np.empty((len(rows), len(names)))
    for k, row in enumerate(rows):
        for j, name in enumerate(names):
            try:
                result[k, j] = float(row[name])
            except ValueError:
                result[k, j] = math.nan
            if not math.isfinite(result[k, j]):
                raise InputError(f"{path}: {row.place}: {name} is '{row[name]}', no number")
    return result


def stamps(path: Path, rows: Sequence[Row]) -> list[int]:
    """Stamps of lines [ns]; times from the beginning of a recording are given a date.

    Raises:
        InputError: there is neither `stamp_ns` nor `time_s`, or one is no number.
    """
    if STAMP in rows[0]:
        return _within_range(path, rows, [_nanoseconds(path, row) for row in rows])
    time = _time_column(path, rows[0])
    seconds = numbers(path, rows, (time,))[:, 0]
    before = ORIGIN if np.abs(seconds).max() < LONGEST else 0
    # A float of a date is 100 ns off and more: equal stamps of two files would differ.
    found = [before + round(Decimal(row[time]) * NANOSECONDS) for row in rows]
    return _within_range(path, rows, found)


def measured(
    path: Path, rows: Sequence[Row], names: Sequence[str]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Stamps [ns] and numbers of measured lines; those that have none are left out, and told of.

    Args:
        path: the file, for messages.
        rows: its lines.
        names: columns of numbers. A standard deviation must be positive, a place within
            `MAX_DISTANCE`, as in a message.

    Returns:
        Stamps, shape (rows,), and numbers, shape (rows, names), of the usable lines.

    Raises:
        InputError: no line is usable; with the reason for the first one.
    """
    time = _time_column(path, rows[0])
    usable: list[Row] = []
    reasons: list[str] = []
    values = np.empty((len(rows), len(names)))
    for row in rows:
        try:
            values[len(usable)] = _measurement(path, row, names)
            _nanoseconds(path, row) if time == STAMP else numbers(path, [row], (time,))
        except InputError as err:
            reasons.append(str(err))
            continue
        usable.append(row)
    if not usable:
        raise InputError(f"{reasons[0]} (none of its {len(rows)} lines is usable)")
    if reasons:
        LOG.warning(
            "%s (%d of %d lines are left out, this is the first one)",
            reasons[0], len(reasons), len(rows),
        )  # fmt: skip
    return np.array(stamps(path, usable), dtype=np.int64), values[: len(usable)]


def add_first(known: dict[int, T], more: Iterable[tuple[int, T]]) -> int:
    """Add values by their stamps [ns], of which the first counts.

    Returns:
        How many are left out, since their stamps were known.
    """
    left_out = 0
    for stamp, value in more:
        left_out += stamp in known
        known.setdefault(stamp, value)
    return left_out


def _measurement(path: Path, row: Row, names: Sequence[str]) -> FloatArray:
    result = numbers(path, [row], names)[0]
    for name, value in zip(names, result, strict=True):
        if name in ("std", STD_ALONG) and value <= 0.0:
            raise InputError(f"{path}: {row.place}: {name} is '{row[name]}'; it must be positive")
        if name.rpartition(".")[2] in PLACE and abs(value) > MAX_DISTANCE:
            raise InputError(
                f"{path}: {row.place}: {name} is '{row[name]}', more than {MAX_DISTANCE:g} m away"
            )
    return np.asarray(result)


def _time_column(path: Path, row: Row) -> str:
    """The column with the time of a line: `stamp_ns`, else `time_s`."""
    found = next((name for name in (STAMP, TIME) if name in row), None)
    if found is None:
        raise InputError(f"{path}: its first line has neither {STAMP} nor {TIME}")
    return found


def _nanoseconds(path: Path, row: Row) -> int:
    try:
        return int(row[STAMP])
    except ValueError as err:
        raise InputError(
            f"{path}: {row.place}: {STAMP} is '{row[STAMP]}', no whole number of nanoseconds"
        ) from err


def _within_range(path: Path, rows: Sequence[Row], found: list[int]) -> list[int]:
    """The stamps [ns] of lines, if messages can carry them all."""
    for row, stamp in zip(rows, found, strict=True):
        if not 0 <= stamp < LATEST:
            when = "before 1970" if stamp < 0 else "after 2038"
            raise InputError(
                f"{path}: {row.place}: the stamp {stamp:.3g} ns lies {when}; {STAMP} counts "
                f"nanoseconds, {TIME} seconds"
            )
    return found


def check_clocks(inputs: Sequence[Path], commands: Sequence[Command], seen: Sequence[int]) -> None:
    """Refuse commands and shapes of different clocks; tell of a motion that no shape shows.

    Args:
        inputs: the files.
        commands: commands by growing stamp.
        seen: stamps of the shapes [ns].

    Raises:
        InputError: the stamps are farther apart than any recording is long.
    """
    found = [*seen, *(c.stamp for c in commands)]
    if max(found) - min(found) > LONGEST * NANOSECONDS:
        raise InputError(
            f"{', '.join(map(str, inputs))}: the times are of different clocks, more than "
            f"{LONGEST:.0e} s apart; give absolute times in every file, or relative ones in every"
        )
    for line in unseen_motion(commands, [Span("what is seen", min(seen), max(seen))]):
        LOG.warning("%s: %s", ", ".join(map(str, inputs)), line)
