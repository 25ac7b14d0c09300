# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forces of a grip that a robot leads smoothly, of which a command holds samples."""

from dataclasses import replace

import numpy as np
import pytest
from measured import spline_through
from rods import PAPER, SECOND, command

from dlo_ros.identification import Manipulation, identify
from dlo_ros.observation import Observation
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis import discrete_rod, rod_simulation
from dlo_ros.synthesis.rod_reactions import measured, reactions
from dlo_ros.synthesis.wrench_sensor import WrenchSensor

pytestmark = pytest.mark.long

LENGTH = PAPER.rod.length
SENSOR = WrenchSensor.usual(PAPER.rod.linear_density * LENGTH * 9.81, LENGTH)
SECONDS, RATE = 1.8, 30.0
NODES = np.arange(0.0, SECONDS + 1e-9, 1.0 / RATE)


def smooth(time):
    """Place [m] and angle [rad] of the start, which goes to and fro once a second."""
    share = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.asarray(time))
    return np.stack([0.06 * share, 0.05 * share, 0.6 * share])


def recorded(seed):
    """A recording of it, with shapes and forces at the points of the command."""
    rng, basis = np.random.default_rng(seed), SplineBasis(PAPER.rod.control_points, LENGTH)
    rod = discrete_rod.DiscreteRod.uniform(PAPER.rod, PAPER.damping, edges=120)

    def boundary(time):
        x, z, angle = smooth(time)
        return rod_simulation.ImposedNodes({0: np.array([x, z])}, start=float(angle))

    straight = np.column_stack([rod.u, np.zeros(len(rod.u))])
    simulation = rod_simulation.DiscreteRodSimulation(rod, boundary, straight, step=5e-4)
    simulation.settle()
    seen, borne, stamps = [], [], [round(t * SECOND) for t in NODES]
    for stamp, time in zip(stamps, NODES, strict=True):
        if time:
            simulation.advance(time)
        borne.append(reactions(simulation))
        seen.append(Observation(stamp, spline_through(rod, simulation.x, basis, 3e-4, rng)))
    x, z, angle = smooth(NODES)
    place = np.column_stack([x, 0.0 * x, z])[:, None]
    half, none = 0.5 * angle, 0.0 * angle
    turn = np.column_stack([none, np.sin(half), none, np.cos(half)])[:, None]
    imposed = command(["start"], NODES, place, turn, n=basis.control_points)
    still = np.zeros((len(borne), 3))  # the sensor has no mass of its own
    felt = tuple(measured(SENSOR, stamps, borne, {"start": still}, seed))
    return Manipulation("robot", (imposed,), tuple(seen), felt)


GIVEN = replace(
    PAPER.with_material(2e7, 2000.0),
    wrench=replace(
        PAPER.wrench, force_std=SENSOR.force_std, torque_std=SENSOR.torque_std,
        force_bias_std=SENSOR.force_bias_std,
    ),
)  # fmt: skip


@pytest.mark.slow
def test_forces_of_a_robot_whose_poses_were_recorded_tell_the_scale():
    """In straight pieces E and mu were 2.7 % too large, by five standard deviations."""
    found = identify([recorded(1)], GIVEN).estimate
    for name in ("young_modulus", "density"):
        true, std = getattr(PAPER.rod, name), getattr(found, f"{name}_std")
        assert abs(getattr(found, name) - true) < 3.0 * std < 0.02 * true
