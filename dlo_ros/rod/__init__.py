"""The rod: dynamic spline model of a DLO (paper, section II), without ROS."""

from dlo_ros.rod.live import LiveSimulation
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.simulation import Prediction, Simulation

__all__ = ["LiveSimulation", "Prediction", "RodModel", "Simulation"]
