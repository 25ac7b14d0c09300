# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Search for equilibrium from first shapes that lie beside what holds the DLO."""

import numpy as np
import pytest
from rods import PAPER, command

from dlo_ros.command import Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

SHARE = SplineBasis(10, PAPER.rod.length).greville / PAPER.rod.length
LED = [[[0.0, np.sin(0.15), 0.0, np.cos(0.15)], [0.0, 0.0, 0.0, 1.0]]]


@pytest.mark.parametrize("spans", [7, 12])
@pytest.mark.parametrize("place", [0.18, 0.21, 0.25])
def test_a_mass_near_a_pin_does_not_keep_the_dlo_from_it(place, spans):
    """To close a gap at the pin moves what is beside a hung mass about twice as far."""
    settings = PAPER.with_effects({"point_mass": {"mass": 0.006, "position": place}})
    pinned = command(
        ["start", "control_point_6"], [0.0], [[[0.0, 0.0, 0.0], [0.2, 0.0, -0.05]]], LED
    )
    first = np.zeros((10, 4))
    first[:, 0], first[:, 2] = 0.33 * SHARE, -0.12 * SHARE
    shapes = []
    for _ in range(2):  # then from the equilibrium itself
        simulation = Simulation(settings, Motion([pinned]), spans=spans)
        simulation.start([Observation(0, first)])
        first = simulation.prediction().control_points
        shapes.append(first)
    there = simulation.basis.row(SHARE[5] * PAPER.rod.length) @ simulation.true_shape()
    np.testing.assert_allclose(there[:3], [0.2, 0.0, -0.05], atol=1e-9)
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-6)
