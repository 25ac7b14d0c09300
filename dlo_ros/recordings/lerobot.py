# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings in LeRobot's layout (v2.1): `meta/*.json*` and one Parquet file for each episode.

A frame is an observed spline: `observation.state` holds its control points, `action` what was
imposed at that instant (position and quaternion x y z w of each imposed thing), `stamp_ns` the
stamp that `timestamp`, seconds from the episode's beginning, has lost. What each number is stands
under `names` in `meta/info.json`; a data set of another robot is read where its columns have such
names.
"""

from __future__ import annotations

import importlib
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.dependencies import extra
from dlo_ros.errors import CommandError, InputError
from dlo_ros.files import write_text
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings.table_rows import ORIGIN, STAMP
from dlo_ros.recordings.tables import POSE, spline_columns
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

STATE, ACTION, TIMESTAMP = "observation.state", "action", "timestamp"
VERSION = "v2.1"
CHUNK = 1000  # episodes to a folder
DATA = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
INFO = "meta/info.json"
TASK = "manipulation of a deformable linear object"
COUNTERS = ("frame_index", "episode_index", "index", "task_index", STAMP)
Episode = tuple[Sequence[Command], Sequence[Observation]]


def library() -> Any:
    """The module pyarrow.parquet.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module("pyarrow.parquet")
    except ImportError as err:
        raise InputError(f"Parquet files need pyarrow; {extra('parquet')}") from err


def write_lerobot(folder: Path, episodes: Sequence[Episode], settings: Settings) -> None:
    """Write recordings as a data set.

    Args:
        folder: folder of the data set, which must not contain one yet.
        episodes: commands and observations of each recording; all impose the same.
        settings: settings with the number of control points of the recordings.

    Raises:
        InputError: they impose different things, or the folder cannot be written.
    """
    parquet = library()
    arrow = importlib.import_module("pyarrow")
    if (folder / INFO).exists():
        raise InputError(f"{folder}: holds a data set already; give another name")
    names = episodes[0][0][0].names
    if any(command.names != names for commands, _ in episodes for command in commands):
        raise InputError(
            "the recordings impose different things, or one does over time; LeRobot's layout has "
            "one kind of action for all: export them one by one, or as csv"
        )
    total, rates, listed = 0, [], []
    for number, (commands, observations) in enumerate(episodes):
        at = np.array([o.stamp for o in observations], dtype=np.int64)
        count = len(at)
        seconds = (at - at[0]) / NANOSECONDS
        if count > 1:
            rates.append((count - 1) / seconds[-1])
        state = np.array([o.control_points.ravel() for o in observations], dtype=np.float32)
        action = np.array([_imposed(commands, int(s)) for s in at], dtype=np.float32)
        columns = {
            STATE: _vectors(arrow, state),
            ACTION: _vectors(arrow, action),
            TIMESTAMP: arrow.array(seconds.astype(np.float32)),
            "frame_index": arrow.array(np.arange(count)),
            "episode_index": arrow.array(np.full(count, number)),
            "index": arrow.array(total + np.arange(count)),
            "task_index": arrow.array(np.zeros(count, dtype=np.int64)),
            STAMP: arrow.array(at),
        }
        path = folder / _data(DATA, number)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            parquet.write_table(arrow.table(columns), path)
        except OSError as err:
            raise InputError(f"{path}: cannot be written ({err.strerror})") from err
        listed.append({"episode_index": number, "tasks": [TASK], "length": count})
        total += count
    (folder / INFO).parent.mkdir(parents=True, exist_ok=True)
    write_text(folder / "meta/tasks.jsonl", _lines([{"task_index": 0, "task": TASK}]))
    write_text(folder / "meta/episodes.jsonl", _lines(listed))
    rate = float(np.mean(rates)) if rates else 1.0
    info = _info(settings, names, len(episodes), total, rate)
    write_text(folder / INFO, json.dumps(info, indent=2) + "\n")


def read_lerobot(
    folder: Path, settings: Settings, episode: int
) -> tuple[tuple[Command, ...], tuple[Observation, ...]]:
    """An episode of a data set.

    Args:
        folder: folder of the data set, with `meta/info.json`.
        settings: settings with the number of control points and the frame of the episode.
        episode: number of the episode, from 0.

    Raises:
        InputError: no data set, no such episode, or columns that are no splines and commands.
    """
    info = _read_info(folder)
    chunk = info.get("chunks_size", CHUNK)
    if not isinstance(chunk, int) or chunk < 1:
        raise InputError(f"{folder / INFO}: chunks_size is {chunk!r}; it must be a whole number")
    path = folder / _data(str(info.get("data_path", DATA)), episode, chunk)
    if not path.is_file():
        held = info.get("total_episodes", "?")
        raise InputError(f"{path}: is missing; the data set says it has {held} episodes, from 0")
    parquet = library()
    try:
        table = parquet.read_table(path)
        columns = {name: table.column(name).to_pylist() for name in table.column_names}
    except Exception as err:  # whatever pyarrow finds wrong with it
        raise InputError(f"{path}: is no Parquet file that can be read ({err})") from err
    names = {
        column: [str(name) for name in feature["names"]]
        for column, feature in info["features"].items()
        if isinstance(feature, dict) and isinstance(feature.get("names"), list)
    }
    at = _stamps(path, columns)
    shapes = _column(path, columns, names, spline_columns(settings.rod.control_points))
    usable = np.all(np.isfinite(shapes), axis=1)
    if not usable.any():
        raise InputError(f"{path}: no frame has control points that are finite numbers")
    if not usable.all():
        LOG.warning(
            "%s: %d of %d frames are left out, whose control points are no finite numbers, the "
            "first one frame %d", path, np.sum(~usable), len(at), np.argmin(usable),
        )  # fmt: skip
    observations = tuple(
        Observation(s, v.reshape(-1, 4)) for s, v, u in zip(at, shapes, usable, strict=True) if u
    )
    return (_command(path, columns, names, at, settings),), observations


