# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A recording as tables of numbers: CSV files in a folder, and a bag from what was read.

`observed.csv` has a line for each observed spline, `command.csv` one for each imposed pose at each
time of each command, `points.csv` one for each measured point, `wrench.csv` (`wrench_table`) one
for each measured force. Positions are in metres in the frame `frame_id`, angles in radians, stamps
in nanoseconds (`stamp_ns`) or seconds (`time_s`).
"""

from __future__ import annotations

import csv
import io
import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dlo_ros.command import END, NANOSECONDS, NORM, START, UNIT, Command
from dlo_ros.errors import CommandError, InputError
from dlo_ros.files import write_text
from dlo_ros.observation import CentrelinePoints, Observation, Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    STD_ALONG,
    command_message,
    observation_messages,
)
from dlo_ros.recordings.messages import MAX_DISTANCE, stamp_of
from dlo_ros.recordings.table_rows import (
    LONGEST,
    PLACE,
    STAMP,
    Row,
    add_first,
    check_clocks,
    measured,
    numbers,
    rows_of,
    stamps,
)
from dlo_ros.recordings.wrenches import wrench_messages
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

COORDINATES = (*PLACE, "theta")
POSE = (*PLACE, "qx", "qy", "qz", "qw")
VELOCITY = ("vx", "vy", "vz")
POINT = ("u", "x", "y", "z", "std")
ROUNDING = 1e-6  # of the length, by which u may lie beyond an end of the DLO
WRENCH = ("end", "fx", "fy", "fz", "tx", "ty", "tz")
OBSERVED_FILE, COMMAND_FILE, POINTS_FILE = "observed.csv", "command.csv", "points.csv"
WRENCH_FILE = "wrench.csv"


def spline_columns(control_points: int) -> list[str]:
    """Names of a spline's numbers: `control_point_1.x` and so on."""
    return [f"control_point_{k}.{c}" for k in range(1, control_points + 1) for c in COORDINATES]


def read_csv(
    inputs: Sequence[Path], settings: Settings
) -> tuple[tuple[Command, ...], tuple[Observation, ...]]:
    """Commands and observed splines of CSV files, or of a folder that has them.

    Args:
        inputs: files, distinguished by their columns, or folders.
        settings: settings with the number of control points and the frame of the recording.

    Raises:
        InputError: a file is unusable, or there are no splines or no commands.
    """
    commands: list[Command] = []
    observations: dict[int, Observation] = {}
    points: dict[int, CentrelinePoints] = {}
    for path in files(inputs):
        columns = set(rows_of(path, ())[0])
        if "name" in columns:
            commands += read_commands(path, settings)
        elif set(POINT) <= columns:
            both = add_first(points, _points(path, settings.rod.length).items())
            if both:
                LOG.warning("%s: points at %d stamps are left out that others have", path, both)
        elif not set(WRENCH) <= columns:  # see `wrench_table`
            twice = add_first(observations, ((o.stamp, o) for o in _observations(path, settings)))
            if twice:
                LOG.warning("%s: %d splines are left out that have a stamp of others", path, twice)
    named = ", ".join(map(str, inputs))
    if not observations:
        raise InputError(f"{named}: no file has observed splines, as {OBSERVED_FILE} of export has")
    if not commands:
        raise InputError(f"{named}: no file has commands, as {COMMAND_FILE} of export has")
    alone = len(points.keys() - observations.keys())
    if alone:
        LOG.warning(
            "%s: measured points at %d of %d stamps are left out: no spline has them",
            named, alone, len(points),
        )  # fmt: skip
    commands.sort(key=lambda c: c.stamp)
    check_clocks(inputs, commands, list(observations))
    seen = [
        replace(observations[stamp], points=points.get(stamp)) for stamp in sorted(observations)
    ]
    return tuple(commands), tuple(seen)


