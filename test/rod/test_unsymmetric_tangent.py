# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives in space where the tangent of bending is not symmetric, against whole runs."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command

from dlo_ros.command import Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.sensitivity_parameters import variation_of
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

SOFT = replace(
    PAPER, rod=replace(PAPER.rod, young_modulus=5e6),
    simulation=replace(PAPER.simulation, tolerance=0.1),
)  # fmt: skip
YIELDS = {"plasticity": {"yield_curvature": 3.0, "hardening": 0.3}}
LAWS = {
    "flat, yields": YIELDS | {"anisotropy": {"ratio": 3.0}},
    "softens and yields": YIELDS | {"nonlinear_stiffness": {"half_curvature": 5.0}},
    "rubs": {"hysteresis": {"moment": 2e-3, "curvature": 2.0}},
}
STOPS = range(SECOND // 200, SECOND // 4 + 1, SECOND // 200)


def swung():
    """Both ends are held; the start is moved out of the plane, and turned."""
    angles = ((0.6, -0.6), (0.6, -0.9))
    turns = [[[0.0, np.sin(0.5 * a), 0.0, np.cos(0.5 * a)] for a in both] for both in angles]
    return command(
        ["start", "end"], [0.0, 0.2],
        [[[0.0, 0.0, 0.0], [0.26, 0.0, 0.0]], [[0.02, 0.06, 0.04], [0.26, 0.0, 0.0]]], turns,
    )  # fmt: skip


def run(settings, parameters=()):
    """Shapes in motion and at the end, and their derivatives by one parameter."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    share = basis.greville / settings.rod.length
    shape = np.zeros((basis.control_points, 4))
    shape[:, 0], shape[:, 2] = 0.26 * share, -0.1 * np.sin(np.pi * share)
    simulation = Simulation(settings, Motion([swung()]), parameters=parameters, spans=14)
    simulation.start([Observation(0, shape)])
    track = [simulation.advance(stop) for stop in STOPS]
    track = [track[19], track[-1]]
    derivatives = np.array([p.sensitivity[0] for p in track]) if parameters else None
    return np.array([p.control_points[:, :3] for p in track]), derivatives


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_in_space_know_the_whole_tangent(same_steps, law):
    settings = SOFT.with_effects(LAWS[law])
    _, exact = run(settings, ("young_modulus",))
    varied = variation_of(settings, "young_modulus")
    step = 3.0 * varied.step
    above, below = (run(varied.vary(settings, swung(), d)[0])[0] for d in (step, -step))
    expected = (above - below) / (2.0 * step)
    np.testing.assert_allclose(exact, expected, atol=2e-4 * np.abs(expected).max(), rtol=0.0)
