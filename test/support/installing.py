# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Installations of the package in environments of their own, away from this checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

from conftest import ROOT

DEPENDENCIES = sysconfig.get_paths()["purelib"]


def run(*command, **options):
    """Run to the end; a failure shows what was printed."""
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, timeout=300, **options
    )
    assert done.returncode == 0, f"{command} gave {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def copied_sources(parent):
    """The sources as a clone has them, so that building leaves nothing in the working tree."""
    folder = parent / "dlo_ros"
    generated = ("build", "install", "log", "dist", ".*", "__pycache__", "*.egg-info")
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*generated))
    return folder


def fresh_environment(folder):
    """A virtual environment that sees the dependencies of this one, but not its dlo_ros."""
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    purelib = run(python, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])")
    # Paths in a .pth file are added as they are: an editable dlo_ros there stays out of sight.
    Path(purelib.strip(), "dependencies.pth").write_text(DEPENDENCIES + "\n")
    return python


def pip_install(python, *what):
    pip = (sys.executable, "-m", "pip", "--python", python)
    options = ("--no-deps", "--no-build-isolation", "--ignore-installed", "--no-index")
    run(*pip, "install", *options, *what)


def environment_of(prefix, **more):
    """As after `source activate` and with the prefix in ROS's index, away from this checkout."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["PATH"] = f"{prefix / 'bin'}{os.pathsep}{environment['PATH']}"
    environment["AMENT_PREFIX_PATH"] = str(prefix)
    return environment | more
