# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A simulation that has begun is copied, and sent to another process, like any other object."""

import copy
import pickle

import numpy as np
import pytest
from rods import PAPER, SECOND, command

from dlo_ros.command import Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.boundary.command_timeline import CommandTimeline
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis


def moved_twice():
    """A motion whose second command begins elsewhere than the first one ends."""
    return Motion(
        [
            command(["start"], [0.0, 0.5], [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.05]]]),
            command(["start"], [0.0, 0.5], [[[0.0, 0.0, 0.06]], [[0.02, 0.0, 0.0]]], stamp=SECOND),
        ]
    )


WAYS = pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))], ids=["deepcopy", "pickle"]
)


@WAYS
def test_a_copy_goes_on_as_the_simulation_does(copied):
    shape = np.zeros((10, 4))
    shape[:, 0] = SplineBasis(10, PAPER.rod.length).greville
    motion = moved_twice()
    simulation = Simulation(PAPER, motion, spans=7)
    simulation.start([Observation(0, shape)])
    simulation.advance(SECOND + SECOND // 100)
    twin = copied(simulation)
    assert twin.stamp == simulation.stamp
    stamps = [SECOND + k * SECOND // 10 for k in range(1, 8)]
    for found, expected in zip(
        twin.advance_through(stamps), simulation.advance_through(stamps), strict=True
    ):
        np.testing.assert_array_equal(found.control_points, expected.control_points)


@WAYS
def test_a_copied_course_of_commands_knows_what_stands_in_for_which(copied):
    course = CommandTimeline(moved_twice())
    counted = course.at(SECOND, slips=True)
    twin = copied(course)
    found = twin.at(SECOND, slips=False)
    assert counted.path_before > 0.0
    assert (found.path_before, found.whole_path) == (counted.path_before, counted.whole_path)
