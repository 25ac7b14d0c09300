# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A full disk, a read-only folder, a kill -9 in between: no half result that looks whole.

The tools run as processes of their own. A limit on the size of files stands for the full disk: the
same calls fail in the same places, with another number.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import ROOT
from ordinary import some_of
from small_bags import SETTINGS, write_own
from vision_scenes import Scene, bow, render

from dlo_ros.cli.identify import _Kept, _key
from dlo_ros.cli.loading import load_manipulation
from dlo_ros.cli.results import check_results_folder
from dlo_ros.errors import InputError
from dlo_ros.files import write_bytes, write_text
from dlo_ros.observation import CentrelinePoints, Wrenches
from dlo_ros.recordings import read_recording

LIMIT = 400
"""Bytes that a file may have on the full disk; every result is larger."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag, its parameter file, and a photograph."""
    folder = tmp_path_factory.mktemp("inputs")
    write_own(folder / "bag")
    SETTINGS.with_effects({}).dump(folder / "params.yaml")
    picture = render(bow(), Scene(width_px=5.0, size=(480, 270)))
    cv2.imwrite(str(folder / "photo.png"), picture)
    return folder


TOOLS = {
    "predict": ("--params", "params.yaml", "bag"),
    "identify": ("--params", "params.yaml", "bag"),
    "synthesize": ("c_shape", "--no-images"),
    "observe": ("photo.png",),
}
WITH_DEAR_ONES = some_of(TOOLS, ["observe"])
RESULTS = {
    "predict": ("metadata.yaml", "result.mcap"),
    "identify": ("estimate.json", "estimate.yaml", "report.html"),
    "synthesize": ("metadata.yaml", "params.yaml", "result.mcap", "truth.yaml"),
    "observe": ("photo.csv", "photo.png"),
}


def start(
    tool: str, inputs: Path, output: Path, before: str = "", after: str = ""
) -> subprocess.CompletedProcess:
    """Run a tool between some lines of Python."""
    words = [tool, *TOOLS[tool], "--output", str(output)]
    code = (
        f"import sys\n{before}\nfrom dlo_ros.cli.main import main\n"
        f"status = main({words!r})\n{after}\nsys.exit(status)"
    )
    environment = dict(os.environ, PYTHONPATH=str(ROOT), OMP_NUM_THREADS="1")
    return subprocess.run(
        [sys.executable, "-c", code], cwd=inputs, env=environment, capture_output=True, text=True,
        timeout=300,
    )  # fmt: skip


def said(done: subprocess.CompletedProcess) -> str:
    """The last line on stderr, warnings of libraries aside."""
    assert "Traceback" not in done.stderr, done.stderr
    return done.stderr.strip().splitlines()[-1] if done.stderr.strip() else ""


def visible(folder: Path) -> list[str]:
    """What a person sees there."""
    if not folder.exists():
        return []
    return sorted(p.name for p in folder.rglob("*") if not p.name.startswith("."))


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("tool", WITH_DEAR_ONES)
def test_full_disk(tool: str, inputs: Path, tmp_path: Path) -> None:
    limit = (
        "import resource; free = resource.getrlimit(resource.RLIMIT_FSIZE)\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({LIMIT}, free[1]))"
    )
    # `make coverage` writes what it has counted as the process ends.
    lifted = "resource.setrlimit(resource.RLIMIT_FSIZE, free)"
    done = start(tool, inputs, tmp_path / "result", limit, lifted)
    assert done.returncode == 2, (done.returncode, done.stderr)
    assert "cannot be written (File too large)" in said(done), done.stderr
    assert str(tmp_path / "result") in said(done)
    assert visible(tmp_path / "result") == []
    # Nothing hidden is left behind either: the disk is full.
    assert [p for p in tmp_path.rglob(".*") if p.is_file() and p.stat().st_size] == []


@pytest.mark.parametrize("tool", WITH_DEAR_ONES)
def test_folder_that_cannot_be_written(tool: str, inputs: Path, tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o555)
    if os.geteuid() == 0:  # whom no permission holds back
        folder = Path("/proc/self/fdinfo")
    done = start(tool, inputs, folder / "result")
    assert done.returncode == 2, (done.returncode, done.stderr)
    assert str(folder / "result") in said(done) and said(done).startswith(f"dlo_ros {tool}: ")


