# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compile the kernels of simulated experiments once."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from dlo_ros.synthesis.experiment import find_experiment, load_experiment
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.synthesis.true_motion import build_simulation


def compile_kernels() -> None:
    """Simulate and render two pictures of an experiment, with the steps of time between, and
    simulate it in space.
    """
    experiment = replace(load_experiment(find_experiment("c_shape")), duration=0.04)
    with tempfile.TemporaryDirectory() as folder:
        synthesize(experiment, Path(folder) / "bag")
    simulation, _ = build_simulation(experiment, edges=10, space=True)
    simulation.advance(1e-3)
