# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rod whose start is lifted, simulated with and without effects."""

import numpy as np
from rods import SECOND, command

from dlo_ros.command import Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis


def simulate(settings, imposed, stamps, spans=14, parameters=()):
    """Shapes of the published basis in motion from the equilibrium, and the simulation."""
    simulation = Simulation(settings, Motion([imposed]), parameters=parameters, spans=spans)
    simulation.start([Observation(0, first_shape(settings))])
    return simulation.advance_through(stamps), simulation


def first_shape(settings):
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    shape = np.zeros((basis.control_points, 4))
    shape[:, 0] = basis.greville
    return shape


STAMPS = [k * SECOND // 20 for k in range(1, 21)]


def lifted(stamp=0):
    return command(["start"], [0.0, 0.5], [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.1]]], stamp=stamp)


def shapes(predictions):
    return np.array([p.control_points[:, :3] for p in predictions])
