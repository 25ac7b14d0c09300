# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Names in backticks, such as `holdout.gain`, are those of modules, classes, parameters, effects.

Otherwise a docstring goes on sending its reader to a module that has been renamed.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import ROOT

from dlo_ros.effects import effects
from dlo_ros.parameter_cameras import of_cameras
from dlo_ros.parameter_table import TABLE

REFERENCE = re.compile(r"(?<!`)`([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+)(?:\(\))?`(?!`)")
FILES = ("csv", "html", "jpg", "json", "lock", "md", "png", "py", "rst", "toml", "xml", "yaml")
"""Files, also those that a user writes; `test_docs` looks for those of the repository."""
FIELDS = ("header", "qos_overrides", "observation", "mujoco", "EFFECT", "EXPERIMENT", "NAME")
"""First parts of what others name: fields of messages, of LeRobot's tables, MuJoCo's plug-ins; and
of names in which something is to be filled in."""
POINT = re.compile(r"(start|end|control_point_\d)\.(d?[xyz]|q[wxyz]|angle)")
"""Columns of a table of commands."""
MEMBER = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


@cache
def sources() -> dict[str, Path]:
    """Python files by their dotted names; those of test/ and bench/ without the folder."""
    found = {}
    for top in ("dlo_ros", "test/support", "test", "bench", "docs", "scripts"):
        for path in sorted((ROOT / top).rglob("*.py")):
            base = ROOT if top == "dlo_ros" else ROOT / top
            name = ".".join(path.relative_to(base).with_suffix("").parts)
            found.setdefault(name.removesuffix(".__init__"), path)
    return found


@cache
def texts() -> dict[Path, str]:
    """What may hold references."""
    pages = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")]
    return {path: path.read_text() for path in {*sources().values(), *pages}}


@cache
def modules(tail: str) -> tuple[str, ...]:
    """Modules whose dotted name ends so."""
    return tuple(n for n in sources() if n == tail or n.endswith(f".{tail}"))


@cache
def classes() -> dict[str, list[str]]:
    """Modules that define a class, by its name."""
    found: dict[str, list[str]] = {}
    for module, path in sources().items():
        for name in re.findall(r"^class (\w+)", texts()[path], re.MULTILINE):
            found.setdefault(name, []).append(module)
    return found


@cache
def names(module: str) -> dict[str, ast.AST]:
    """What a module defines or imports, by name."""
    return defined(ast.parse(texts()[sources()[module]]).body)


def defined(body: list[ast.stmt]) -> dict[str, ast.AST]:
    found: dict[str, ast.AST] = {}
    for node in body:
        if isinstance(node, MEMBER):
            found[node.name] = node
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {n.id: node for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(alias.asname or alias.name): node for alias in node.names}
        elif isinstance(node, ast.If | ast.Try):
            found |= defined(node.body)
    return found


def members(kind: ast.ClassDef) -> set[str]:
    """Attributes of a class, with those that its methods set and those of its bases."""
    found = set(defined(kind.body))
    for node in ast.walk(kind):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.attr)
    for base in kind.bases:
        for module in classes().get(base.id, ()) if isinstance(base, ast.Name) else ():
            other = names(module)[base.id]
            assert isinstance(other, ast.ClassDef)
            found |= members(other)
    return found


def inside(module: str, parts: list[str]) -> bool:
    """Whether a module has a name, or a class of it such an attribute."""
    if not parts:
        return True
    node = names(module).get(parts[0])
    if isinstance(node, ast.ClassDef) and len(parts) == 2:
        return parts[1] in members(node)
    return node is not None and len(parts) == 1


@cache
def exists(reference: str) -> bool:
    """Whether something in this repository, or an installed package, has this name."""
    parts = reference.split(".")
    if (
        parts[-1] in FILES
        or parts[-1] == "NAME"
        or parts[0] in FIELDS
        or POINT.fullmatch(reference)
    ):
        return True
    if reference in TABLE or reference.removesuffix("_std") in TABLE or of_cameras(reference):
        return True
    effect = parts[1:] if parts[0] == "effects" else parts
    if effect[0] in effects() or effect[0] == "NAME":
        return True
    for count in range(len(parts), 0, -1):
        for module in modules(".".join(parts[:count])):
            if inside(module, parts[count:]):
                return True
    # A section of an experiment's file, such as `look`, is a class of that name.
    for kind in (parts[0], parts[0].capitalize()):
        if any(inside(module, [kind, *parts[1:]]) for module in classes().get(kind, ())):
            return True
    return parts[0] != "dlo_ros" and not modules(parts[0]) and find_spec(parts[0]) is not None


def test_names_in_backticks_exist():
    missing = [
        f"{path.relative_to(ROOT)}:{text[: match.start()].count(chr(10)) + 1}: `{match[1]}`"
        for path, text in sorted(texts().items())
        for match in REFERENCE.finditer(text)
        if not exists(match[1])
    ]
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize(
    "reference",
    ["aside.Split", "holdout.Other", "Recording.other", "rod.other", "dlo_ros.rod.knots"],
)
def test_a_name_that_does_not_exist_is_noticed(reference):
    assert not exists(reference)
