# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled code never outlives a change of the sources."""

import subprocess
import sys
import time

from conftest import ROOT

from dlo_ros import kernel_cache
from dlo_ros.kernel_cache import discard_stale


def make(package):
    for folder in (package, package / "rod"):
        (folder / "__pycache__").mkdir(parents=True)
        (folder / "kernels.py").write_text("@njit\ndef f(): pass\n")
        (folder / "__pycache__" / "kernels.f-1.py311.nbi").write_bytes(b"index")
        (folder / "__pycache__" / "kernels.f-1.py311.1.nbc").write_bytes(b"code")
        (folder / "__pycache__" / "kernels.cpython-311.pyc").write_bytes(b"bytecode")
    return lambda: sorted(p.suffix for p in package.rglob("__pycache__/kernels*"))


def test_a_change_anywhere_discards_all_compiled_code(tmp_path):
    left = make(tmp_path)
    assert discard_stale(tmp_path)  # nobody knows what it was compiled from
    assert left() == [".pyc", ".pyc"]
    (tmp_path / "rod" / "__pycache__" / "kernels.f-1.py311.nbi").write_bytes(b"index")
    assert not discard_stale(tmp_path)
    assert left() == [".nbi", ".pyc", ".pyc"]
    (tmp_path / "plain.py").write_text("x = 2\n")
    assert not discard_stale(tmp_path)
    (tmp_path / "kernels.py").write_text("@njit\ndef f(): return 1\n")
    assert discard_stale(tmp_path)
    assert left() == [".pyc", ".pyc"]


def test_a_folder_that_cannot_be_written_is_left_alone(tmp_path):
    (tmp_path / "kernels.py").write_text("x = 1\n")
    (tmp_path / "__pycache__").write_text("a file in the way")
    assert not discard_stale(tmp_path)


def test_a_long_compilation_is_told_once_and_a_short_one_not(monkeypatch):
    monkeypatch.setattr(kernel_cache, "LONG", 0.1)
    told = []
    with kernel_cache.announced(told.append):
        pass
    time.sleep(0.2)
    assert told == []
    with kernel_cache.announced(told.append):
        time.sleep(0.3)
    assert told == [kernel_cache.NOTICE]


def test_everything_is_compiled_by_one_command():
    """Or loaded, where it was compiled before, as everything was that other tests have run."""
    done = subprocess.run(
        [sys.executable, "-m", "dlo_ros.compile"],
        capture_output=True, text=True, cwd=ROOT, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    first, *stages = done.stdout.splitlines()
    assert first.startswith("Compiling")
    assert [line.split(":")[0].strip() for line in stages] == ["rod", "vision", "synthesis"]
