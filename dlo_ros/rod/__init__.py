# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod: dynamic spline model of a DLO (paper, section II), without ROS."""

from dlo_ros.rod.live_simulation import LiveSimulation
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.model_registry import rod_simulations, simulation_of
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.protocol import RodBatch, RodSimulation
from dlo_ros.rod.simulation import Simulation

__all__ = [
    "LiveSimulation",
    "Prediction",
    "RodBatch",
    "RodModel",
    "RodSimulation",
    "Simulation",
    "rod_simulations",
    "simulation_of",
]
