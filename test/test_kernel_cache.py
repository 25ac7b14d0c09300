# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled code never outlives a change of the sources, wherever it is kept."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT
from ordinary import some_of

from dlo_ros import kernel_cache
from dlo_ros.compilation import BackgroundCompilation
from dlo_ros.errors import KernelError
from dlo_ros.kernel_cache import NUMBA_MISSING, find_folder, mark, njit, source_digest
from dlo_ros.kernel_parts import STAGES

SMALL = ("__init__.py", "errors.py", "kernel_cache.py", "kernel_parts.py")
CALLER = """
from dlo_ros.callee import carried
from dlo_ros.kernel_cache import njit

@njit()
def carry(x):
    return 10 * carried(x)
"""
CALLEE = """
from dlo_ros.kernel_cache import njit

@njit(from_python=False)
def carried(x):
    return x + {more}
"""
ANSWER = """
from dlo_ros.caller import carry
from dlo_ros.kernel_cache import cache_folder
print(carry(1), carry.stats.cache_hits[carry.signatures[0]] if carry.stats.cache_hits else 0)
print(cache_folder())
"""


@njit(from_python=False)
def doubled(x):
    return x + x


@njit(from_python=False, constants=True)
def tripled(x):
    return x + x + x


def test_constants_are_not_compiled_anew_unless_asked_for():
    import numba

    @numba.njit
    def both(x):
        return doubled(x) + doubled(2) + doubled(3) + tripled(x) + tripled(2)

    assert both(1) == 2 + 4 + 6 + 3 + 6
    assert len(doubled.overloads) == 1
    assert len(tripled.overloads) == 2


@pytest.fixture
def package(tmp_path):
    """A small dlo_ros with a compiled function that calls one of another file."""
    folder = tmp_path / "source" / "dlo_ros"
    folder.mkdir(parents=True)
    for name in SMALL:
        shutil.copy(ROOT / "dlo_ros" / name, folder)
    (folder / "caller.py").write_text(CALLER)
    (folder / "callee.py").write_text(CALLEE.format(more=1))
    return folder


