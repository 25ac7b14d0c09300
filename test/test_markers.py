# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Tests of live nodes are marked, so that `make test` runs them one after another."""

import ast
from pathlib import Path

import pytest

HELPERS = {"live_graph", "live_system", "fuzz_graph", "fault_rig"}  # these start nodes
TESTS = sorted(Path(__file__).parent.rglob("test_*.py"))


def imported(tree: ast.Module) -> set[str]:
    """Names of the modules that a file imports, wherever in it."""
    nodes = list(ast.walk(tree))
    names = {a.name for node in nodes if isinstance(node, ast.Import) for a in node.names}
    return names | {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}


def marks(tree: ast.Module) -> str:
    """What the module assigns to `pytestmark`."""
    return " ".join(
        ast.unparse(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"
    )


@pytest.mark.parametrize("path", TESTS, ids=lambda p: p.stem)
def test_modules_that_start_nodes_are_live(path: Path) -> None:
    tree = ast.parse(path.read_text())
    live, slow = (f"pytest.mark.{name}" in marks(tree) for name in ("live", "slow"))
    assert bool(imported(tree) & HELPERS) == live
    assert not live or slow or path.parent.name == "nodes"  # where `make test` looks for them


def test_helpers_exist() -> None:
    assert all((Path(__file__).parent / "support" / f"{name}.py").is_file() for name in HELPERS)


@pytest.mark.parametrize("path", TESTS, ids=lambda p: p.stem)
def test_what_tests_share_is_in_support(path: Path) -> None:
    assert not [name for name in imported(ast.parse(path.read_text())) if name.startswith("test_")]
