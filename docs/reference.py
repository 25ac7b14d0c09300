# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Writes tables of parameters and thresholds into these pages, from those that the package uses.

    make reference

A page holds its table between two comments, `<!-- begin NAME -->` and `<!-- end NAME -->`.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path

from dlo_ros.effects import effects
from dlo_ros.file_parameter import NODES, FileParameter
from dlo_ros.inference import thresholds
from dlo_ros.parameter_table import PARAMETERS

UNITS = {"m": "L", "1/m": "/L", "kg": "rope masses", "N/m": "of the weight per length"}
"""Units of the rope in which tolerances are given."""
HERE = Path(__file__).resolve().parent
BLOCK = re.compile(r"(<!-- begin (\w+) -->\n).*?(<!-- end \2 -->)", re.DOTALL)


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def value(parameter: FileParameter) -> str:
    """The default as it is written in a parameter file."""
    given = parameter.default
    if given is None:
        return "**must be given**"
    if isinstance(given, tuple):
        return "`[" + ", ".join(str(v) for v in given) + "]`"
    if isinstance(given, bool):
        return f"`{str(given).lower()}`"
    return f'`"{given}"`' if given == "" else f"`{given}`"


def allowed(parameter: FileParameter) -> str:
    """Range or choices."""
    if parameter.choices:
        return ", ".join(f"`{choice}`" for choice in parameter.choices)
    if parameter.kind == "string":
        return "text"
    if parameter.kind == "bool":
        return "`true`, `false`"
    each = "each " if parameter.size else ""
    return f"{each}{parameter.lower:g} to {parameter.upper:g}"


def change(parameter: FileParameter) -> str:
    """Whether it changes while the node runs."""
    return "at start" if parameter.read_only else "live"


def parameters_of(node: str) -> str:
    """The parameters that a node declares."""
    rows = (
        (f"`{p.name}`", p.kind, p.unit, value(p), allowed(p), change(p), p.description)
        for p in PARAMETERS
        if node in p.nodes
    )
    return table(("name", "type", "unit", "default", "allowed", "change", "meaning"), rows)


def all_parameters() -> str:
    """Every parameter, with the nodes that declare it."""

    def nodes(parameter: FileParameter) -> str:
        return "all" if set(parameter.nodes) == set(NODES) else ", ".join(parameter.nodes)

    rows = (
        (f"`{p.name}`", p.kind, p.unit, value(p), allowed(p), change(p), nodes(p), p.description)
        for p in PARAMETERS
    )
    return table(("name", "type", "unit", "default", "allowed", "change", "nodes", "meaning"), rows)


def all_effects() -> str:
    """Every number of every effect of this package."""
    rows = []
    for name, effect in sorted(effects().items()):
        if not effect.__module__.startswith("dlo_ros."):
            continue
        for q in effect.quantities():
            kind = "double or double[]" if q.array else "double"
            if q.counts:
                kind = " or ".join(f"double[{n}]" if n > 1 else "double" for n in q.counts)
            std = (
                ""
                if q.tolerance is None
                else f"{q.tolerance:.3g} {UNITS.get(q.unit, q.unit)}".strip()
            )
            rows.append(
                (
                    f"`effects.{name}.{q.name}`",
                    kind,
                    q.unit,
                    f"`{q.neutral:g}`",
                    f"{q.lower:g} to {q.upper:g}",
                    std + (" of the logarithm" if std and q.role == "ratio" else ""),
                    q.description,
                )
            )
    return table(
        ("name", "type", "unit", "without effect", "allowed", "tolerance", "meaning"), rows
    )


def all_thresholds() -> str:
    """Every threshold, with what it decides and why."""
    rows = []
    for assigned, text in pairwise(ast.parse(inspect.getsource(thresholds)).body):
        if isinstance(assigned, ast.Assign):
            name, words = ast.unparse(assigned.targets[0]), ast.literal_eval(ast.unparse(text))
            rows.append((f"`{name}`", f"{getattr(thresholds, name):g}", " ".join(words.split())))
    return table(("name", "value", "what it decides, and why"), rows)


TABLES: Mapping[str, Callable[[], str]] = {
    "parameters": all_parameters,
    "effects": all_effects,
    "thresholds": all_thresholds,
    "observer_parameters": lambda: parameters_of("observer"),
    "simulator_parameters": lambda: parameters_of("simulator"),
    "identifier_parameters": lambda: parameters_of("identifier"),
}
PAGES = ("parameters.md", "thresholds.md", *(f"nodes/{node}.md" for node in NODES))


def renewed(text: str) -> str:
    """A page with its tables made anew."""
    return BLOCK.sub(lambda m: f"{m[1]}\n{TABLES[m[2]]()}\n{m[3]}", text)


def main() -> None:
    """Renew all pages."""
    for name in PAGES:
        page = HERE / name
        page.write_text(renewed(page.read_text()))


if __name__ == "__main__":
    main()
