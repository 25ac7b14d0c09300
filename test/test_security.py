# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Nothing is evaluated, unpickled or handed to a shell."""

from __future__ import annotations

import ast
import re

import pytest
from conftest import ROOT
from parsed_sources import parsed

FOLDERS = ("dlo_ros", "launch", "docs")
SOURCES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
SCRIPTS = sorted(path for path in (ROOT / "scripts").iterdir() if path.is_file())
BUILTINS = {"eval", "exec", "compile", "__import__"}
ATTRIBUTES = {
    "os.system", "os.popen", "yaml.load", "yaml.full_load", "yaml.unsafe_load", "yaml.load_all",
    "pickle.load", "pickle.loads", "np.load", "numpy.load",
}  # fmt: skip
MODULES = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}


def dangers(tree: ast.AST):
    """Line and name of each construct that would run or unpack what somebody else wrote."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in BUILTINS or name in ATTRIBUTES:
                yield node.lineno, name
            for keyword in node.keywords:
                if keyword.arg in ("shell", "allow_pickle"):
                    yield node.lineno, f"{name}({keyword.arg}=...)"
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        for name in names:
            if name.partition(".")[0] in MODULES:
                yield node.lineno, f"import {name}"


def test_no_source_evaluates_unpickles_or_uses_a_shell():
    assert len(SOURCES) > 200
    for path in SOURCES:
        found = list(dangers(parsed(path)))
        assert not found, f"{path.relative_to(ROOT)}: {found}"


def unquoted(script: str):
    """Lines of a shell script that evaluate a text, or expand one outside quotes."""
    for line in script.splitlines():
        code = "" if line.lstrip().startswith("#") else line
        bare = re.sub(r'"[^"]*"|\'[^\']*\'', "", code)
        if "$" in bare or "`" in code or "$(" in code or re.search(r"\beval\b", code):
            yield line


def test_the_scripts_expand_nothing_outside_quotes():
    assert SCRIPTS
    for path in SCRIPTS:
        assert not list(unquoted(path.read_text())), path.name


@pytest.mark.parametrize("line", ["exec $command", "eval x", 'echo "$(ls)"', "ls `pwd`"])
def test_the_search_of_scripts_finds_what_it_looks_for(line):
    assert list(unquoted(line)) == [line]


@pytest.mark.parametrize(
    "line",
    [
        "eval('1')",
        "yaml.load(text)",
        "subprocess.run(word, shell=True)",
        "import pickle",
        "np.load(path, allow_pickle=True)",
    ],
)
def test_the_search_above_finds_what_it_looks_for(line):
    assert list(dangers(ast.parse(line)))
