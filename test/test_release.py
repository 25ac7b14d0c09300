# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What is released: one version, wheel and sdist that work, installation beside ROS, an image."""

import json
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from conftest import ROOT
from installing import copied_sources, environment_of, fresh_environment, pip_install, run

from dlo_ros import __version__
from dlo_ros.dependencies import DEPENDENCIES

PAGE = (ROOT / "docs" / "installation.md").read_text()
DOCKERFILE = ROOT / "Dockerfile"
INSTRUCTIONS = {
    "FROM", "SHELL", "WORKDIR", "COPY", "RUN", "ENV", "ENTRYPOINT", "CMD",
}  # fmt: skip


def test_there_is_one_version():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.findtext("version") == __version__
    newest = re.search(r"^(\S+)\n-+$", (ROOT / "CHANGELOG.rst").read_text(), re.MULTILINE)
    assert newest and newest[1] == __version__
    assert "version = attr: dlo_ros.__version__" in (ROOT / "setup.cfg").read_text()


def test_the_package_says_all_that_a_release_wants():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.get("format") == "3" and package.findtext("name") == "dlo_ros"
    for tag in ("version", "description", "maintainer", "license"):
        assert (package.findtext(tag) or "").strip(), tag
    assert package.find("maintainer").get("email")
    assert (ROOT / package.find("license").get("file")).is_file()
    assert package.findtext("export/build_type") == "ament_python"


# --- what apt does not have ------------------------------------------------------------------

