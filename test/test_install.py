# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The package installs with pip, with colcon and editable, and imports where there is no ROS."""

import configparser
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from conftest import ROOT
from installing import copied_sources, environment_of, fresh_environment, pip_install, run
from ordinary import some_of

from dlo_ros import __version__
from dlo_ros.cli.main import EXECUTABLES, NAMES

pytestmark = pytest.mark.long

NODES = [e.name for e in EXECUTABLES if e.node]


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return copied_sources(tmp_path_factory.mktemp("source"))


@pytest.fixture(scope="module")
def pip_prefix(source, tmp_path_factory):
    prefix = tmp_path_factory.mktemp("pip") / "venv"
    pip_install(fresh_environment(prefix), source)
    return prefix


@pytest.fixture(scope="module")
def colcon_prefix(source, tmp_path_factory):
    pytest.importorskip("colcon_ros", reason="colcon-ros is not installed")
    work = tmp_path_factory.mktemp("colcon")
    colcon = Path(sysconfig.get_path("scripts"), "colcon")
    places = ("--build-base", "build", "--install-base", "install", "--base-paths", source)
    run(colcon, "--log-base", "log", "build", *places, cwd=work)
    return work / "install" / "dlo_ros"


@pytest.fixture(params=["colcon", pytest.param("pip", marks=pytest.mark.slow)])
def prefix(request):
    """Where each of the two installers put the package."""
    return request.getfixturevalue(f"{request.param}_prefix")


def shell(prefix, command):
    """Output of a command in a shell as a user has it, for either installer."""
    setup = prefix.parent / "setup.bash"
    if setup.exists():
        # colcon: the environment this runs in takes the place of the underlay
        script = f"source {setup} && {command}"
        return run("bash", "-c", script, cwd=prefix, env=environment_of(Path(sys.prefix)))
    return run("bash", "-c", command, cwd=prefix, env=environment_of(prefix))


def test_ros2_run_finds_every_executable(prefix):
    folder = prefix / "lib" / "dlo_ros"
    found = {p.name for p in folder.iterdir() if os.access(p, os.X_OK) and p.is_file()}
    assert found == set(NAMES)


@pytest.mark.parametrize("name", NODES)
def test_an_executable_runs(prefix, name):
    assert f"usage: dlo_ros {name}" in shell(prefix, f"{prefix}/lib/dlo_ros/{name} --help")


@pytest.mark.slow
def test_an_executable_runs_with_its_own_python_whatever_is_first_on_the_path(prefix, tmp_path):
    """Such as conda's, which has none of the libraries."""
    other = tmp_path / "python3"
    other.write_text("#!/bin/sh\nexit 3\n")
    other.chmod(0o755)
    said = shell(prefix, f"PATH={tmp_path}:$PATH {prefix}/lib/dlo_ros/play --help")
    assert "usage: dlo_ros play" in said


def test_the_ros_index_knows_the_package(prefix):
    code = "from ament_index_python import get_package_share_directory as d; print(d('dlo_ros'))"
    share = Path(shell(prefix, f'python3 -c "{code}"').strip())
    assert share == prefix / "share" / "dlo_ros"
    for kind in (
        "config/*.*",
        "config/experiments/*.yaml",
        "config/sros2/*.xml",
        "launch/*.launch.py",
        "package.xml",
    ):
        installed = {p.name for p in share.glob(kind)}
        assert installed == {p.name for p in ROOT.glob(kind)} and installed


def test_the_installed_package_is_the_one_that_runs(prefix):
    code = "import dlo_ros; print(dlo_ros.__file__)"
    assert shell(prefix, f'python3 -c "{code}"').startswith(str(prefix))
    assert shell(prefix, "dlo_ros --version") == f"dlo_ros {__version__}\n"


def test_package_data_is_installed(prefix):
    code = "import dlo_ros; print(*dlo_ros.__path__)"
    package = Path(shell(prefix, f'python3 -c "{code}"').strip())
    assets = {p.name for p in (ROOT / "dlo_ros" / "report" / "assets").iterdir()}
    assert {p.name for p in (package / "report" / "assets").iterdir()} == assets
    assert (package / "py.typed").is_file()


@pytest.mark.slow
def test_editable(source, tmp_path):
    prefix = tmp_path / "venv"
    pip_install(fresh_environment(prefix), "--editable", source)
    environment = environment_of(prefix)
    code = "import dlo_ros; print(dlo_ros.__file__)"
    where = run(prefix / "bin" / "python", "-c", code, cwd=tmp_path, env=environment)
    assert where.strip() == str(source / "dlo_ros" / "__init__.py")
    said = run(prefix / "bin" / "dlo_ros", "--version", cwd=tmp_path, env=environment)
    assert said == f"dlo_ros {__version__}\n"


WITHOUT_ROS = """
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        root = name.partition(".")[0]
        if root in {"rclpy", "std_srvs", "rcl_interfaces", "ament_index_python"} or (
            root.endswith("_msgs")
        ):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NoRos())
"""


@pytest.mark.slow
def test_a_plain_pytest_and_colcon_leave_out_what_takes_minutes_and_a_browser():
    """`colcon test` calls pytest without a selection, and measures coverage where an extra named
    `test` asks for the plugin."""
    listed = (sys.executable, "-m", "pytest", "--collect-only", "-q", "test/report/test_report.py")
    usual, minutes = (run(*listed, *more, cwd=ROOT) for more in ((), ("-m", "slow")))
    assert "test_report.py::" in usual and "deselected" in usual
    slow = {line for line in minutes.splitlines() if "::" in line}
    assert slow and not slow & set(usual.splitlines())
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    wanted = setup["options.extras_require"]["test"].split()
    assert "pytest" in wanted and not [w for w in wanted if w.startswith("pytest-cov")]


@pytest.mark.slow
def test_what_needs_no_ros_imports_without_it():
    code = WITHOUT_ROS + (
        "import dlo_ros.rod, dlo_ros.vision, dlo_ros.identification, dlo_ros.recordings\n"
        "import dlo_ros.synthesis, dlo_ros.report\n"
        "from dlo_ros.cli import identify, observe, predict, synthesize\n"
    )
    run(sys.executable, "-c", code, cwd=ROOT)


@pytest.mark.parametrize("name", some_of(NODES, ["simulator"]))
def test_a_node_without_ros_says_what_is_missing(name):
    code = WITHOUT_ROS + f"from dlo_ros.cli.main import main; sys.exit(main([{name!r}]))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2
    assert "is not installed" in done.stderr and "'.[ros]'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_nothing_needs_more_than_numpy_1_26_at_import():
    """Ubuntu 24.04's. Its ufuncs have no module, which numba's decorator asks for."""
    for path in (ROOT / "dlo_ros").rglob("*.py"):
        assert "@infer_global(np." not in path.read_text(), path
