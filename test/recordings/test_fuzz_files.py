# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Bags, parameter, experiment and camera files, cut short and with flipped bits in many places.

`make fuzz` damages each file in 400 places, the ordinary tests in 40. A damaged file is refused by
one clear line, or leads to the right result, or to a warning. What no reader can know is a digit of
a parameter file, or a number in a bag that carries no checksum, that has turned into another.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import random
import shutil
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recordings_samples as samples
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from small_bags import SETTINGS, recorded, write_own

from dlo_ros.cli.main import main
from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    iterate_images,
    read_recording,
)
from dlo_ros.synthesis.experiment import find_experiment, load_experiment
from dlo_ros.vision.calibration.camera_file import camera_file, read_camera_file
from dlo_ros.vision.calibration.camera_fit import Intrinsics

PLACES = int(os.environ.get("DLO_FUZZ_FILES", "40"))
PATIENCE = 60
"""Seconds after which a damaged file counts as a hang."""


ZSTD = CompressionFormat.ZSTD
KINDS: dict[str, Callable[[Path], Any]] = {
    "own": write_own,
    "mcap": lambda path: samples.write_plain(path, recorded()),
    "sqlite3": lambda path: samples.write_plain(path, recorded(), StoragePlugin.SQLITE3),
    "sqlite3 in zstd": lambda path: samples.write_plain(
        path, recorded(), StoragePlugin.SQLITE3, (CompressionMode.FILE, ZSTD)
    ),
}


def damages(whole: bytes, rng: random.Random, count: int) -> Iterator[tuple[str, bytes]]:
    """Copies of a file that are cut short, and copies with one flipped bit."""
    for k in range(count):
        if k % 3 == 0:
            at = rng.randrange(len(whole))
            yield f"cut at {at}", whole[:at]
        else:
            at, bit = rng.randrange(len(whole)), rng.randrange(8)
            broken = bytearray(whole)
            broken[at] ^= 1 << bit
            yield f"bit {bit} of byte {at} flipped", bytes(broken)


@contextlib.contextmanager
def warnings() -> Iterator[list[str]]:
    """What the package warns of meanwhile."""
    told: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: told.append(record.getMessage())
    logger = logging.getLogger("dlo_ros")
    logger.addHandler(handler)
    try:
        yield told
    finally:
        logger.removeHandler(handler)


@contextlib.contextmanager
def in_time(what: str) -> Iterator[None]:
    """A hang is a failure."""

    def late(*_: Any) -> None:
        raise AssertionError(f"{what}: hangs")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def content(path: Path) -> list[bytes]:
    """All that the tools take from a bag."""
    recording = read_recording(path, SETTINGS)
    result = []
    for command in recording.commands:
        result.append(repr((command.stamp, command.names)).encode())
        result += [a.tobytes() for a in (command.times, command.positions, command.rotations)]
    for observation in recording.observations:
        result += [repr(observation.stamp).encode(), observation.control_points.tobytes()]
        points = observation.points
        if points is not None:
            result += [points.positions.tobytes(), points.u.tobytes(), points.std.tobytes()]
    for stamp, picture, info in iterate_images(path, logging.getLogger("dlo_ros").warning):
        result += [repr((stamp, info)).encode(), picture.tobytes()]
    return result


def run(*words: str) -> tuple[int, str]:
    """A tool in this process: exit status, and what it wrote to stderr without its warnings."""
    stderr = io.StringIO()
    with contextlib.redirect_stderr(stderr), contextlib.redirect_stdout(io.StringIO()):
        status = main(list(words))
    lines = stderr.getvalue().splitlines()
    return status, "\n".join(line for line in lines if not line.startswith("WARNING"))


def one_line(status: int, said: str, what: str) -> None:
    """Exit status 2 and a line that a person understands."""
    assert status == 2, f"{what}: status {status}: {said}"
    last = said.strip().splitlines()
    assert len(last) == 1 and last[0].startswith("dlo_ros "), f"{what}: {said}"
    assert "Traceback" not in said and "Error:" not in said, f"{what}: {said}"


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bags(kind: str, tmp_path: Path) -> None:
    """Refused, or the same content, or a warning; with a checksum nothing else is possible."""
    whole_bag = tmp_path / "whole"
    KINDS[kind](whole_bag)
    params = tmp_path / "params.yaml"
    SETTINGS.dump(params)
    truth = content(whole_bag)
    rng, outcomes = random.Random(1), Counter[str]()
    for stored in sorted(whole_bag.iterdir()):
        whole = stored.read_bytes()
        for number, (what, data) in enumerate(damages(whole, rng, PLACES)):
            copy = tmp_path / "copy"
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(whole_bag, copy)
            (copy / stored.name).write_bytes(data)
            what = f"{kind}, {stored.name} {what}"
            with in_time(what), warnings() as told:
                try:
                    found = content(copy)
                except InputError as err:
                    assert "\n" not in str(err) and str(copy) in str(err), f"{what}: {err}"
                    outcome = "refused"
                else:
                    same = "same" if found == truth else "other"
                    outcome = f"{same}, warned" if told else f"{same}, silent"
            outcomes[outcome] += 1
            if kind == "own" and stored.suffix == ".mcap":
                assert outcome != "other, silent", what
            if number % 10 == 0:
                output = tmp_path / "predicted"
                words = ("predict", "--params", str(params), "--output", str(output), str(copy))
                with in_time(what):
                    status, said = run(*words, "--force")
                if status:
                    one_line(status, said, what)
                    assert not output.exists(), what
                else:
                    shutil.rmtree(output)
    print(f"\n{kind}: {dict(outcomes)}")
    assert outcomes["refused"] > 0.2 * sum(outcomes.values())


