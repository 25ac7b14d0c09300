# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A command from a file: YAML as in an experiment or as a message, or CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from dlo_ros.command import END, NANOSECONDS, NORM, START, UNIT, Command, check_names
from dlo_ros.errors import CommandError, InputError
from dlo_ros.files import read_yaml
from dlo_ros.parameters import Settings
from dlo_ros.recordings.message_building import LAST_SECOND
from dlo_ros.recordings.messages import MAX_DISTANCE, read_command
from dlo_ros.spline import FloatArray

MOST_ROWS = 1_000_000
"""Longer CSV files are refused; that is almost three hours at 100 Hz."""
BEGIN = NANOSECONDS
"""Stamp of a command that a file gives none [ns]: zero would mean the moment of receipt."""
QUATERNION = ("qx", "qy", "qz", "qw")
DIRECTION = ("dx", "dy", "dz")
ANGLE = "angle"
KEYS = {"time", "position", "angle", "direction", "rotation"}


@dataclass
class _Track:
    """The motion of one imposed place: times [s], positions [m] (T, 3), and clamp directions."""

    times: list[float]
    positions: list[list[float]]
    rotations: list[Rotation]
    angle: float | None = None


def read_command_file(path: Path, settings: Settings) -> Command:
    """Read a command from a YAML or a CSV file.

    Args:
        path: ends in .csv for CSV.
        settings: settings of the DLO: control points and frame.

    Raises:
        InputError: the file is missing or malformed; one line that says what and where.
    """
    try:
        if path.suffix.lower() == ".csv":
            return _command(_csv_tracks(path), settings)
        tree = read_yaml(path)
        if isinstance(tree, Mapping) and "joint_names" in tree:
            return _message(tree, settings)
        return _command(_yaml_tracks(tree), settings)
    except CommandError as err:
        text = str(err).removeprefix("dlo/command").lstrip(": ")
        raise InputError(f"{path}: {text}") from err


def _message(tree: Mapping[str, Any], settings: Settings) -> Command:
    """A trajectory_msgs/MultiDOFJointTrajectory, as `ros2 topic echo` writes it."""
    defaults = {"header": {}, "points": [], **tree}
    header = {"stamp": {}, "frame_id": settings.frame_id, **_block(defaults["header"], "header")}
    stamp = {"sec": 0, "nanosec": 0, **_block(header["stamp"], "stamp")}
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(**stamp), frame_id=header["frame_id"]),
        joint_names=_sequence(tree["joint_names"], "joint_names"),
        points=[_point(p) for p in _sequence(defaults["points"], "points")],
    )
    try:
        command = read_command(message, settings, BEGIN)
    except (AttributeError, TypeError, ValueError, OverflowError) as err:
        raise CommandError(f"is no trajectory: {err}") from err
    if not 0 <= command.stamp // NANOSECONDS <= LAST_SECOND:
        raise CommandError(
            f"header.stamp is {command.stamp // NANOSECONDS} s; a ROS message can carry 0 to "
            f"{LAST_SECOND} s"
        )
    return command


def _point(tree: Any) -> SimpleNamespace:
    """A point of the trajectory; what is left out is zero, a rotation the identity."""
    point = {"transforms": [], "velocities": [], "time_from_start": {}, **_block(tree, "a point")}
    time = {"sec": 0, "nanosec": 0, **_block(point["time_from_start"], "time_from_start")}

    def vector(values: Any) -> SimpleNamespace:
        return SimpleNamespace(**{"x": 0.0, "y": 0.0, "z": 0.0, **_block(values, "a vector")})

    transforms = []
    for entry in _sequence(point["transforms"], "transforms"):
        parts = {"translation": {}, "rotation": {"w": 1.0}, **_block(entry, "a transform")}
        turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0, **_block(parts["rotation"], "a rotation")}
        transforms.append(
            SimpleNamespace(
                translation=vector(parts["translation"]), rotation=SimpleNamespace(**turn)
            )
        )
    twists = []
    for entry in _sequence(point["velocities"], "velocities"):
        parts = {"linear": {}, "angular": {}, **_block(entry, "a velocity")}
        twists.append(
            SimpleNamespace(linear=vector(parts["linear"]), angular=vector(parts["angular"]))
        )
    return SimpleNamespace(
        transforms=transforms, velocities=twists, time_from_start=SimpleNamespace(**time)
    )


