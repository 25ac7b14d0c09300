# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled by processes of their own, once for all, whatever happens to one of them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import ROOT

from dlo_ros import compilation
from dlo_ros.compilation import (
    BackgroundCompilation,
    CompilationProgress,
    PartFiles,
    compile_first,
    held,
)
from dlo_ros.errors import KernelError
from dlo_ros.kernel_cache import cache_folder, machine
from dlo_ros.kernel_parts import STAGES, Part

PATIENCE = 60.0  # [s], beside other tests
STAND_IN = """
import os, sys, time
from pathlib import Path
from dlo_ros import compilation, compile
from dlo_ros.kernel_parts import Part

FOLDER = Path({folder!r})
compilation.cache_folder = compile.cache_folder = lambda: FOLDER
compile.STAGES = {{
    "quick": (Part("quick", "stand_in:quick", 1.0, 1),),
    "slow": (Part("slow", "stand_in:slow", 3.0, 1),),
    "broken": (Part("broken", "stand_in:broken", 1.0, 1),),
    "full": (Part("full", "stand_in:full", 1.0, 1),),
}}

def note(name):
    with (FOLDER / "begun").open("a") as file:
        file.write(f"{{name}} {{os.getpid()}}\\n")

def quick():
    note("quick")

def slow():
    note("slow")
    while not (FOLDER / "go").exists():
        time.sleep(0.02)

def broken():
    raise ZeroDivisionError("a kernel of no use")

def full():
    raise OSError(28, "No space left on device", str(FOLDER / "x.nbc"))

if __name__ == "__main__":
    sys.modules["stand_in"] = sys.modules["__main__"]
    sys.exit(compile.main(sys.argv[1:]))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache folder in which stand-ins are compiled."""
    kept = tmp_path / "cache"
    kept.mkdir()
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN.format(folder=str(kept)))
    monkeypatch.setattr(compilation, "cache_folder", lambda: kept)
    monkeypatch.setattr(compilation, "WORKER", (sys.executable, str(script), "--worker"))
    stages = {
        name: (Part(name, f"stand_in:{name}", 3.0 if name == "slow" else 1.0, 1),)
        for name in ("quick", "slow", "broken", "full")
    }
    monkeypatch.setattr(compilation, "STAGES", stages)
    return kept


@pytest.fixture
def begin():
    """Starts compilations that end with the test."""
    begun = []

    def start(*stages):
        begun.append(BackgroundCompilation(stages))
        began = time.monotonic()
        assert begun[-1].start()
        assert time.monotonic() - began < 1.0
        return begun[-1]

    yield start
    for compilation_ in begun:
        compilation_.stop()


def until(condition):
    """Wait, and give what the condition gives."""
    limit = time.monotonic() + PATIENCE
    while not (result := condition()):
        assert time.monotonic() < limit
        time.sleep(0.02)
    return result


def ended(compilation_):
    """The progress when there is a result or an error."""
    return until(lambda: (p := compilation_.poll()) and (p.done or p.error) and p)


def begun(folder):
    """Name and process of each part that was begun."""
    file = folder / "begun"
    return [line.split() for line in file.read_text().splitlines()] if file.exists() else []


@pytest.mark.slow
def test_several_share_one_compilation(folder, begin):
    every = [begin("quick", "slow") for _ in range(3)]
    until(lambda: len(begun(folder)) == 2)
    until(lambda: every[0].poll().fraction == pytest.approx(0.25))
    for one in every:
        progress = one.poll()
        assert not progress.done and not progress.error
        assert progress.fraction == pytest.approx(0.25)
    (folder / "go").touch()
    for one in every:
        assert ended(one) == CompilationProgress(True, 1.0, 0.0)
    assert sorted(name for name, _ in begun(folder)) == ["quick", "slow"]
    assert not list(folder.glob("*.progress"))


def test_no_kernel_has_numbas_strings_in_it():
    # An array written to a slice of another compiles them, for the message of an error.
    compilation.compile_first(list(STAGES), print)
    codes = {code.name: code.read_bytes() for code in cache_folder().rglob("*.nbc")}
    assert len(codes) > 200
    assert not [name for name, code in codes.items() if b"raise_with_shape_context" in code]


