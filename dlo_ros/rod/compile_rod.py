# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compile the numerical kernels once, so that nodes and tools start without a pause."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.batch.parameter_sets import follow_many
from dlo_ros.rod.resolution import build
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.state import rest_state
from dlo_ros.rod_settings import RodParameters, RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

SETTINGS = RodSettings(rod=RodParameters(0.4, 0.004, 5e7, 2500.0))
POSITIONS = np.array([[[0.0, 0.0, 0.0], [0.2, 0.0, -0.1]]])


def compile_kernels() -> float:
    """Run short simulations that touch every kernel; returns the time it took [s]."""
    began = time.perf_counter()
    compile_statics()
    compile_dynamics()
    return time.perf_counter() - began


def compile_statics() -> None:
    """Find an equilibrium, and its sensitivities."""
    _simulation("equilibrium")


def compile_dynamics() -> None:
    """Move a rod, with its sensitivities, and many at once."""
    _simulation("observed").advance(1_000_000)
    basis, shape = _level()
    clamp = _command(("start",))
    model, boundary = build(SETTINGS, clamp, basis.spans)
    follow_many([model], boundary, [rest_state(0, shape, model)], clamp, [1_000_000])


def _simulation(start: str) -> Simulation:
    """A simulation that has started from a straight rod."""
    settings = replace(SETTINGS, simulation=replace(SETTINGS.simulation, start=start))
    command = _command(("start", "control_point_6"))
    simulation = Simulation(settings, Motion([command]), parameters=("young_modulus",), spans=7)
    simulation.start([Observation(0, _level()[1])])
    return simulation


def _level() -> tuple[SplineBasis, FloatArray]:
    """The basis and the control points (n, 4) of a straight rod."""
    basis = SplineBasis(SETTINGS.rod.control_points, SETTINGS.rod.length)
    shape = np.zeros((basis.control_points, 4))
    shape[:, 0] = basis.greville
    return basis, shape


def _command(points: tuple[str, ...]) -> Command:
    """A command that holds the first of the points."""
    n = len(points)
    return Command(
        0, points, np.zeros(1), POSITIONS[:, :n], np.tile([0.0, 0.0, 0.0, 1.0], (1, n, 1)),
        np.full((1, n, 3), np.nan), SETTINGS.rod.control_points,
    )  # fmt: skip
