# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Instants that are asked for must grow: a rod cannot be led back in time."""

import numpy as np
import pytest
from rods import PAPER, SECOND, command, settled

from dlo_ros.command import Motion
from dlo_ros.errors import InputError
from dlo_ros.observation import Observation
from dlo_ros.rod import dynamics
from dlo_ros.rod.batch.parameter_sets import follow_many
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

LIFTED = command(["start"], [0.0, 0.5], [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.1]]])
BACK = [SECOND // 2, SECOND // 4]


@pytest.fixture
def simulation():
    """A simulation that has started, at 0 s."""
    shape = np.zeros((10, 4))
    shape[:, 0] = SplineBasis(10, PAPER.rod.length).greville
    made = Simulation(PAPER, Motion([LIFTED]), spans=7)
    made.start([Observation(0, shape)])
    return made


def test_a_simulation_refuses_stamps_that_do_not_grow_and_stays_where_it_is(simulation):
    with pytest.raises(InputError, match=r"stamps must grow: 0\.250 s comes after 0\.500 s"):
        simulation.advance_through(BACK)
    assert simulation.stamp == 0
    with pytest.raises(InputError, match="cannot go back"):
        simulation.advance_through([-1])


def test_stamps_may_come_as_an_array_and_twice(simulation):
    alike = simulation.fork(PAPER).advance_through(sorted(BACK))
    found = simulation.advance_through(np.array([*sorted(BACK), max(BACK)]))
    assert [p.stamp for p in found] == [*sorted(BACK), max(BACK)]
    for k, one in enumerate([*alike, alike[-1]]):
        np.testing.assert_array_equal(found[k].control_points, one.control_points)


@pytest.mark.parametrize("stamps", [BACK, [-1, SECOND // 4]])
def test_one_rod_and_many_sets_refuse_them_as_well(stamps):
    model, boundary, found = settled(PAPER, LIFTED, 7)
    state = found.state
    with pytest.raises(InputError, match=r"stamps must grow|cannot go back"):
        dynamics.follow(model, boundary, state, LIFTED, stamps)
    with pytest.raises(InputError, match=r"stamps must grow|cannot go back"):
        follow_many([model], boundary, [state], LIFTED, stamps)
