# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compile the numerical kernels once, so that nodes and tools start without a pause."""

from __future__ import annotations

import time

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.rod.lanes import follow_many
from dlo_ros.rod.resolution import build
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.state import rest_state
from dlo_ros.spline import SplineBasis


def compile_kernels() -> float:
    """Run a short simulation that touches every kernel; returns the time it took [s]."""
    began = time.perf_counter()
    settings = Settings(rod=RodParameters(0.4, 0.004, 5e7, 2500.0))
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    shape = np.zeros((basis.control_points, 4))
    shape[:, 0] = basis.greville
    position = np.array([[[0.0, 0.0, 0.0], [0.2, 0.0, -0.1]]])
    command = Command(
        0,
        ("start", "control_point_6"),
        np.zeros(1),
        position,
        np.tile([0.0, 0.0, 0.0, 1.0], (1, 2, 1)),
        np.full((1, 2, 3), np.nan),
        basis.control_points,
    )
    for mode in ("equilibrium", "observed"):
        flat = {**settings.flat(), "simulation.start": mode}
        simulation = Simulation(
            Settings.from_mapping(flat), Motion([command]), parameters=("young_modulus",), spans=7
        )
        simulation.start([Observation(0, shape)])
        simulation.advance(1_000_000)
    clamp = Command(
        0, ("start",), np.zeros(1), position[:, :1], np.tile([0.0, 0.0, 0.0, 1.0], (1, 1, 1)),
        np.full((1, 1, 3), np.nan), basis.control_points,
    )  # fmt: skip
    model, boundary = build(settings, clamp, basis.spans)
    follow_many([model], boundary, [rest_state(0, shape, model)], clamp, [1_000_000])
    return time.perf_counter() - began


if __name__ == "__main__":
    print("compiling the rod model (once; the result is cached) ...", flush=True)
    print(f"done in {compile_kernels():.1f} s")