def test_damaged_parameter_files(tmp_path: Path) -> None:
    """Refused, or loaded with values in their ranges; what is cut short is told of."""
    path, outcomes = tmp_path / "params.yaml", Counter[str]()
    whole = SETTINGS.text("Made by a test.").encode()
    for what, data in damages(whole, random.Random(2), 5 * PLACES):
        path.write_bytes(data)
        with in_time(what), warnings() as told:
            try:
                found = Settings.load(path)
            except InputError as err:
                assert "\n" not in str(err) and str(path) in str(err), err
                outcomes["refused"] += 1
                continue
        assert Settings.from_mapping(found.flat()) == found
        same = found == SETTINGS
        outcome = f"{'same' if same else 'other'}, {'warned' if told else 'silent'}"
        outcomes[outcome] += 1
        if what.startswith("cut") and len(data) < len(whole) - 5:
            assert told, f"{what} is not told of"
    print(f"\nparameters: {dict(outcomes)}")


@pytest.mark.parametrize("name", ["c_shape", "different"])
def test_damaged_experiment_files(name: str, tmp_path: Path) -> None:
    whole = find_experiment(name).read_bytes()
    path, outcomes = tmp_path / "experiment.yaml", Counter[str]()
    for what, data in damages(whole, random.Random(3), 2 * PLACES):
        path.write_bytes(data)
        with in_time(what):
            try:
                load_experiment(path)
                outcomes["loaded"] += 1
            except InputError as err:
                assert "\n" not in str(err) and str(path) in str(err), f"{what}: {err}"
                outcomes["refused"] += 1
    print(f"\n{name}: {dict(outcomes)}")
    assert outcomes["refused"] > PLACES // 2


def test_damaged_camera_files(tmp_path: Path) -> None:
    matrix = np.array([[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]])
    good = Intrinsics(matrix, (0.1, -0.05, 0.001, 0.0, 0.0), "plumb_bob", 640, 480)
    whole, outcomes = camera_file(good).encode(), Counter[str]()
    path = tmp_path / "camera_info.yaml"
    for what, data in damages(whole, random.Random(4), 5 * PLACES):
        path.write_bytes(data)
        with in_time(what):
            try:
                found = read_camera_file(path)
                assert np.all(np.isfinite(found.matrix)), what
                outcomes["loaded"] += 1
            except InputError as err:
                assert "\n" not in str(err) and str(path) in str(err), f"{what}: {err}"
                outcomes["refused"] += 1
    print(f"\ncamera_info: {dict(outcomes)}")
    assert outcomes["refused"] > PLACES


BOMBS = {
    "aliases": "a: &a [x, x]\n" + "".join(
        f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(12)
    ),
    "deep": "[" * 100_000,
    "no such day": "/**: {ros__parameters: {rod: {length: 2024-13-45}}}\n",
    "python": "!!python/object/apply:os.system ['touch hacked']\n",
    "digits": "/**: {ros__parameters: {rod: {length: " + "9" * 10_000 + "}}}\n",
    "no float": "/**: {ros__parameters: {rod: {length: " + "9" * 400 + "}}}\n",
    "exponent": "/**: {ros__parameters: {rod: {length: 1.0e+9999}}}\n",
    "list as key": "? [a, b]\n: 1\n",
    "binary": "/**: {ros__parameters: {rod: {length: !!binary 'a'}}}\n",
    "no text": "\x00\x01",
    "sexagesimal": "/**: {ros__parameters: {rod: {length: 190:20:30}}}\n",
    "nothing": "",
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_hostile_yaml(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Safe loading, and a line that says what is wrong, whichever file it is."""
    path = tmp_path / "file.yaml"
    path.write_text(BOMBS[name])
    monkeypatch.chdir(tmp_path)
    for read in (Settings.load, load_experiment, read_camera_file):
        with in_time(name), pytest.raises(InputError) as caught:
            read(path)
        assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    status, said = run("predict", "--params", str(path), "--output", str(tmp_path / "o"), "bag")
    one_line(status, said, name)
    assert not (tmp_path / "hacked").exists()


def test_a_file_that_is_no_file(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing.yaml", Path("/dev/zero")):
        with in_time(str(path)), pytest.raises(InputError, match=str(path)):
            Settings.load(path)