def files(inputs: Sequence[Path]) -> list[Path]:
    """The CSV files among the inputs, those of a folder by their names.

    Raises:
        InputError: a folder has none.
    """
    found = []
    for path in inputs:
        if path.is_dir():
            held = [path / n for n in (OBSERVED_FILE, COMMAND_FILE, POINTS_FILE, WRENCH_FILE)]
            held = [p for p in held if p.exists()]
            if not held:
                raise InputError(f"{path}: has neither {OBSERVED_FILE} nor {COMMAND_FILE}")
            found += held
        else:
            found.append(path)
    return found


def _observations(path: Path, settings: Settings) -> list[Observation]:
    names = spline_columns(settings.rod.control_points)
    rows = rows_of(path, names)
    more = spline_columns(settings.rod.control_points + 1)[-1]
    if more in rows[0]:
        raise InputError(
            f"{path}: has more control points than rod.control_points, "
            f"{settings.rod.control_points}"
        )
    at, values = measured(path, rows, names)
    shapes = values.reshape(len(at), -1, len(COORDINATES))
    return [Observation(int(s), v) for s, v in zip(at, shapes, strict=True)]


def _points(path: Path, length: float) -> dict[int, CentrelinePoints]:
    rows = rows_of(path, POINT)
    along = STD_ALONG in rows[0]
    at, values = measured(path, rows, (*POINT, STD_ALONG) if along else POINT)
    u = values[:, 0]
    inside = (u >= -ROUNDING * length) & (u <= length * (1.0 + ROUNDING))
    if not inside.any():
        raise InputError(
            f"{path}: u is {u.min():.3g} to {u.max():.3g} m; the DLO is {length:g} m long "
            "(rod.length), and u is meant in metres from its start"
        )
    if not inside.all():
        LOG.warning(
            "%s: %d of %d points are left out: their u is not within 0 to %g m (rod.length)",
            path, int((~inside).sum()), len(u), length,
        )  # fmt: skip
    at, values = at[inside], values[inside]
    values[:, 0] = np.clip(values[:, 0], 0.0, length)
    found = {}
    for stamp in np.unique(at):
        own = values[at == stamp]
        found[int(stamp)] = CentrelinePoints(
            own[:, 1:4], own[:, 0], own[:, 4], own[:, 5] if along else None
        )
    return found


def read_commands(path: Path, settings: Settings) -> list[Command]:
    """Commands of a CSV file: lines of one stamp, or all without `time_from_start`, are one."""
    rows = rows_of(path, ("name", *POSE))
    at, after = _starts(path, rows)
    values = numbers(path, rows, POSE)
    for row, pose, seconds in zip(rows, values, after.tolist(), strict=True):
        norm, far = float(np.linalg.norm(pose[3:])), float(np.abs(pose[:3]).max())
        if far > MAX_DISTANCE or abs(seconds) > LONGEST:
            what = f"{seconds:g} s from its start" if far <= MAX_DISTANCE else f"{far:g} m away"
            raise InputError(f"{path}: {row.place}: is {what}; metres and seconds are meant")
        if row["name"] in (START, END) and abs(norm - 1.0) > NORM:
            raise InputError(f"{path}: {row.place}: qx, qy, qz, qw have norm {norm:.3g}; {UNIT}")
    fast = np.full((len(rows), 3), math.nan)
    for k, row in enumerate(rows):
        if all(row.get(name, "") for name in VELOCITY):
            fast[k] = numbers(path, [row], VELOCITY)[0]
    commands = []
    for stamp in sorted(set(at)):
        own = [k for k, s in enumerate(at) if s == stamp]
        names = list(dict.fromkeys(rows[k]["name"] for k in own))
        times = sorted({float(after[k]) for k in own})
        index = {(float(after[k]), rows[k]["name"]): k for k in own}
        if len(index) != len(own) or len(own) != len(names) * len(times):
            raise InputError(
                f"{path}: the command at {stamp / NANOSECONDS:.3f} s must have one line for each "
                f"of {', '.join(names)} at each of its times"
            )
        grid = np.array([[index[time, name] for name in names] for time in times])
        places, turns = np.split(values[grid], [3], axis=2)
        n, frame_id = settings.rod.control_points, settings.frame_id
        imposed = tuple(names)
        try:
            commands.append(
                Command(stamp, imposed, np.array(times), places, turns, fast[grid], n, frame_id)
            )
        except CommandError as err:
            raise InputError(f"{path}: {err}") from err
    return commands


