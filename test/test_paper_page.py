# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""docs/paper.md names code that exists, and no source cites what is not in the repository."""

import importlib
import re

import pytest
from conftest import ROOT

PAGE = (ROOT / "docs" / "paper.md").read_text()
NAMED = sorted(set(re.findall(r"`((?:dlo_ros|paper)\.[A-Za-z_.]+)`", PAGE)))
FOLDERS = ("bench", "dlo_ros", "docs", "examples", "launch", "paper", "scripts", "test")
SOURCES = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
PAGES = {path.name for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"))}
OUTSIDE = "/".join(("shared", ""))  # the folder of measured data is that of an option
MEASURED = "data"


def found(name):
    """The object of a dotted name, the longest part of which is a module."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            target = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if part in getattr(target, "__dataclass_fields__", {}):
                return target
            target = getattr(target, part)
        return target
    raise AssertionError(f"there is no module of {name}")


@pytest.mark.parametrize("name", NAMED)
def test_what_the_page_names_exists(name):
    assert found(name) is not None


def test_a_name_that_does_not_exist_is_noticed():
    with pytest.raises(AttributeError):
        found("dlo_ros.rod.model.RodModel.no_such")
    with pytest.raises(AttributeError):
        found("dlo_ros.no_such_module.x")


def test_every_equation_has_its_code():
    assert len(NAMED) > 30
    section = PAGE[PAGE.index("## Equations") :].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")]
    equations = {int(n) for row in rows for n in re.findall(r"\((\d+)\)", row.split("|")[1])}
    assert equations == set(range(1, 11))
    for row in rows:
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        if cells[0] and set(cells[0]) != {"-"} and cells[0] != "procedure":
            assert "`dlo_ros." in row or "`paper." in row, row


def test_sources_cite_pages_that_are_there():
    cited = {
        (name, str(path.relative_to(ROOT)))
        for path in SOURCES
        if "test" not in path.relative_to(ROOT).parts  # which write pages of their own
        for name in re.findall(r"\b([A-Za-z_]+\.md)\b", path.read_text())
    }
    assert len(cited) > 5
    assert not [(name, where) for name, where in cited if name not in PAGES]


def test_sources_cite_nothing_outside_of_the_repository():
    """But for the measured data, which are an option of the tests."""
    for path in (*SOURCES, *(ROOT / "docs").rglob("*.md")):
        for line in path.read_text().splitlines():
            if f"../{OUTSIDE}" in line or f" {OUTSIDE}" in line:
                assert f"{OUTSIDE}{MEASURED}" in line, f"{path}: {line}"