@pytest.mark.long
@pytest.mark.parametrize(("tool", "rename"), [
    ("observe", 2),
    *(pytest.param(*costly, marks=pytest.mark.slow)
      for costly in [("predict", 1), ("synthesize", 1), ("identify", 1), ("identify", 2)]),
])  # fmt: skip
def test_killed_in_between(tool: str, rename: int, inputs: Path, tmp_path: Path) -> None:
    """Killed where it would show a result: what is there is whole, and a second run succeeds."""
    kill = f"""
import os, pathlib
left = [{rename}]
def patched(original):
    def rename(*words):
        left[0] -= 1
        if not left[0]:
            os.kill(os.getpid(), {int(signal.SIGKILL)})
        return original(*words)
    return rename
pathlib.Path.replace = patched(pathlib.Path.replace)
pathlib.Path.rename = patched(pathlib.Path.rename)
"""
    output = tmp_path / "result"
    done = start(tool, inputs, output, kill)
    assert done.returncode == -signal.SIGKILL, (done.returncode, done.stderr)
    there = visible(output)
    assert len(there) == rename - 1
    for name in there:
        if name.endswith(".json"):
            json.loads((output / name).read_text())
    assert start(tool, inputs, output).returncode == 0
    assert visible(output) == sorted(RESULTS[tool])
    if tool == "predict":
        found, given = (read_recording(path, SETTINGS) for path in (output, inputs / "bag"))
        assert len(found.observations) == len(given.observations)


def test_an_old_file_stays_where_the_new_one_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "estimate.yaml"
    write_text(path, "old\n")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"estimate.yaml: cannot be written \(No space left"):
        write_bytes(path, b"new\n")
    assert path.read_text() == "old\n" and [p.name for p in tmp_path.iterdir()] == [path.name]
    monkeypatch.undo()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    assert soft == resource.RLIM_INFINITY or soft > LIMIT, hard
    with pytest.raises(InputError, match="cannot be written"):
        write_text(tmp_path / "no" / "folder", "new\n")


def test_results_kept_for_a_later_run_are_those_that_were_kept(tmp_path: Path) -> None:
    """A file that was cut short or changed meanwhile does not count."""
    path = tmp_path / ".identify.part.json"
    kept = _Kept(path, "key")
    kept.add(3, np.array([1.0, 2.5, -3.0, 0.125]))
    kept.add(4, np.array([2.0, 2.5, -3.0, 0.5]))
    again = _Kept(path, "key")
    assert sorted(again.results) == [3, 4]
    np.testing.assert_array_equal(again.results[3], [1.0, 2.5, -3.0, 0.125])
    assert _Kept(path, "another").results == {}
    whole = path.read_bytes()
    for at in range(len(whole)):
        broken = bytearray(whole)
        broken[at] ^= 1 << (at % 8)
        for data in (bytes(broken), whole[:at]):
            path.write_bytes(data)
            found = _Kept(path, "key").results
            assert found == {} or all(np.array_equal(found[k], kept.results[k]) for k in found)


def test_results_of_other_recordings_are_not_gone_on_with(inputs: Path) -> None:
    """Any number of a recording counts: its stamps, its points, how its clamps turn, its forces."""
    found = load_manipulation(inputs / "bag", SETTINGS)
    first, *rest = found.observations
    (command, *later) = found.commands
    cloud = CentrelinePoints(np.zeros((1, 3)), np.zeros(1), np.full(1, 1e-3))
    felt = Wrenches.along_axes("start", np.array([first.stamp]), np.ones((1, 6)))
    turned = np.broadcast_to([0.0, 1.0, 0.0, 0.0], command.rotations.shape)
    others = [
        replace(found, observations=(replace(first, stamp=first.stamp - 1), *rest)),
        replace(found, observations=(replace(first, points=cloud), *rest)),
        replace(found, commands=(replace(command, stamp=command.stamp + 1), *later)),
        replace(found, commands=(replace(command, rotations=turned), *later)),
        replace(found, wrenches=(felt,)),
        replace(found, start="moving"),
    ]
    keys = {_key([one], SETTINGS) for one in (found, *others)}
    assert len(keys) == 1 + len(others)
    assert _key([load_manipulation(inputs / "bag", SETTINGS)], SETTINGS) in keys


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InputError, match=r"below: cannot be written \(.*file is a file\)"):
        check_results_folder(file / "far" / "below")
    check_results_folder(tmp_path / "far" / "below")
    assert not (tmp_path / "far").exists()
    if os.geteuid():  # root may write everywhere
        closed = tmp_path / "closed"
        closed.mkdir(mode=0o500)
        with pytest.raises(InputError, match="no permission"):
            check_results_folder(closed / "out")