BLOCKED = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == {name!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
from dlo_ros.cli.main import main
sys.exit(main({words!r}))
"""


def without(name, *words):
    code = BLOCKED.format(name=name, words=list(words))
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("name", "words"),
    [("numba", ["simulator"]), ("rosbags", ["play", "recording"])],
)
def test_who_lacks_a_library_is_told_how_to_get_it(name, words):
    done = without(name, *words)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert f"{name} is not installed" in done.stderr and "pip install" in done.stderr


def test_what_apt_lacks_is_what_the_page_installs():
    lacking = {d.distribution for d in DEPENDENCIES if not d.package}
    (line,) = [line for line in PAGE.splitlines() if "bin/pip install" in line]
    assert lacking == set(re.findall(r" ([a-z]+)", line.partition("install")[2]))
    for text in (DOCKERFILE.read_text(), (ROOT / "README.md").read_text()):
        assert all(name in text for name in lacking) and "numpy<2" in text


# --- the image -------------------------------------------------------------------------------


def instructions():
    """Name and text of each instruction of the Dockerfile, lines joined."""
    lines = [line for line in DOCKERFILE.read_text().splitlines() if not line.startswith("#")]
    joined = re.sub(r"\\\n\s*", " ", "\n".join(lines))
    return [tuple(line.split(" ", 1)) for line in joined.splitlines() if line.strip()]


def test_the_dockerfile_can_be_parsed_and_uses_what_is_there():
    found = instructions()
    assert found[0] == ("FROM", "osrf/ros:jazzy-desktop-full")
    assert {name for name, _ in found} <= INSTRUCTIONS
    for name, text in found:
        if name == "COPY":
            source = text.split()[0]
            assert (ROOT / source).exists(), source
        if name in ("SHELL", "ENTRYPOINT", "CMD"):
            assert all(isinstance(word, str) for word in json.loads(text)), text
        if "apt-get install" in text:
            assert "--yes --no-install-recommends" in text and "rm -rf /var/lib/apt/lists" in text
    assert json.loads(found[-1][1])[:4] == ["ros2", "run", "dlo_ros", "demo"]
    assert "not run" in DOCKERFILE.read_text() and "not been run" in PAGE


@pytest.mark.skipif(shutil.which("hadolint") is None, reason="hadolint is not installed")
def test_the_dockerfile_is_linted():
    run("hadolint", DOCKERFILE)


def test_the_devcontainer_uses_the_dockerfile():
    file = ROOT / ".devcontainer" / "devcontainer.json"
    tree = json.loads(file.read_text())
    assert (file.parent / tree["build"]["dockerfile"]).resolve() == DOCKERFILE
    assert (file.parent / tree["build"]["context"]).resolve() == ROOT
    workspace = dict(instructions())["WORKDIR"]
    assert tree["workspaceFolder"] == f"{workspace}/src/dlo_ros"


# --- wheel, sdist, colcon --------------------------------------------------------------------


def built(kind, source, output):
    """Wheel or sdist of some sources, by the build backend."""
    output.mkdir()
    code = f"from setuptools.build_meta import build_{kind} as b; print(b({str(output)!r}))"
    return output / run(sys.executable, "-c", code, cwd=source).splitlines()[-1]


@pytest.mark.slow
def test_wheel_and_sdist_work_in_a_fresh_environment(tmp_path):
    """The wheel is built from the sdist, which therefore has all that it needs."""
    sdist = built("sdist", copied_sources(tmp_path), tmp_path / "sdist")
    assert sdist.name == f"dlo_ros-{__version__}.tar.gz"
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (source,) = (tmp_path / "unpacked").iterdir()
    for name in ("Dockerfile", "docs/installation.md", "LICENSE", "examples/real_wire/README.md"):
        assert (source / name).is_file(), name
    wheel = built("wheel", source, tmp_path / "wheel")
    assert wheel.name == f"dlo_ros-{__version__}-py3-none-any.whl"
    prefix = tmp_path / "venv"
    pip_install(fresh_environment(prefix), wheel)
    command, environment = prefix / "bin" / "dlo_ros", environment_of(prefix)
    overview = run(command, "--help", cwd=tmp_path, env=environment)
    assert "doctor" in overview and "identify" in overview
    code = "import dlo_ros; print(dlo_ros.__file__)"
    where = run(prefix / "bin" / "python", "-c", code, cwd=tmp_path, env=environment)
    assert where.startswith(str(prefix))
    pattern = tmp_path / "pattern.pdf"
    words = ("calibrate", "--pattern", "chessboard:9x6:0.025", "--print-pattern", pattern)
    run(command, *words, cwd=tmp_path, env=environment)
    assert pattern.stat().st_size > 1000
    params = prefix / "share" / "dlo_ros" / "config" / "default.yaml"
    words = ("doctor", "--seconds", "0", "--params", params)
    page = run(command, *words, cwd=tmp_path, env=environment)
    assert f"dlo_ros {__version__} doctor" in page and "nothing is wrong" in page


@pytest.mark.slow
def test_colcon_run_by_an_environments_python_gives_executables_of_that_python(tmp_path):
    """As docs/installation.md has it, beside ROS."""
    pytest.importorskip("colcon_ros", reason="colcon-ros is not installed")
    assert '~/dlo_venv/bin/python "$(command -v colcon)" build' in PAGE
    source, prefix = copied_sources(tmp_path), tmp_path / "dlo_venv"
    python = fresh_environment(prefix)
    colcon = Path(sysconfig.get_path("scripts"), "colcon")
    work = tmp_path / "ws"
    work.mkdir()
    words = ("--log-base", "log", "build", "--base-paths", source, "--packages-select", "dlo_ros")
    run(python, colcon, *words, cwd=work, env=environment_of(prefix))
    first = (work / "install" / "dlo_ros" / "bin" / "dlo_ros").read_text().splitlines()[0]
    assert first == f"#!{python}" or first == f"#!{python.resolve()}" or str(prefix) in first
    other = tmp_path / "python3"
    other.write_text("#!/bin/sh\nexit 3\n")
    other.chmod(0o755)
    script = (
        f"source install/setup.bash && PATH={tmp_path}:$PATH "
        "install/dlo_ros/lib/dlo_ros/doctor --seconds 0"
    )
    said = run("bash", "-c", script, cwd=work, env=environment_of(Path(sys.prefix)))
    assert str(prefix) in said and "doctor" in said