def _block(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise CommandError(f"{what} is {str(value)[:60]!r}; it must be a block of 'key: value'")
    return dict(value)


def _sequence(value: Any, what: str) -> Sequence[Any]:
    if not isinstance(value, list):
        raise CommandError(f"{what} is {str(value)[:60]!r}; it must be a list")
    return value


def _yaml_tracks(tree: Any) -> dict[str, _Track]:
    """The block `motion` of an experiment, or such a block by itself."""
    motion = tree.get("motion", tree) if isinstance(tree, Mapping) else tree
    if not isinstance(motion, Mapping) or not motion:
        raise CommandError(
            "holds no motion; give a block such as 'start: [{time: 0.0, position: [0, 0, 0]}]'"
        )
    result = {}
    for name, points in motion.items():
        track = _Track([], [], [])
        for k, point in enumerate(_sequence(points, f"{name}")):
            where = f"{name}, point {k + 1}"
            entry = _block(point, where)
            unknown = sorted(set(entry) - KEYS)
            if unknown:
                known = ", ".join(sorted(KEYS))
                raise CommandError(f"{where} has '{unknown[0]}'; known are {known}")
            track.times.append(_number(entry.get("time", 0.0), f"{where}: time"))
            if "position" not in entry:
                raise CommandError(f"{where} has no position; give [x, y, z] in m")
            track.positions.append(_numbers(entry["position"], 3, f"{where}: position"))
            turned: dict[str, Any] = {
                key: entry[key] for key in ("angle", "direction", "rotation") if key in entry
            }
            if len(turned) > 1:
                raise CommandError(f"{where} has {' and '.join(turned)}; give one of them")
            track.rotations.append(_turned(track, turned, where, clamp=name in (START, END)))
        result[str(name)] = track
    return result


def _turned(track: _Track, given: Mapping[str, Any], where: str, *, clamp: bool) -> Rotation:
    """Rotation of a clamp from angle, direction or quaternion."""
    if "angle" in given:
        angle, before = _number(given["angle"], f"{where}: angle"), track.angle
        if before is not None and abs(angle - before) >= math.pi:
            raise CommandError(
                f"{where}: the angle changes by {angle - before:.3g} rad at once; give points in "
                "between, less than half a turn apart"
            )
        track.angle = angle
        return Rotation.from_euler("y", angle)
    if "rotation" in given:
        values = _numbers(given["rotation"], 4, f"{where}: rotation")
        norm = math.hypot(*values)
        if abs(norm - 1.0) > NORM:
            raise CommandError(f"{where}: the rotation has norm {norm:.3g}; {UNIT}")
        return Rotation.from_quat(values)
    if "direction" in given:
        values = _numbers(given["direction"], 3, f"{where}: direction")
        size = math.hypot(*values)
        if size < 1e-6:
            raise CommandError(f"{where}: direction is zero; give a vector along growing u")
        last = track.rotations[-1] if track.rotations else Rotation.identity()
        return _pointed(last, np.array(values) / size)
    if clamp:
        raise CommandError(f"{where} has no angle, direction or rotation of the clamp")
    return Rotation.identity()


def _pointed(before: Rotation, direction: FloatArray) -> Rotation:
    """A rotation turned the short way until its x axis has a direction: it adds no twist."""
    x = before.apply([1.0, 0.0, 0.0])
    axis, cosine = np.cross(x, direction), float(np.clip(x @ direction, -1.0, 1.0))
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        half_turn = Rotation.from_rotvec(math.pi * before.apply([0.0, 1.0, 0.0]))
        return before if cosine > 0.0 else half_turn * before
    return Rotation.from_rotvec(axis / size * math.atan2(size, cosine)) * before


def _csv_tracks(path: Path) -> dict[str, _Track]:
    """Columns `time`, and NAME.x, NAME.y, NAME.z of each name, with how a clamp points."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(zip(range(1, MOST_ROWS + 2), csv.reader(file, strict=True), strict=False))
    except OSError as err:
        raise CommandError(f"cannot be read ({err.strerror})") from err
    except (csv.Error, UnicodeDecodeError) as err:
        raise CommandError(f"is no CSV ({err})") from err
    rows = [(line, row) for line, row in rows if any(cell.strip() for cell in row)]
    if len(rows) < 2:
        raise CommandError("has no header with a line of numbers below it")
    if len(rows) > MOST_ROWS:
        raise CommandError(f"has more than {MOST_ROWS} lines")
    head = [cell.strip() for cell in rows[0][1]]
    if len(set(head)) < len(head):
        twice = next(cell for cell in head if head.count(cell) > 1)
        raise CommandError(f"has the column '{twice}' twice")
    if "time" not in head:
        raise CommandError("has no column 'time'")
    names = list(dict.fromkeys(c.rpartition(".")[0] for c in head if c != "time"))
    form = {name: _columns(name, head) for name in names}
    result = {name: _Track([], [], []) for name in names}
    for line, row in rows[1:]:
        where = f"line {line}"
        if len(row) != len(head):
            raise CommandError(f"{where} has {len(row)} cells; the header has {len(head)}")
        values = {
            key: _number(cell.strip(), f"{where}: {key}")
            for key, cell in zip(head, row, strict=True)
        }
        for name, (kind, columns) in form.items():
            track = result[name]
            track.times.append(values["time"])
            track.positions.append([values.get(f"{name}.{c}", 0.0) for c in "xyz"])
            numbers: Any = [values[f"{name}.{c}"] for c in columns]
            given = {kind: numbers[0] if kind == "angle" else numbers} if kind else {}
            at = f"{where}: {name}"
            track.rotations.append(_turned(track, given, at, clamp=name in (START, END)))
    return result


def _columns(name: str, head: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Kind of a name's direction columns, and the columns themselves."""
    own = {c.rpartition(".")[2] for c in head if c.rpartition(".")[0] == name and c != "time"}
    forms = {"rotation": QUATERNION, "direction": DIRECTION, "angle": (ANGLE,)}
    unknown = own - {"x", "y", "z"} - {c for form in forms.values() for c in form}
    if not name or unknown:
        column = f"{name}.{sorted(unknown)[0]}" if name else sorted(own)[0]
        raise CommandError(
            f"has the column '{column}'; known are time and NAME.x, .y, .z with .angle, or .dx, "
            ".dy, .dz, or .qx, .qy, .qz, .qw"
        )
    missing = [c for c in "xz" if c not in own]
    given = [kind for kind, form in forms.items() if own & set(form)]
    if len(given) > 1:
        raise CommandError(f"gives the direction of '{name}' twice: {' and '.join(given)}")
    if given:
        missing += [c for c in forms[given[0]] if c not in own]
    if missing:
        raise CommandError(f"has no column '{name}.{missing[0]}'")
    return (given[0], forms[given[0]]) if given else ("", ())


def _command(tracks: Mapping[str, _Track], settings: Settings) -> Command:
    """All names with points at all the times that occur."""
    check_names(tuple(tracks), settings.rod.control_points)
    for name, track in tracks.items():
        if not track.times:
            raise CommandError(f"'{name}' has no point")
        if any(b <= a for a, b in pairwise(track.times)):
            raise CommandError(f"the times of '{name}' must grow")
    times = np.unique(np.concatenate([t.times for t in tracks.values()]))
    positions = np.empty((len(times), len(tracks), 3))
    rotations = np.empty((len(times), len(tracks), 4))
    for k, track in enumerate(tracks.values()):
        at, where = np.clip(times, track.times[0], track.times[-1]), np.array(track.positions)
        for c in range(3):
            positions[:, k, c] = np.interp(times, track.times, where[:, c])
        turned = Rotation.concatenate(track.rotations)
        if len(track.times) > 1:
            rotations[:, k] = Slerp(track.times, turned)(at).as_quat()
        else:
            rotations[:, k] = turned.as_quat()
    return Command(
        BEGIN, tuple(tracks), times, positions, rotations, np.full_like(positions, np.nan),
        settings.rod.control_points, settings.frame_id,
    )  # fmt: skip


def _number(value: Any, what: str) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        raise CommandError(f"{what} is {str(value)[:60]!r}; it must be a number") from None
    if not math.isfinite(number) or abs(number) > MAX_DISTANCE:
        raise CommandError(f"{what} is {value}; it must be a number up to {MAX_DISTANCE:g}")
    return number


def _numbers(values: Any, count: int, what: str) -> list[float]:
    if not isinstance(values, list) or len(values) != count:
        raise CommandError(f"{what} is {str(values)[:60]!r}; it must be {count} numbers")
    return [_number(value, what) for value in values]
