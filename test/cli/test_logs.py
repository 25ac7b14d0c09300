# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`--verbose` and `DLO_ROS_LOG`: who accepts them, what is told, and that nothing is without."""

import logging
import sys
import types

import pytest

from dlo_ros.cli import main as cli
from dlo_ros.cli.progress import progress_bar, steps
from dlo_ros.errors import InputError
from dlo_ros.logs import OPTION, VARIABLE, LogChoice, chosen, without_option

BELOW = logging.getLogger("dlo_ros.identification.offline.initial_fit")
FOREIGN = logging.getLogger("matplotlib.test")


@pytest.fixture
def tool(monkeypatch):
    """Run a tool that tells a line of each level; the environment's variable as given."""
    module = types.ModuleType("dlo_ros.cli.play")
    module.add_arguments = lambda parser: None

    def tell(arguments):
        FOREIGN.info("foreign")
        BELOW.debug("detail")
        for k in range(5):
            BELOW.info("step %d", k)
        for _ in range(2):
            BELOW.warning("beware")
        return 0

    module.run = tell
    monkeypatch.setitem(sys.modules, "dlo_ros.cli.play", module)
    monkeypatch.delenv(VARIABLE, raising=False)

    def run(*words, variable=None):
        monkeypatch.setattr(logging.getLogger(), "handlers", [])  # those of pytest
        if variable is not None:
            monkeypatch.setenv(VARIABLE, variable)
        return cli.main(["play", *words])

    return run


@pytest.mark.parametrize("executable", cli.EXECUTABLES, ids=lambda e: e.name)
def test_every_executable_accepts_the_option(executable):
    assert OPTION in cli.parser_of(executable)._option_string_actions


def test_a_node_takes_the_option_from_its_own_words_only():
    assert without_option([OPTION, "--ros-args", "-p", "a:=1"]) == (
        ["--ros-args", "-p", "a:=1"],
        True,
    )
    assert without_option(["--ros-args", OPTION]) == (["--ros-args", OPTION], False)
    assert without_option([]) == ([], False)


def test_a_node_with_the_option_starts_as_without(monkeypatch, capsys):
    pytest.importorskip("rclpy")
    from dlo_ros.nodes import runtime

    seen = []

    def make():
        seen.append(logging.getLogger("dlo_ros").getEffectiveLevel())
        raise InputError("enough")

    monkeypatch.delenv(VARIABLE, raising=False)
    assert runtime.run("simulator", make, [OPTION, "--ros-args"]) == 2
    assert seen == [logging.INFO] and "enough" in capsys.readouterr().err
    monkeypatch.setenv(VARIABLE, "loud")
    assert runtime.run("simulator", make, []) == 2
    assert "loud" in capsys.readouterr().err and len(seen) == 1


def test_without_it_only_warnings_are_told(tool, capsys):
    assert tool() == 0
    assert capsys.readouterr().err.splitlines() == [
        "WARNING: beware",
        "WARNING: once more, this or the like: beware",
    ]


def test_with_it_every_step_is_told_with_its_module(tool, capsys):
    assert tool(OPTION) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" ", 1)[1] for line in lines[:5]] == [
        f"dlo_ros.identification.offline.initial_fit: step {k}" for k in range(5)
    ]
    assert lines[5:] == ["WARNING: beware"] * 2
    assert logging.getLogger("dlo_ros").level == logging.NOTSET  # as before


@pytest.mark.parametrize(
    ("variable", "words", "count"),
    [("debug", (), 8), ("INFO", (), 7), ("warning", (), 2), ("warning", (OPTION,), 7), ("", (), 2)],
)
def test_the_variable_says_how_much(tool, capsys, variable, words, count):
    assert tool(*words, variable=variable) == 0
    assert len(capsys.readouterr().err.splitlines()) == count


def test_a_file_gets_all_and_the_terminal_warnings_only(tool, capsys, tmp_path):
    file = tmp_path / "steps.log"
    for _ in range(2):  # it is added to
        assert tool(variable=f"debug:{file}") == 0
    text = file.read_text()
    assert text.count("detail") == 2 and text.count("WARNING: beware") == 4
    assert "foreign" not in text
    assert "step" not in capsys.readouterr().err


@pytest.mark.parametrize("variable", ["loud", "5", "debugging:x"])
def test_a_wrong_level_is_one_line(tool, capsys, variable):
    assert tool(variable=variable) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and variable in text and "debug, info, warning" in text


def test_a_file_that_cannot_be_written_is_one_line(tool, capsys, tmp_path):
    assert tool(variable=f"info:{tmp_path}/none/steps.log") == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and "steps.log" in text and "cannot be written" in text


def test_the_choice():
    assert chosen(False, {}) == LogChoice(logging.WARNING)
    assert chosen(True, {}) == LogChoice(logging.INFO)
    assert chosen(True, {VARIABLE: "debug:f"}) == LogChoice(logging.DEBUG, "f")
    assert chosen(False, {VARIABLE: ":f"}).file == "f"
    assert chosen(True, {VARIABLE: "info:f"}).shown == logging.WARNING


def test_each_step_of_a_long_computation_is_told_once(caplog):
    caplog.set_level(logging.INFO, "dlo_ros")
    with progress_bar() as bar:
        progress = steps(bar, bar.add_task("Working", total=1.0))
        for text, share in (("first", 0.0), ("first", 0.5), ("second", 0.5), ("first", 1.0)):
            progress(text, share)
    assert [r.getMessage() for r in caplog.records] == ["first", "second", "first"]


def test_the_steps_of_a_fit_are_told(caplog):
    """Where a joint model looks for causes, each candidate is."""
    from dlo_ros.diagnosis.explain.candidate_trials import Step
    from dlo_ros.diagnosis.explain.cause_search import _tell

    caplog.set_level(logging.INFO, "dlo_ros")
    _tell(
        [
            Step(1, "weight", 12.3, 0.0042, "added"),
            Step(1, "draught", 1.0, None, "predicted to gain less"),
        ]
    )
    assert [r.getMessage() for r in caplog.records] == [
        "cause 1: weight: +12.3, ERR 4.200 mm: added",
        "cause 1: draught: +1.0, ERR -: predicted to gain less",
    ]
