# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured coordinates as CSV -> a bag with `dlo/command` and `dlo/observed`."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import BAG_MESSAGES, BagWriter, command_message, spline_message, topics
from dlo_ros.spline import FloatArray, SplineBasis

STAMP = 1_750_000_000_000_000_000  # [ns] of every shape; when they were taken is not known
ENDS = ("start", "end")


def convert(folder: Path, trial: str, settings: Settings, output: Path) -> None:
    """Write one measured shape as a bag that every tool reads.

    Args:
        folder: with TRIAL.csv (columns u_m, x_m, z_m) and clamps.csv.
        trial: name of the shape.
        settings: whose length and number of control points the spline has.
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
    with BagWriter(output, force=True) as writer:
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, command), STAMP)
        observed = spline_message(BAG_MESSAGES, STAMP, settings.frame_id, shape)
        writer.write(topics.OBSERVED, observed, STAMP)


def read_points(path: Path) -> tuple[FloatArray, FloatArray]:
    """Material coordinates [m], shape (m,), and points in the board frame [m], shape (m, 3).

    Raises:
        InputError: it cannot be read, holds no table of numbers, or u does not grow.
    """
    table = np.array([[r["u_m"], r["x_m"], r["z_m"]] for r in _rows(path, "u_m,x_m,z_m")])
    if len(table) < 4 or not np.all(np.isfinite(table)) or not np.all(np.diff(table[:, 0]) > 0.0):
        raise InputError(f"{path}: needs four lines or more of numbers, with growing u_m")
    return table[:, 0], np.column_stack([table[:, 1], np.zeros(len(table)), table[:, 2]])


def clamps(path: Path, trial: str, settings: Settings) -> Command:
    """The command of two fixed clamps: where each is, and where the DLO leaves it.

    Raises:
        InputError: it cannot be read, or does not have both ends of the trial.
    """
    header = "trial,end,x_m,z_m,tangent_x,tangent_z"
    rows = {r["end"]: r for r in _rows(path, header) if r["trial"] == trial}
    if set(rows) != set(ENDS):
        raise InputError(
            f"{path}: has {', '.join(rows) or 'nothing'} of {trial}; start and end are needed"
        )
    positions = [[rows[e]["x_m"], 0.0, rows[e]["z_m"]] for e in ENDS]
    # Turned about y, from x towards -z, so that its x axis is the tangent.
    angles = [np.arctan2(-rows[e]["tangent_z"], rows[e]["tangent_x"]) for e in ENDS]
    rotations = [[0.0, np.sin(a / 2.0), 0.0, np.cos(a / 2.0)] for a in angles]
    return Command(
        STAMP, ENDS, np.zeros(1), np.array([positions]), np.array([rotations]),
        np.full((1, 2, 3), np.nan), settings.rod.control_points, settings.frame_id,
    )  # fmt: skip


def _rows(path: Path, header: str) -> list[dict[str, float | str]]:
    """Lines of a table; what is a number is one."""
    try:
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            if ",".join(reader.fieldnames or ()) != header:
                raise InputError(f"{path}: its first line must be {header}")
            return [{k: _number(v) for k, v in row.items()} for row in reader]
    except OSError as err:
        raise InputError(f"{path}: cannot be read ({err.strerror})") from err


def _number(text: str | None) -> float | str:
    try:
        return float(text or "nan")
    except ValueError:
        return text or ""
