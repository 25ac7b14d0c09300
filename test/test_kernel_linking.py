# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled functions link to others, in the process that compiled them and from the cache."""

import ast
import os
import subprocess
import sys

import kernel_modules
import pytest
from conftest import ROOT

INNER = """
from typing import NamedTuple
from dlo_ros.kernel_linking import linked

class Pair(NamedTuple):
    first: object
    second: object

@linked()
def shifted(pair, x):
    if x < 0.0:
        raise ValueError("x is negative")
    return Pair(pair.first + x, pair.second.copy())

@linked()
def repeated(pair, n):
    for i in range(n):
        pair = shifted(pair, float(i) + {more})
    return pair
"""
OUTER = """
from dlo_ros.inner import repeated
from dlo_ros.kernel_linking import linked

@linked(from_python=True)
def total(pair, n):
    return repeated(pair, n).first.sum() + pair.second.size
"""
CALL = """
import sys
import numpy as np
from numba.core import event
from dlo_ros.inner import Pair, repeated
from dlo_ros.outer import total

compiled = []
class Names(event.Listener):
    def on_start(self, _):
        pass
    def on_end(self, e):
        compiled.append(e.data["dispatcher"].py_func.__name__)
event.register("numba:compile", Names())
pair = Pair(np.ones(3), np.zeros((2, 2)))
print(total(pair, 4), *sorted(set(compiled) & {"shifted", "repeated", "total"}))
for k in range(200):  # what is returned lives on
    large = repeated(Pair(np.full(1000, float(k)), np.zeros((2, 2))), 1)
assert large.first.sum() == 199e3 + 1e3 * float(sys.argv[1])
"""


@pytest.fixture
def package(tmp_path):
    folder = kernel_modules.copied(tmp_path)
    (folder / "inner.py").write_text(INNER.format(more="0.0"))
    (folder / "outer.py").write_text(OUTER)
    return folder


def start(package, more="0"):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    return subprocess.Popen(
        [sys.executable, "-c", CALL, more],
        env=environment | {"PYTHONPATH": str(package.parent)},
        cwd=package.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def said(process):
    out, err = process.communicate(timeout=180)
    assert process.returncode == 0, err
    return out.split("\n")


@pytest.mark.slow
def test_links_hold_in_the_process_and_from_the_cache(package):
    assert said(start(package))[0] == "25.0 repeated shifted total"
    assert said(start(package))[0] == "25.0"
    (package / "inner.py").write_text(INNER.format(more="1.0"))
    assert said(start(package, "1"))[0] == "37.0 repeated shifted total"


@pytest.mark.slow
def test_what_is_linked_to_is_compiled_where_its_code_is_lost(package):
    said(start(package))
    for code in package.rglob("inner.shifted*"):
        code.unlink()
    assert said(start(package))[0] == "25.0 shifted"


@pytest.mark.slow
def test_several_processes_compile_a_function_once(package):
    processes = [start(package) for _ in range(3)]
    lines = [said(process)[0].split() for process in processes]
    assert [line[0] for line in lines] == ["25.0"] * 3
    compiled = [name for line in lines for name in line[1:]]
    assert compiled.count("shifted") == compiled.count("repeated") == 1


@pytest.mark.slow
def test_an_exception_comes_through_links(package):
    (package / "inner.py").write_text(INNER.format(more="0.0").replace("x < 0.0", "x == 1.0"))
    call = "\nimport pytest\nwith pytest.raises(ValueError, match='negative'):\n    total(pair, 3)"
    code = CALL.split("print(total")[0] + call
    for _ in range(2):
        environment = os.environ | {"PYTHONPATH": str(package.parent)}
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment, cwd=package.parent, capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr


def test_without_compiling_a_linked_function_is_the_function(package):
    code = "from dlo_ros.inner import shifted, Pair; import numpy as np;"
    code += "print(shifted(Pair(np.ones(2), np.ones(1)), 1.0).first.sum())"
    environment = os.environ | {"PYTHONPATH": str(package.parent), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment, cwd=package.parent, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.stdout.strip() == "4.0", done.stderr


def compiled_functions():
    """Decorator and called functions of each compiled function, (module, name)."""
    result = {}
    for path in (ROOT / "dlo_ros").rglob("*.py"):
        if path.name in kernel_modules.NAMES:
            continue
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        tree = ast.parse(path.read_text())
        origin = {
            alias.asname or alias.name: (node.module, alias.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for function in tree.body:
            if not isinstance(function, ast.FunctionDef):
                continue
            decorators = " ".join(ast.unparse(d) for d in function.decorator_list)
            if "njit" not in decorators and "linked" not in decorators:
                continue
            calls = set()
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    calls.add(origin.get(node.func.id, (module, node.func.id)))
                elif (
                    isinstance(node, ast.Call)
                    and isinstance(node.func, ast.Attribute)
                    and isinstance(node.func.value, ast.Name)
                    and node.func.value.id in origin
                ):
                    parent, name = origin[node.func.value.id]
                    calls.add((f"{parent}.{name}", node.func.attr))
            result[module, function.name] = decorators, calls
    return result


@pytest.mark.slow
def test_only_linked_functions_call_linked_ones():
    """Numba forgets what a copy of machine code links to; the next process would crash."""
    functions = compiled_functions()
    linked = {key for key, (decorators, _) in functions.items() if "linked" in decorators}
    assert len(linked) > 50
    for key, (_, calls) in functions.items():
        assert key in linked or not calls & linked, f"{key} calls {calls & linked}"