def answer(package, **variables):
    """What `carry(1)` is in a process of its own, loads from the cache, and the cache folder."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    environment |= {"PYTHONPATH": str(package.parent), **variables}
    done = subprocess.run(
        [sys.executable, "-c", ANSWER],
        env=environment, cwd=package.parent, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result, hits, folder = done.stdout.split()
    return int(result), int(hits), Path(folder)


ELSEWHERE = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")


@pytest.fixture(params=["package", *(pytest.param(p, marks=pytest.mark.slow) for p in ELSEWHERE)])
def place(request, package, tmp_path):
    """Variables that lead to each of the places, and the place."""
    if request.param == "package":
        return {}, package / "__pycache__"
    kept = tmp_path / "kept"
    if request.param == "NUMBA_CACHE_DIR":
        return {request.param: str(kept)}, kept
    (package / "__pycache__").write_text("a file in the way of the folder")
    return {request.param: str(kept)}, kept / "dlo_ros"


@pytest.mark.slow
def test_a_changed_callee_is_compiled_anew_and_the_old_code_removed(package, place):
    variables, parent = place
    result, hits, first = answer(package, **variables)
    assert (result, hits) == (20, 0) and first.parent == parent
    codes = {code.name.partition(".")[0]: code.read_bytes() for code in first.rglob("*.nbc")}
    assert b"_ZN7cpython" in codes["caller"] and b"_ZN7cpython" not in codes["callee"]
    assert not any(b"cfunc." in code for code in codes.values())
    assert answer(package, **variables) == (20, 1, first)  # loaded
    (package / "callee.py").write_text(CALLEE.format(more=5))
    result, hits, second = answer(package, **variables)
    assert (result, hits) == (60, 0)
    assert second.parent == parent and not first.exists()
    (package / "plain.py").write_text("x = 1\n")
    assert answer(package, **variables) == (60, 1, second)


@pytest.mark.slow
def test_two_installations_share_a_place(package, tmp_path):
    other = tmp_path / "other" / "dlo_ros"
    shutil.copytree(package, other)
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    first = answer(package, **kept)[2]
    (other / "callee.py").write_text(CALLEE.format(more=2))
    assert answer(other, **kept)[0] == 30
    assert answer(package, **kept) == (20, 1, first)


@pytest.mark.slow
def test_a_package_that_has_moved_leaves_nothing_behind(package, tmp_path):
    first = answer(package)[2]
    (package / "callee.py").write_text(CALLEE.format(more=2))
    moved = package.rename(tmp_path / "dlo_ros")
    assert answer(moved)[2].parent == moved / "__pycache__"
    assert not (moved / "__pycache__" / first.name).exists()


def test_the_digest_holds_the_version_of_numba(package, monkeypatch):
    before = source_digest(package)
    assert source_digest(package) == before
    monkeypatch.setattr("numba.__version__", "0.1")
    assert source_digest(package) != before


def test_the_digest_covers_sub_packages(package):
    folder = package / "solve"
    folder.mkdir()
    caller = "from dlo_ros.solve.constants import MORE" + CALLEE.format(more="MORE")
    digests = []
    for more, name in (("1", "MORE"), ("1", "2 * MORE"), ("3", "2 * MORE")):
        (folder / "constants.py").write_text(f"MORE = {more}\n")
        (folder / "inner.py").write_text(caller.replace("x + MORE", f"x + {name}"))
        digests.append(source_digest(package))
    assert len(set(digests)) == 3


@pytest.mark.slow
def test_a_constant_of_another_module_is_part_of_the_machine_code(package):
    (package / "constants.py").write_text("MORE = 1\n")
    callee = "from dlo_ros.constants import MORE" + CALLEE.format(more="MORE")
    (package / "callee.py").write_text(callee)
    assert answer(package)[0] == 20
    # The file gets another length: bytecode of the same second and size would be taken for its own.
    (package / "constants.py").write_text("MORE = 1 + 2\n")
    assert answer(package)[:2] == (40, 0)


def test_places_that_cannot_be_written_are_told_in_a_line(tmp_path, monkeypatch):
    package = tmp_path / "dlo_ros"
    package.mkdir()
    (package / "__pycache__").write_text("in the way")
    (tmp_path / "cache").write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(KernelError, match=r"set NUMBA_CACHE_DIR") as caught:
        find_folder(package, "", "0")
    assert str(package / "__pycache__") in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(KernelError, match=r"^NUMBA_CACHE_DIR is .*cache, which cannot be written"):
        find_folder(package, str(tmp_path / "cache"), "0")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("nobody")))
    with pytest.raises(KernelError, match="NUMBA_CACHE_DIR"):
        find_folder(package, "", "0")
    assert find_folder(package, str(tmp_path / "fine"), "0").is_dir()


# --- folders that can only be read ---------------------------------------------------------------

PARTS = [part.name for stage in STAGES.values() for part in stage]


@pytest.fixture
def readable(tmp_path, monkeypatch):
    """A package whose folder of machine code can be read only, and the user's cache."""
    folder = find_folder(tmp_path / "dlo_ros", "", "0")
    user = tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(user))
    closed = {folder}
    # Permissions do not hold root back, as which tests may run.
    monkeypatch.setattr(kernel_cache, "_writable", lambda f: f not in closed and _made(f))
    return tmp_path / "dlo_ros", folder, user, closed


def _made(folder):
    folder.mkdir(parents=True, exist_ok=True)
    return True


def test_a_read_only_folder_serves_where_all_is_compiled_in_it(readable):
    package, folder, user, _ = readable
    for name in PARTS[:-1]:
        mark(folder, name).touch()
    mine = find_folder(package, "", "0")
    assert mine.is_relative_to(user)
    mark(folder, PARTS[-1]).touch()
    assert find_folder(package, "", "0") == folder
    assert find_folder(package, "", "1").is_relative_to(package)  # an update; this one can be made


