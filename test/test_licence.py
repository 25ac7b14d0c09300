# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Each source file says whose it is and under which licence, the one that the package declares."""

import configparser
import re
from xml.etree import ElementTree

import pytest
from conftest import ROOT

FOLDERS = ("bench", "dlo_ros", "docs", "examples", "launch", "paper", "scripts", "test")
SUFFIXES = {".py", ".js", ".css"}
SOURCES = [
    path
    for folder in FOLDERS
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in SUFFIXES or (folder == "scripts" and path.is_file())
]


@pytest.fixture(scope="module")
def declared() -> tuple[str, str]:
    """Owner and licence of the package."""
    metadata = configparser.ConfigParser()
    metadata.read(ROOT / "setup.cfg")
    return metadata["metadata"]["author"], metadata["metadata"]["license"]


def test_each_source_file_carries_the_statement(declared):
    owner, licence = map(re.escape, declared)
    said = rf"(#!.*\n)?(#|/\*) Copyright \d{{4}} {owner}, SPDX-License-Identifier: {licence}( \*/)?"
    assert len(SOURCES) > 400
    missing = [
        str(path.relative_to(ROOT))
        for path in SOURCES
        if not re.match(said + r"\n", path.read_text(encoding="utf-8"))
    ]
    assert not missing, f"no copyright statement: {', '.join(missing)}"


def test_the_licence_is_the_one_that_is_shipped(declared):
    owner, licence = declared
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.findtext("license") == licence == "Apache-2.0"
    assert package.findtext("maintainer") == owner
    head = (ROOT / "LICENSE").read_text()[:300]
    assert "Apache License" in head and "Version 2.0" in head