def _starts(path: Path, rows: Sequence[Row]) -> tuple[list[int], FloatArray]:
    """Stamp of each line's command [ns], and the line's time from there [s]."""
    at = stamps(path, rows)
    if "time_from_start" in rows[0]:
        return at, numbers(path, rows, ("time_from_start",))[:, 0]
    first = min(at)
    return [first] * len(rows), np.array([(s - first) / NANOSECONDS for s in at])


def write_csv(
    folder: Path, commands: Sequence[Command], observations: Sequence[Observation]
) -> None:
    """Write a recording as CSV files into a folder.

    Raises:
        InputError: it cannot be written.
    """
    n = len(observations[0].control_points)
    table = [[o.stamp, *o.control_points.ravel().tolist()] for o in observations]
    write_table(folder / OBSERVED_FILE, [STAMP, *spline_columns(n)], table)
    lines: list[list[object]] = []
    for c in commands:
        for i, time in enumerate(c.times):
            for k, name in enumerate(c.names):
                speed = c.velocities[i, k]
                shown = speed.tolist() if np.all(np.isfinite(speed)) else [""] * 3
                pose = [*c.positions[i, k].tolist(), *c.rotations[i, k].tolist()]
                lines.append([c.stamp, float(time), name, *pose, *shown])
    write_table(folder / COMMAND_FILE, [STAMP, "time_from_start", "name", *POSE, *VELOCITY], lines)
    clouds = [(o.stamp, o.points) for o in observations if o.points is not None]
    if clouds:
        along = all(p.std_along is not None for _, p in clouds)
        measured: list[list[object]] = []
        for stamp, p in clouds:
            columns = [p.u, *p.positions.T, p.std, *([p.std_along] if along else [])]
            measured += [[stamp, *row.tolist()] for row in np.column_stack(columns)]
        write_table(
            folder / POINTS_FILE, [STAMP, *POINT, *([STD_ALONG] if along else [])], measured
        )


def write_table(path: Path, header: Sequence[str], lines: Sequence[Sequence[object]]) -> None:
    """Write a CSV file.

    Raises:
        InputError: it cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(lines)
    write_text(path, text.getvalue())


def write_bag(
    output: Path,
    settings: Settings,
    commands: Sequence[Command],
    observations: Sequence[Observation],
    wrenches: Sequence[Wrenches] = (),
    *,
    force: bool = False,
) -> None:
    """Write commands, observed splines and measured forces as a bag that every tool reads.

    Args:
        output: the bag.
        settings: settings whose `frame_id` the messages carry.
        commands: commands by growing stamp.
        observations: observed splines by growing stamp.
        wrenches: measured forces at the ends that have a sensor.
        force: whether an older bag is replaced.

    Raises:
        InputError: it cannot be written, or a number is unusable.
    """
    with BagWriter(output, force=force) as writer:
        messages = [(topics.COMMAND, command_message(BAG_MESSAGES, c)) for c in commands]
        for o in observations:
            messages += observation_messages(settings.frame_id, o)
        for one in wrenches:
            messages += wrench_messages(settings.frame_id, one)
        write_by_stamp(writer, messages)


def write_by_stamp(writer: BagWriter, messages: Sequence[tuple[str, Any]]) -> None:
    """Write messages with their topics in the order of their stamps."""
    for topic, message in sorted(messages, key=lambda m: stamp_of(m[1])):
        writer.write(topic, message, stamp_of(message))
