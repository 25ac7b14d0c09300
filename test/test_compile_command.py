# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The command `python -m dlo_ros.compile`: every part, unknown stages, one package everywhere."""

import importlib
import subprocess
import sys

from conftest import ROOT

from dlo_ros.kernel_parts import STAGES
from dlo_ros.own_process import command_of
from dlo_ros.synthesis import compile_synthesis, rod_simulation, rod_steps


def test_every_part_has_its_work():
    names = [part.name for parts in STAGES.values() for part in parts]
    assert len(names) == len(set(names))
    for parts in STAGES.values():
        for part in parts:
            module, _, function = part.work.partition(":")
            assert callable(getattr(importlib.import_module(module), function))


def compile_module(*words):
    return subprocess.run(
        [sys.executable, "-m", "dlo_ros.compile", *words],
        capture_output=True, text=True, cwd=ROOT, timeout=900,
    )  # fmt: skip


def test_everything_is_compiled_by_one_command():
    """Or nothing, where it was compiled before, as it was where other tests have run."""
    done = compile_module()
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("the numerical kernels are compiled")
    again = compile_module("rod")
    assert again.stdout.count("\n") == 1 and "compiling" not in again.stdout


def test_an_unknown_stage_is_told():
    done = compile_module("rods")
    assert done.returncode == 2
    assert "'rods' is unknown; choose from rod, vision, synthesis" in done.stderr


def test_simulated_experiments_are_compiled_with_their_steps_of_time(monkeypatch):
    steps = []

    def minimise(*words):
        steps.append(words)
        return rod_steps.minimise(*words)

    monkeypatch.setattr(rod_simulation, "minimise", minimise)
    compile_synthesis.compile_kernels()
    assert steps


def test_a_process_of_its_own_runs_the_same_package_wherever_it_is_started(tmp_path):
    """As in the folder of the sources, beside an installed package."""
    other = tmp_path / "dlo_ros"
    other.mkdir()
    (other / "__init__.py").write_text("")
    (other / "__main__.py").write_text("print('another package')")
    run = {"cwd": tmp_path, "capture_output": True, "text": True, "timeout": 60}
    usual = subprocess.run([sys.executable, "-m", "dlo_ros", "--version"], **run)
    own = subprocess.run([*command_of("dlo_ros"), "--version"], **run)
    assert usual.stdout == "another package\n" and "another" not in own.stdout
    assert own.returncode == 0 and own.stdout.startswith("dlo_ros ")