def _command(
    path: Path, columns: Mapping[str, list[Any]], names: Mapping[str, list[str]], at: list[int],
    settings: Settings,
) -> Command:  # fmt: skip
    imposed = list(
        dict.fromkeys(
            name.removesuffix(".qw")
            for own in names.values()
            for name in own
            if name.endswith(".qw")
        )
    )
    if not imposed:
        raise InputError(f"{path}: no column has names such as start.x ... start.qw of a command")
    wanted = [f"{name}.{c}" for name in imposed for c in POSE]
    values = _column(path, columns, names, wanted).reshape(len(at), len(imposed), len(POSE))
    times = np.array([(s - at[0]) / NANOSECONDS for s in at])
    try:
        return Command(
            at[0], tuple(imposed), times, values[:, :, :3], values[:, :, 3:],
            np.full((len(at), len(imposed), 3), np.nan), settings.rod.control_points,
            settings.frame_id,
        )  # fmt: skip
    except CommandError as err:
        raise InputError(f"{path}: {err}") from err


def _column(
    path: Path, columns: Mapping[str, list[Any]], names: Mapping[str, list[str]],
    wanted: Sequence[str],
) -> FloatArray:  # fmt: skip
    """The numbers of certain names, shape (frames, names)."""
    for column, own in names.items():
        if column in columns and set(wanted) <= set(own):
            try:
                values = np.array(columns[column], dtype=np.float64)
            except (TypeError, ValueError):
                values = np.zeros((0, 0))
            if values.ndim != 2 or values.shape[1] != len(own):
                raise InputError(f"{path}: {column} must have {len(own)} numbers a frame")
            return np.asarray(values[:, [own.index(name) for name in wanted]])
    raise InputError(
        f"{path}: no column has the names {wanted[0]} ... {wanted[-1]} in {INFO}; "
        "is rod.control_points right?"
    )


def _stamps(path: Path, columns: Mapping[str, list[Any]]) -> list[int]:
    name = STAMP if columns.get(STAMP) else TIMESTAMP
    if not columns.get(name):
        raise InputError(f"{path}: has no frames with {TIMESTAMP}")
    try:
        if name == STAMP:
            return [int(s) for s in columns[STAMP]]
        return [ORIGIN + round(float(s) * NANOSECONDS) for s in columns[TIMESTAMP]]
    except (TypeError, ValueError, OverflowError) as err:
        unit = "nanoseconds" if name == STAMP else "seconds"
        raise InputError(f"{path}: {name} must be a number of {unit} for each frame") from err


def _imposed(commands: Sequence[Command], stamp: int) -> FloatArray:
    """Poses of all imposed things at a stamp [ns], shape (7 K,)."""
    command = Motion(list(commands)).at(stamp)
    assert command is not None
    return np.hstack(command.sample(stamp)).ravel()


def _vectors(arrow: Any, values: np.ndarray) -> Any:
    return arrow.FixedSizeListArray.from_arrays(arrow.array(values.ravel()), values.shape[1])


def _data(pattern: str, episode: int, chunk: int = CHUNK) -> str:
    try:
        return pattern.format(episode_chunk=episode // chunk, episode_index=episode)
    except (KeyError, IndexError, ValueError) as err:
        raise InputError(
            f"data_path '{pattern}' is not that of LeRobot {VERSION}, which is read here"
        ) from err


def _lines(objects: Sequence[Mapping[str, Any]]) -> str:
    return "".join(json.dumps(o) + "\n" for o in objects)


def _info(
    settings: Settings, names: Sequence[str], episodes: int, frames: int, rate: float
) -> dict[str, Any]:
    state = spline_columns(settings.rod.control_points)
    action = [f"{name}.{c}" for name in names for c in POSE]
    features: dict[str, Any] = {
        STATE: {"dtype": "float32", "shape": [len(state)], "names": state},
        ACTION: {"dtype": "float32", "shape": [len(action)], "names": action},
        TIMESTAMP: {"dtype": "float32", "shape": [1], "names": None},
    }
    features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in COUNTERS}
    return {
        "codebase_version": VERSION, "robot_type": "dlo", "total_episodes": episodes,
        "total_frames": frames, "total_tasks": 1, "total_videos": 0,
        "total_chunks": -(-episodes // CHUNK), "chunks_size": CHUNK, "fps": round(rate, 6),
        "splits": {"train": f"0:{episodes}"}, "data_path": DATA, "video_path": None,
        "features": features,
    }  # fmt: skip


def _read_info(folder: Path) -> dict[str, Any]:
    path = folder / INFO
    try:
        info = json.loads(path.read_text())
    except OSError as err:
        raise InputError(
            f"{path}: cannot be read ({err.strerror}); give the folder of a LeRobot data set"
        ) from err
    except ValueError as err:
        raise InputError(f"{path}: is no JSON") from err
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise InputError(f"{path}: has no features")
    return info
