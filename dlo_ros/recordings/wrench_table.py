# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured forces of the grips as a CSV file: a line for each message, in the frame `frame_id`."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dlo_ros.command import END, START
from dlo_ros.errors import InputError
from dlo_ros.observation import Wrenches
from dlo_ros.recordings.table_rows import STAMP, add_first, measured, rows_of
from dlo_ros.recordings.tables import WRENCH, WRENCH_FILE, files
from dlo_ros.recordings.tables import write_table as write

LOG = logging.getLogger(__name__)


def read_wrench_tables(inputs: Sequence[Path]) -> tuple[Wrenches, ...]:
    """Measured forces in CSV files, or in folders that have them; none where there are none.

    Raises:
        InputError: a file is unusable.
    """
    rows: dict[str, dict[int, np.ndarray]] = {}
    for path in files(inputs):
        lines = rows_of(path, ())
        if not set(WRENCH) <= set(lines[0]):
            continue
        for line in lines:
            if line["end"] not in (START, END):
                raise InputError(
                    f"{path}: {line.place}: end is '{line['end']}'; it must be {START} or {END}"
                )
        for end in dict.fromkeys(line["end"] for line in lines):
            at, values = measured(path, [r for r in lines if r["end"] == end], WRENCH[1:])
            found = zip(at.tolist(), values, strict=True)
            twice = add_first(rows.setdefault(end, {}), found)
            if twice:
                LOG.warning("%s: %d forces are left out that have a stamp of others", path, twice)
    result = []
    for end, own in rows.items():
        at = np.array(sorted(own), dtype=np.int64)
        table = np.array([own[int(s)] for s in at])
        result.append(Wrenches.along_axes(end, at, table))
    return tuple(result)


def write_wrench_table(folder: Path, measured: Sequence[Wrenches]) -> None:
    """Write measured forces into a folder, where there are any.

    Raises:
        InputError: the file cannot be written.
    """
    lines: list[list[object]] = []
    for one in measured:
        table = np.hstack([one.force, one.torque])
        lines += [
            [int(s), one.end, *row.tolist()] for s, row in zip(one.stamps, table, strict=True)
        ]
    if lines:
        write(folder / WRENCH_FILE, [STAMP, *WRENCH], lines)
