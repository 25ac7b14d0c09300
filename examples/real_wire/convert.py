# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured coordinates as CSV -> a bag with `dlo/command` and `dlo/observed`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import InputError
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings.table_rows import numbers, rows_of
from dlo_ros.recordings.tables import write_bag
from dlo_ros.spline import FloatArray, SplineBasis

STAMP = 1_750_000_000_000_000_000  # [ns] of every shape; when they were taken is not known
ENDS = ("start", "end")


def convert(folder: Path, trial: str, settings: Settings, output: Path) -> None:
    """Write one measured shape as a bag that every tool reads.

    Args:
        folder: folder with TRIAL.csv (columns u_m, x_m, z_m) and clamps.csv.
        trial: name of the shape.
        settings: settings with the length and the number of control points of the spline.
        output: the bag; an older one is replaced.

    Raises:
        InputError: a file is missing or not as it should be.
    """
    u, points = read_points(folder / f"{trial}.csv")
    if abs(u[-1] - settings.rod.length) > 1e-3:
        raise InputError(
            f"{folder / trial}.csv: u ends at {u[-1]:g} m; rod.length is {settings.rod.length:g} m"
        )
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    shape = np.column_stack(
        [basis.fit(u, points), np.zeros(basis.control_points)]
    )  # no twist was seen
    command = clamps(folder / "clamps.csv", trial, settings)
    write_bag(output, settings, [command], [Observation(STAMP, shape)], force=True)


def read_points(path: Path) -> tuple[FloatArray, FloatArray]:
    """Material coordinates [m], shape (m,), and points in the board frame [m], shape (m, 3).

    Raises:
        InputError: it cannot be read, holds no table of numbers, or u does not grow.
    """
    columns = ("u_m", "x_m", "z_m")
    table = numbers(path, rows_of(path, columns), columns)
    if len(table) < 4 or not np.all(np.diff(table[:, 0]) > 0.0):
        raise InputError(f"{path}: needs four lines or more of numbers, with growing u_m")
    return table[:, 0], np.column_stack([table[:, 1], np.zeros(len(table)), table[:, 2]])


def clamps(path: Path, trial: str, settings: Settings) -> Command:
    """The command of two fixed clamps: where each is, and where the DLO leaves it.

    Raises:
        InputError: it cannot be read, or does not have both ends of the trial.
    """
    columns = ("x_m", "z_m", "tangent_x", "tangent_z")
    table = rows_of(path, ("trial", "end", *columns))
    values = numbers(path, table, columns)
    rows = {r["end"]: v for r, v in zip(table, values, strict=True) if r["trial"] == trial}
    if set(rows) != set(ENDS):
        raise InputError(
            f"{path}: has {', '.join(rows) or 'nothing'} of {trial}; start and end are needed"
        )
    positions = [[rows[e][0], 0.0, rows[e][1]] for e in ENDS]
    # Turned about y, from x towards -z, so that its x axis is the tangent.
    angles = [np.arctan2(-rows[e][3], rows[e][2]) for e in ENDS]
    rotations = [[0.0, np.sin(a / 2.0), 0.0, np.cos(a / 2.0)] for a in angles]
    return Command(
        STAMP, ENDS, np.zeros(1), np.array([positions]), np.array([rotations]),
        np.full((1, 2, 3), np.nan), settings.rod.control_points, settings.frame_id,
    )  # fmt: skip
