# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The compiled code of simulated experiments gives what Python gives, which checks every index."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT
from vision_scenes import bow

from dlo_ros.parameters import DampingParameters, RodParameters
from dlo_ros.synthesis import render_kernels
from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes

ROPE = RodParameters(length=0.4, diameter=0.004, young_modulus=5e7, density=2500.0)
DAMPING = DampingParameters(air_drag=0.05, relaxation_time=0.002)
EDGES = 12
CHANGES = {
    "linear": {},
    "softening, yielding, hysteretic": {
        "half_curvature": 8.0, "yield_curvature": 2.0, "hardening": 0.3, "hysteresis": 0.4,
        "hysteresis_width": 1.0,
    },
    "rubbing": {"friction": np.full(EDGES + 1, 2e-3)},
    "pressed by a peg": {"pegs": np.array([[0.2, -0.012, 0.01]])},
}  # fmt: skip


def lifted(time: float) -> ImposedNodes:
    """The start goes up and turns; the end is free."""
    return ImposedNodes({0: np.array([0.0, 0.4 * time])}, start=2.0 * time)


def motions() -> dict[str, list]:
    """Nodes [m] of each rod after some steps from its equilibrium."""
    plain = DiscreteRod.uniform(ROPE, DAMPING, edges=EDGES)
    result = {}
    for name, values in CHANGES.items():
        rod = replace(plain, **values)
        level = np.column_stack([rod.u, np.zeros(len(rod.u))])
        simulation = DiscreteRodSimulation(rod, lifted, level, step=2e-3)
        settled = simulation.settle().copy()
        result[name] = [settled.tolist(), simulation.advance(0.02).tolist()]
    return result


@pytest.mark.slow
def test_the_discrete_rod_is_the_same_without_compiling():
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1", OMP_NUM_THREADS="1")
    environment["PYTHONPATH"] = os.pathsep.join(
        str(folder) for folder in (ROOT, ROOT / "test", ROOT / "test" / "support")
    )
    code = "import json, test_interpreted; print(json.dumps(test_interpreted.motions()))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    interpreted, compiled = json.loads(done.stdout), motions()
    assert interpreted.keys() == compiled.keys() == CHANGES.keys()
    for name, shapes in compiled.items():
        np.testing.assert_allclose(shapes, interpreted[name], atol=1e-8, err_msg=name)
    ends = [np.array(shapes)[1] for shapes in compiled.values()]
    for other in ends[1:]:  # each law has its effect
        assert np.abs(other - ends[0]).max() > 1e-4


@pytest.mark.parametrize("corner", [(0, 0), (40, 10)])
def test_a_rope_is_drawn_the_same_without_compiling(corner):
    line = np.ascontiguousarray(bow()[::8])
    fine, low = 0.005, line.min(axis=0) - 0.05  # [m], one pixel; what the first one sees
    pixels = (line - low) / fine
    u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    width, height = 80, 50
    columns, rows = np.meshgrid(np.arange(width) + corner[0], np.arange(height) + corner[1])
    plane = (low + fine * np.stack([columns, rows], axis=-1)).astype(np.float32)
    images = []
    for trace in (render_kernels.trace, render_kernels.trace.py_func):
        across, along = (np.full((height, width), 1e3, np.float32) for _ in range(2))
        segment = np.full((height, width), -1, np.int32)
        trace(
            line, pixels, u, np.array([0.2, -1.0, 0.0]), plane, np.array(corner), 0.02, 5.0, 0.004,
            across, along, segment,
        )  # fmt: skip
        images.append((across, along, segment))
    assert 100 < (images[0][2] >= 0).sum() < 0.5 * width * height
    for fast, slow in zip(*images, strict=True):
        np.testing.assert_allclose(fast, slow, rtol=1e-5, atol=1e-7)