def test_nothing_is_compiled_where_all_is_there(folder, monkeypatch):
    for name in ("quick", "slow"):
        PartFiles(folder, name).finish()
    monkeypatch.setattr(compilation, "WORKER", ("/no/such/program",))
    one = BackgroundCompilation(("quick", "slow"))
    assert not one.start() and one.poll().done
    told = []
    compile_first(("slow",), told.append)
    assert told == []


def test_a_mark_of_another_processor_does_not_count(folder, monkeypatch):
    PartFiles(folder, "quick").finish()
    monkeypatch.setattr("dlo_ros.kernel_cache.machine", lambda: "another")
    assert not PartFiles(folder, "quick").complete


@pytest.mark.slow
def test_what_one_has_left_another_takes_over(folder, begin):
    first = begin("slow")
    until(lambda: begun(folder))
    second = begin("slow")
    first.stop()
    until(lambda: len(begun(folder)) == 2)
    (folder / "go").touch()
    assert ended(second).done
    assert first.poll().done  # it made nothing, but there it is


def test_a_killed_process_is_told_in_a_line(folder, begin):
    one = begin("slow")
    (_, process), *_ = until(lambda: begun(folder))
    os.kill(int(process), signal.SIGKILL)
    progress = ended(one)
    assert not progress.done and progress.remaining_seconds is None
    assert progress.error.endswith("the compiling process was killed (signal 9)")
    assert one.poll().error == str(progress)
    (folder / "go").touch()  # another try succeeds
    assert ended(begin("slow")).done
    assert one.poll().done


@pytest.mark.slow
def test_an_interrupt_ends_a_process_quietly(folder, begin):
    one = begin("slow")
    (_, process), *_ = until(lambda: begun(folder))
    os.kill(int(process), signal.SIGINT)
    assert "signal 2" in ended(one).error


@pytest.mark.parametrize(
    "stage, reason",
    [("broken", "ZeroDivisionError: a kernel of no use"), ("full", "No space left on device")],
)
def test_a_failure_is_told_in_a_line(folder, begin, stage, reason):
    error = ended(begin(stage)).error
    assert error.startswith("the numerical kernels could not be compiled: ")
    assert reason in error and "\n" not in error
    told = []
    with pytest.raises(KernelError, match=reason):
        compile_first((stage,), told.append)
    assert told[0] == compilation.FIRST_MESSAGE
    assert all(line.startswith("the numerical kernels: compiling") for line in told[1:])


def test_a_worker_that_ends_between_two_looks_has_done_its_work(folder, begin, monkeypatch):
    one = begin("slow")
    until(lambda: begun(folder))
    failure = one._failure

    def ends_now():
        (folder / "go").touch()
        for worker in one._workers:
            worker.wait(PATIENCE)
        return failure()

    monkeypatch.setattr(one, "_failure", ends_now)
    progress = one.poll()
    assert progress.done and not progress.error


def test_no_process_can_be_started(folder, monkeypatch):
    monkeypatch.setattr(compilation, "WORKER", ("/no/such/program",))
    one = BackgroundCompilation(("slow",))
    assert one.start()
    assert (
        one.poll().error == "the numerical kernels could not be compiled: No such file or directory"
    )


@pytest.mark.slow
def test_no_more_than_two_compile_at_a_time(folder, begin):
    from contextlib import ExitStack

    with ExitStack() as stack:
        for number in range(compilation.PROCESSES):
            name = f"process-{machine()}-{number}.lock"
            assert stack.enter_context(held(folder / name))
        one = begin("quick")
        time.sleep(1.0)
        assert not begun(folder) and not one.poll().done
    assert ended(one).done


