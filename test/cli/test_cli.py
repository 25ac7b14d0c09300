# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`dlo_ros NAME`: names, help, versions, and what a user sees when something goes wrong."""

import importlib.util
import logging
import os
import shlex
import signal
import subprocess
import sys
import textwrap
import time
import types

import pytest
from conftest import ROOT

from dlo_ros import __main__ as start
from dlo_ros import __version__
from dlo_ros.cli import main as cli
from dlo_ros.errors import RecordingError


def pretend_tool(monkeypatch, behaviour):
    """Put a tool in the place of `play` that does as told."""
    module = types.ModuleType("dlo_ros.cli.play")
    module.add_arguments = lambda parser: parser.add_argument("bag", nargs="?")
    module.run = behaviour
    monkeypatch.setitem(sys.modules, "dlo_ros.cli.play", module)


def raising(err):
    def run(arguments):
        raise err

    return run


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"dlo_ros {__version__}"


def test_overview_names_everything(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    for name in cli.NAMES:
        assert f"  {name} " in text


def test_nothing_given_explains_itself(capsys):
    assert cli.main([]) == 2
    assert "usage: dlo_ros NAME" in capsys.readouterr().out


def test_unknown_name_lists_the_valid_ones(capsys):
    assert cli.main(["calibrat"]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and "'calibrat'" in text
    for name in cli.NAMES:
        assert name in text


@pytest.mark.parametrize("name", cli.NAMES)
def test_help_has_an_example(name, capsys):
    assert cli.main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"usage: dlo_ros {name}" in text
    assert f"example: dlo_ros {name} " in text


@pytest.mark.parametrize("executable", cli.EXECUTABLES, ids=lambda e: e.name)
def test_every_name_has_its_module(executable):
    package = "nodes" if executable.node else "cli"
    assert importlib.util.find_spec(f"dlo_ros.{package}.{executable.name}")


def test_arguments_reach_the_tool(monkeypatch):
    seen = []
    pretend_tool(monkeypatch, lambda a: seen.append(a.bag) or 7)
    assert cli.main(["play", "some/bag"]) == 7
    assert seen == ["some/bag"]


def test_unusable_input_is_one_line_and_2(monkeypatch, capsys):
    pretend_tool(monkeypatch, raising(RecordingError("bag x: is cut short;\n record it again")))
    assert cli.main(["play"]) == 2
    assert capsys.readouterr().err == "dlo_ros play: bag x: is cut short; record it again\n"


def test_a_file_that_cannot_be_written_is_named(monkeypatch, capsys, tmp_path):
    pretend_tool(monkeypatch, lambda a: (tmp_path / "none" / "out.json").write_text(""))
    assert cli.main(["play"]) == 2
    text = capsys.readouterr().err
    assert "out.json: No such file" in text and text.count("\n") == 1


def test_many_warnings_of_one_kind_are_counted(monkeypatch, capsys):
    def run(arguments):
        for i in range(30):
            logging.getLogger("dlo_ros.test").warning("message %d is skipped", i)
        logging.getLogger("dlo_ros.test").warning("another")
        return 0

    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    pretend_tool(monkeypatch, run)
    assert cli.main(["play"]) == 0
    assert capsys.readouterr().err.splitlines() == [
        *(f"WARNING: message {i} is skipped" for i in range(3)),
        "WARNING: another",
        "WARNING: 27 times more, this or the like: message 0 is skipped",
    ]


def test_the_same_warning_is_told_once(monkeypatch, capsys):
    def run(arguments):
        for _ in range(arguments):
            logging.getLogger("dlo_ros.test").warning("this is so")
        return 0

    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    pretend_tool(monkeypatch, lambda a: run(1))
    assert cli.main(["play"]) == 0
    assert capsys.readouterr().err.splitlines() == ["WARNING: this is so"]
    pretend_tool(monkeypatch, lambda a: run(2))
    assert cli.main(["play"]) == 0
    assert capsys.readouterr().err.splitlines() == [
        "WARNING: this is so",
        "WARNING: once more, this or the like: this is so",
    ]


def test_wrong_arguments_are_2(monkeypatch, capsys):
    pretend_tool(monkeypatch, lambda a: 0)
    assert cli.main(["play", "--no-such-option"]) == 2
    assert "--no-such-option" in capsys.readouterr().err


def test_interrupt_is_quiet(monkeypatch, capsys):
    pretend_tool(monkeypatch, raising(KeyboardInterrupt()))
    assert cli.main(["play"]) == 130
    assert capsys.readouterr() == ("", "")


def test_another_ctrl_c_does_not_disturb_the_first(monkeypatch, capsys):
    tidied = []

    def run(arguments):
        try:
            signal.raise_signal(signal.SIGINT)
            time.sleep(5.0)
        finally:
            signal.raise_signal(signal.SIGINT)
            tidied.append(True)

    pretend_tool(monkeypatch, run)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert cli.main(["play"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert tidied and capsys.readouterr() == ("", "")


@pytest.mark.slow
def test_ctrl_c_while_a_compiled_function_hands_over_its_result(monkeypatch, tmp_path):
    """Numba crashes the process where making a named tuple raises."""
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(
            """
            import os, signal, sys, threading, types
            from typing import NamedTuple
            from numba import njit
            from dlo_ros.cli import main as cli

            class Result(NamedTuple):
                value: float

            @njit(nogil=True)
            def work(count):
                total = 0.0
                for i in range(count):
                    total += 1.0 / (i + 1.0)
                return Result(total)

            def run(arguments):
                threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
                result = work(1_000_000_000)
                print("not interrupted", result)

            work(1)
            module = types.ModuleType("dlo_ros.cli.play")
            module.add_arguments = lambda parser: None
            module.run = run
            sys.modules["dlo_ros.cli.play"] = module
            sys.exit(cli.main(["play"]))
            """
        )
    )
    done = subprocess.run(
        [sys.executable, str(program)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_missing_ros_says_how_to_get_it(monkeypatch, capsys):
    pretend_tool(monkeypatch, raising(ModuleNotFoundError("no", name="sensor_msgs.msg")))
    assert cli.main(["play"]) == 2
    assert "'.[ros]'" in capsys.readouterr().err


def test_a_defect_is_one_line_and_1(monkeypatch, capsys):
    pretend_tool(monkeypatch, raising(ZeroDivisionError("division by zero")))
    monkeypatch.delenv(cli.DEBUG_VARIABLE, raising=False)
    assert cli.main(["play"]) == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and "ZeroDivisionError" in text and cli.DEBUG_VARIABLE in text


def test_a_defect_shows_its_place_on_request(monkeypatch, capsys):
    pretend_tool(monkeypatch, raising(ZeroDivisionError("division by zero")))
    monkeypatch.setenv(cli.DEBUG_VARIABLE, "1")
    assert cli.main(["play"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--help"], ["simulator", "--help"]])
def test_a_closed_pipe_is_no_error(words):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "dlo_ros", *words]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, env=environment)
    os.close(write)
    assert done.returncode == 0 and done.stderr == ""


@pytest.mark.parametrize(
    ("to", "status", "said"),
    [
        (">&-", 0, ""),
        (">/dev/full", 2, "dlo_ros --version: its output cannot be written (No space left"),
        (">&- 2>&-", 0, ""),
    ],
)
def test_an_output_that_takes_nothing_ends_in_no_traceback(to, status, said):
    """A closed output is not wanted; a full disk is told."""
    line = f"{shlex.quote(sys.executable)} -m dlo_ros --version {to}"
    done = subprocess.run(
        line, shell=True, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == status and done.stderr.startswith(said)
    assert done.stderr.count("\n") == (status != 0)


def test_wrappers_are_those_of_the_table():
    wrappers = {p.name: p for p in (ROOT / "scripts").iterdir()}
    assert set(wrappers) == set(cli.NAMES)
    for path in wrappers.values():
        assert path.read_text().startswith("#!/bin/sh\n")
        assert os.access(path, os.X_OK)
    assert len({p.read_text() for p in wrappers.values()}) == 1


@pytest.mark.parametrize(
    ("line", "wanted", "unwanted"),
    [
        ("dlo_ros ident", {"identifier", "identify"}, {"demo"}),
        *(
            pytest.param(*costly, marks=pytest.mark.slow)
            for costly in [
                ("dlo_ros play --", {"--rate", "--loop", "--no-clock", "--verbose"}, {"--pattern"}),
                ("dlo_ros predict --start ", {"equilibrium", "observed", "moving"}, {"--params"}),
                ("dlo_ros simulator --", {"--ros-args", "--verbose"}, {"--rate"}),
                ("dlo_ros play recording_", {"recording_1"}, {"other"}),
            ]
        ),
    ],
)
def test_a_shell_completes(line, wanted, unwanted, tmp_path):
    """As bash asks, with what register-python-argcomplete gives it."""
    argcomplete = pytest.importorskip("argcomplete")
    for name in ("recording_1", "other"):
        (tmp_path / name).touch()
    wrapper = tmp_path / "bin" / "dlo_ros"
    wrapper.parent.mkdir()
    wrapper.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m dlo_ros "$@"\n')
    wrapper.chmod(0o755)
    words = line.split(" ")
    script = argcomplete.shellcode(["dlo_ros"], shell="bash") + (
        f"\nCOMP_LINE={line!r}; COMP_POINT={len(line)}; COMP_TYPE=9"
        f"\nCOMP_WORDS=({' '.join(repr(word) for word in words)}); COMP_CWORD={len(words) - 1}"
        f"\n_python_argcomplete dlo_ros {words[-1]!r} {words[-2]!r}"
        '\nprintf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    environment = os.environ | {"PATH": f"{wrapper.parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, cwd=tmp_path, env=environment
    )
    found = {word.strip() for word in done.stdout.split("\n")}
    assert wanted <= found and not unwanted & found, (found, done.stderr)


def test_a_progress_bar_leaves_no_trace_where_there_is_no_terminal(capfd):
    from dlo_ros.cli.progress import progress_bar

    with progress_bar() as bar:
        task = bar.add_task("Working", total=3)
        for _ in range(3):
            bar.advance(task)
        bar.update(task, description="Done")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("name", "status"), [("simulator", 0), ("identify", 130), ("play", 130)])
def test_ctrl_c_while_the_libraries_load(name, status, tmp_path):
    """On a busy machine that takes seconds, and an interrupt in an import is no ImportError."""
    (tmp_path / "yaml.py").write_text("import time\nprint('loading', flush=True)\ntime.sleep(60)\n")
    environment = dict(os.environ, PYTHONPATH=f"{tmp_path}{os.pathsep}{ROOT}")
    with subprocess.Popen(
        [sys.executable, "-m", "dlo_ros", name],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
    ) as process:  # fmt: skip
        assert process.stdout.readline() == "loading\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == status
        assert process.stderr.read() == ""


def test_the_nodes_are_those_of_the_table():
    assert set(start.NODES) == {e.name for e in cli.EXECUTABLES if e.node}