def test_where_nothing_can_be_written_what_is_compiled_is_used(readable, monkeypatch):
    package, folder, user, closed = readable
    closed.add(user / "dlo_ros" / folder.name)
    with pytest.raises(KernelError, match="set NUMBA_CACHE_DIR"):
        find_folder(package, "", "0")
    for part in STAGES["vision"]:
        mark(folder, part.name).touch()
    assert find_folder(package, "", "0") == folder
    monkeypatch.setattr("dlo_ros.compilation.cache_folder", lambda: folder)
    kernel_cache.writable.cache_clear()
    try:
        observer = BackgroundCompilation(["vision"])
        assert not observer.start() and observer.poll().done
        with pytest.raises(KernelError, match="NUMBA_CACHE_DIR"):
            BackgroundCompilation(["vision", "rod"])
    finally:
        kernel_cache.writable.cache_clear()


CLOSED = """
import sys
from pathlib import Path
from dlo_ros import kernel_cache
kernel_cache._writable = lambda folder: False
import numba.core.caching as caching
def closed(self):
    raise PermissionError(13, "Permission denied")
for one in caching._CacheLocator.__subclasses__():
    one.ensure_cache_path = closed
    for another in one.__subclasses__():
        another.ensure_cache_path = closed
"""


@pytest.mark.slow
def test_machine_code_is_loaded_from_a_folder_that_can_only_be_read(package):
    """What is missing there is compiled for this process alone."""
    first = answer(package)[2]
    for name in PARTS:
        mark(first, name).touch()
    before = {p: p.stat().st_mtime_ns for p in first.rglob("*")}
    done = subprocess.run(
        [sys.executable, "-c", f"{CLOSED}\n{ANSWER}\nprint(carry(1.5))"],
        env={**os.environ, "PYTHONPATH": str(package.parent), "NUMBA_CACHE_DIR": ""},
        cwd=package.parent, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["20", "1", str(first), "25.0"]
    assert {p: p.stat().st_mtime_ns for p in first.rglob("*")} == before


@pytest.mark.parametrize(
    "name",
    some_of(
        ["observer", "simulator", "identifier", "predict", "identify"], ["simulator", "identify"]
    ),
)
def test_an_unwritable_cache_ends_nodes_and_tools_with_a_line(name, tmp_path):
    (tmp_path / "file").write_text("")
    environment = dict(os.environ, NUMBA_CACHE_DIR=str(tmp_path / "file"))
    words = [] if name.endswith("er") or name == "simulator" else ["--params", "p", "bag"]
    done = subprocess.run(
        [sys.executable, "-m", "dlo_ros", name, *words],
        env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith(f"dlo_ros {name}: NUMBA_CACHE_DIR is {tmp_path}/file")
    assert done.stderr.count("\n") == 1


WITHOUT_NUMBA = """
import sys

class NoNumba:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("numba", "llvmlite"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NoNumba())
"""


@pytest.mark.parametrize("name", some_of(["observer", "predict", "synthesize"], ["predict"]))
def test_a_missing_numba_is_told_in_a_line(name, tmp_path):
    words = {"observer": [], "predict": ["--params", "p", "bag"], "synthesize": ["c_shape"]}[name]
    words = [name, *words, *(["--output", str(tmp_path / "x")] if name == "synthesize" else [])]
    code = WITHOUT_NUMBA + f"from dlo_ros.cli.main import main; sys.exit(main({words!r}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == f"dlo_ros {name}: {NUMBA_MISSING}\n"


def test_a_missing_numba_is_told_by_the_compilation():
    code = WITHOUT_NUMBA + "from dlo_ros.compile import main; sys.exit(main([]))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, f"{NUMBA_MISSING}\n")