@pytest.mark.slow
def test_processes_end_with_the_one_that_has_started_them(folder):
    code = (
        "import sys, time; sys.argv = ['x']; exec(open({script!r}).read().split('if __name')[0]);"
        "compilation.STAGES = compile.STAGES;"
        "compilation.WORKER = (sys.executable, {script!r}, '--worker');"
        "compilation.BackgroundCompilation(['slow']).start(); time.sleep(60)"
    ).format(script=str(folder.parent / "stand_in.py"))
    node = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    try:
        (_, process), *_ = until(lambda: begun(folder))
    finally:
        node.kill()
        node.wait()
    until(lambda: not _runs(int(process)))


def _runs(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    # Nobody may have taken note of its end.
    return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.slow
def test_the_rest_is_estimated_from_the_rate_so_far(folder, begin, monkeypatch):
    clock = iter([100.0, 101.0, 105.0, 110.0])
    one = begin("slow", "quick")
    until(lambda: len(begun(folder)) == 2)
    until(lambda: PartFiles(folder, "quick").complete)
    monkeypatch.setattr(compilation.time, "monotonic", lambda: next(clock))
    one._began = (next(clock), 0.0)
    assert one.poll().remaining_seconds is None  # too early to tell
    one._began = (100.0, 0.24)
    assert one.poll().remaining_seconds is None  # too little is made
    one._began = (100.0, 0.0)
    progress = one.poll()
    assert progress.remaining_seconds == pytest.approx(30.0)
    assert str(progress) == "compiling, 25 %, about 30 s"
    monkeypatch.undo()


def test_waiting_for_the_parts_of_others_does_not_count_as_slowness(folder, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(compilation.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(compilation, "STAGES", {"late": (Part("late", "x:late", 10.0, 10),)})
    one = BackgroundCompilation(["late"])
    one._began = (0.0, 0.0)
    now[0] = 300.0
    assert one.poll().remaining_seconds is None
    now[0] = 310.0
    PartFiles(folder, "late").report(5)
    assert one.poll().remaining_seconds == pytest.approx(10.0)


@pytest.mark.slow
def test_a_compilation_that_has_begun_is_not_announced_again(folder, begin, monkeypatch):
    one = begin("slow")
    until(lambda: begun(folder))
    one._began = (time.monotonic() - 100.0, -0.5)
    monkeypatch.setattr(compilation, "REPORT_INTERVAL", 0.2)
    told = []

    def tell(text):
        told.append(text)
        if len(told) == 2:
            (folder / "go").touch()

    one.wait(tell)
    first, *_ = told
    assert first.startswith("the numerical kernels: compiling, 0 %, about 20")
    assert compilation.FIRST_MESSAGE not in told


def test_the_parts_of_a_stage_count_together(folder, monkeypatch):
    """Which of them compiles what they share is a matter of chance."""
    parts = (Part("a", "x:a", 10.0, 30), Part("b", "x:b", 10.0, 10))
    monkeypatch.setattr(
        compilation, "STAGES", {"both": parts, "last": (Part("c", "x:c", 20.0, 5),)}
    )
    one = BackgroundCompilation(["both", "last"])
    a, b, c = (PartFiles(folder, name) for name in "abc")
    assert one.poll().fraction == 0.0
    a.report(5)
    b.report(15)
    assert one.poll().fraction == pytest.approx(0.25)
    b.finish(20)
    assert one.poll().fraction == pytest.approx(0.25 + 0.5 * 5 / 40)
    a.report(1000)  # the sources have grown since the functions were counted
    assert one.poll().fraction == pytest.approx(0.5 * 0.99)
    a.finish(1000)
    assert one.poll().fraction == 0.5
    c.finish()
    assert one.poll().done


def test_what_another_has_compiled_of_a_part_counts(folder):
    files = PartFiles(folder, "slow")
    assert files.functions == 0
    files.report(7)
    assert PartFiles(folder, "slow").functions == 7
    files.finish(9)
    assert PartFiles(folder, "slow").functions == 9
    files.mark.write_text("damaged")
    assert files.complete and files.functions == 0


def test_polling_is_cheap(folder, begin):
    one = begin("slow")
    began = time.perf_counter()
    for _ in range(100):
        one.poll()
    assert time.perf_counter() - began < 1.0
