# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The documentation says what the code does, leads where it says, and builds."""

from __future__ import annotations

import configparser
import importlib.util
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest
from conftest import ROOT
from policies import read_policy

from dlo_ros.cli.main import EXECUTABLES, parser_of
from dlo_ros.dependencies import DEPENDENCIES
from dlo_ros.effects import effects
from dlo_ros.parameter_cameras import CAMERAS
from dlo_ros.parameter_table import TABLE
from dlo_ros.recordings import topics

DOCS = ROOT / "docs"
PAGES = [
    *sorted(DOCS.rglob("*.md")),
    *(ROOT / f"{n}.md" for n in ("README", "CONTRIBUTING", "QUALITY_DECLARATION")),
]
NODES = [e.name for e in EXECUTABLES if e.node]


def module(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def test_the_tables_are_those_of_the_code():
    reference = module(DOCS / "reference.py")
    for name in reference.PAGES:
        text = (DOCS / name).read_text()
        assert reference.BLOCK.search(text), name
        assert reference.renewed(text) == text, f"docs/{name} is out of date: make reference"


def sections(page):
    """First column to second column of the table in each section of a page."""
    found, title = {}, ""
    for line in page.read_text().splitlines():
        if line.startswith("## "):
            title = line[3:]
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| `"):
            found.setdefault(title, {})[cells[0].strip("`")] = cells[1]
    return found


@pytest.mark.parametrize("node", NODES)
def test_a_nodes_page_names_its_topics_and_services(node):
    """Those of the policy, which test_two_dlos.py compares with the running node."""
    page, policy = sections(DOCS / "nodes" / f"{node}.md"), read_policy(node)

    def full(names):
        return {
            n.replace("~", f"/{node}") if n[0] == "~" else n if n[0] == "/" else f"/{n}"
            for n in names
        }

    every_node = {"/parameter_events", "/rosout"}
    assert full(page["Published topics"]) == policy.publish - every_node
    assert full(page["Subscribed topics"]) == policy.subscribe - {"/clock"}
    parameters = {n for n in policy.reply if re.search(r"/(describe|get|list|set)_", n)}
    assert len(parameters) == 7 and full(page["Services"]) == policy.reply - parameters
    assert full(page.get("Service clients", {})) == policy.request
    for section in ("Published topics", "Subscribed topics"):
        for name, kind in page[section].items():
            if name in topics.TYPES:
                assert topics.TYPES[name].replace("/msg/", "/") == kind, name


LINK = re.compile(r"\]\(([^)\s]+)\)")
EVERY_PAGE = [
    path
    for path in sorted(ROOT.rglob("*.md"))
    if not {"build", "install", "log"} & set(path.relative_to(ROOT).parts)
    and not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
]
"""Those that are no part of the documentation, such as a README of an example, too."""


def prose(page):
    """A page without what is code, in which brackets are no links."""
    lines = [line for line in page.read_text().splitlines() if not line.startswith("    ")]
    text = re.sub(r"^```.*?^```", "", "\n".join(lines), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "", text)


def anchors(page):
    """What a heading of a page is called in a link to it."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", h.lower()).strip().replace(" ", "-") for h in headings}


def broken(page):
    """Links of a page that lead nowhere."""
    for link in LINK.findall(prose(page)):
        if link.startswith(("http://", "https://")):
            continue
        target, _, anchor = link.partition("#")
        there = page.parent / target if target else page
        if not there.exists() or (anchor and anchor not in anchors(there)):
            yield link


@pytest.mark.parametrize("page", EVERY_PAGE, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    assert not list(broken(page))


def test_every_kind_of_broken_link_is_noticed(tmp_path):
    page, other = tmp_path / "page.md", tmp_path / "other.md"
    other.write_text("# A title, with words\n")
    good = ("[a](other.md)", "[b](other.md#a-title-with-words)", "[c](#here)", "[d](https://x.y)")
    bad = ("[e](none.md)", "[f](other.md#none)", "[g](#nowhere)", "![h](none.png)")
    code = ("    x[0](1)", "`y[0](2)`")
    page.write_text("\n".join(["# Here", *good, *bad, *code]))
    assert list(broken(page)) == ["none.md", "other.md#none", "#nowhere", "none.png"]
    assert len(EVERY_PAGE) > len(PAGES) and set(PAGES) <= set(EVERY_PAGE)
    assert sum(len(LINK.findall(prose(p))) for p in EVERY_PAGE) > 100


def test_files_that_the_changelog_and_the_sources_name_exist():
    """Those of docs/, config/, examples/, launch/ and test/, as words."""
    texts = [ROOT / "CHANGELOG.rst", ROOT / "Makefile", ROOT / "package.xml"]
    texts += [*(ROOT / "dlo_ros").rglob("*.py"), *EVERY_PAGE]
    named = re.compile(r"(?<![\w/.<-])((?:docs|config|examples|launch|test)/[\w/.-]*\w\.\w+)")
    found = {(path, name) for path in texts for name in named.findall(path.read_text())}
    assert len(found) > 50
    missing = [
        (str(path.relative_to(ROOT)), name)
        for path, name in found
        if not (ROOT / name).exists() and "NAME" not in name  # a placeholder
    ]
    assert not missing


def commands(text):
    """Each call of an executable in a page: its name, what follows, and whether it is code."""
    joined = re.sub(r"\\\n\s*", " ", text)
    for line in joined.splitlines():
        for match in re.finditer(
            r"(?:^|[\s`(])(?:ros2 run )?dlo_ros ([a-z]+)(?![.)\w])( [^`#|]*)?", line
        ):
            yield match[1], match[2] or "", line.startswith("    ")


def test_every_option_in_the_pages_exists():
    options = {e.name: set(parser_of(e)._option_string_actions) for e in EXECUTABLES}
    seen = 0
    for page in PAGES:
        for name, rest, code in commands(page.read_text()):
            if name not in options:
                assert not code, f"{page.name}: dlo_ros {name}"
                continue
            for option in re.findall(r"(?<!\S)--[a-z-]+", rest.partition("--ros-args")[0]):
                seen += 1
                assert option in options[name], f"{page.name}: dlo_ros {name} {option}"
    assert seen > 20


def test_every_parameter_and_effect_in_the_pages_exists():
    known = {f"effects.{n}.{q.name}" for n, e in effects().items() for q in e.quantities()}
    known |= {f"effects.{name}" for name in effects()} | set(TABLE) | {CAMERAS}
    groups = "rod|damping|camera|simulation|vision|effects"
    foreign = {"effects.wet_rope", "effects.NAME"}  # of the example, and a placeholder
    for page in PAGES:
        for name in re.findall(rf"`((?:{groups})\.[A-Za-z_.]+[a-zA-Z])`", page.read_text()):
            if not name.endswith(".py") and not name.startswith(tuple(foreign)):
                assert name in known, f"{page.name}: {name}"


def test_every_page_is_reached():
    listed = set()
    for page in DOCS.rglob("*.md"):
        for block in re.findall(r"```{toctree}\n(.*?)```", page.read_text(), re.DOTALL):
            for line in block.splitlines():
                if line and not line.startswith(":"):
                    listed |= set(page.parent.glob(f"{line}.md"))
    assert listed == set(DOCS.rglob("*.md")) - {DOCS / "index.md"}


@pytest.mark.slow
@pytest.mark.long
def test_the_pages_are_built_without_a_warning(tmp_path):
    for needed in ("sphinx", "myst_parser", "sphinx_rtd_theme"):
        pytest.importorskip(needed)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", tmp_path / "doctrees", DOCS, tmp_path / "html"],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "html" / "tools.html").read_text()
    assert all(f"example: dlo_ros {e.name}" in page for e in EXECUTABLES)
    theory = (tmp_path / "html" / "theory.html").read_text()
    assert theory.count("<math") > 50
    outside = re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="https?://[^"]*', theory)
    assert not outside  # pages can be read without a network


# --- what the package declares to others -----------------------------------------------------


def test_pip_and_rosdep_bring_the_same():
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    wanted = setup["options"]["install_requires"].split()
    assert sorted(wanted) == sorted(f"{d.distribution}>={d.minimum}" for d in DEPENDENCIES)
    wheels = re.findall(
        r"^ros-jazzy-([a-z-]+)", setup["options.extras_require"]["ros"], re.MULTILINE
    )
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {e.text for e in package.findall("exec_depend")}
    python = {key for key in keys if key.startswith("python3-")}
    assert python == {d.package for d in DEPENDENCIES if d.package}
    # What is released may depend on packages of apt alone.
    assert not [e.text for e in package.iter() if (e.text or "").endswith("-pip")]
    own = {"ament_index_python", "builtin_interfaces", "launch", "launch_ros"}
    started = {"rviz2", "v4l2_camera"}  # by the launch files, on request
    full = {"statistics_msgs", "tf2_msgs"}  # in every full ROS 2, not on PyPI, and done without
    assert keys - python - own - started - full == {w.replace("-", "_") for w in wheels}


def test_ros_modules_that_are_imported_are_declared():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {e.text for e in package.findall("exec_depend")}
    modules = "rclpy|rcl_interfaces|builtin_interfaces|ament_index_python|std_srvs|[a-z]+_msgs"
    pattern = rf"^\s*(?:from|import) ({modules})"
    used = set()
    for path in (ROOT / "dlo_ros").rglob("*.py"):
        used |= set(re.findall(pattern, path.read_text(), re.MULTILINE))
    assert used and used <= keys
    kinds = {*topics.TYPES.values(), topics.TRANSFORMS_TYPE}
    assert {kind.partition("/")[0] for kind in kinds} <= keys


def test_every_locked_package_has_hashes():
    lock = (ROOT / "requirements.lock").read_text()
    entries = re.split(r"\n(?=\S)", lock.partition("\n")[2].strip())
    assert len(entries) > 50
    for entry in entries:
        assert re.match(r"[a-z0-9-]+==\S+", entry) and "--hash=sha256:" in entry, entry[:60]
