# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where the discrete rod in space rests, and how it lies about itself there."""

from dataclasses import replace

import numpy as np
import pytest
from field import spatial
from twins import compare

from dlo_ros.errors import SimulationError
from dlo_ros.parameters import DampingParameters, RodParameters
from dlo_ros.synthesis import spatial_descent
from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.spatial_boundary import SpatialBoundary
from dlo_ros.synthesis.spatial_rod import edges_of, first_director, in_space
from dlo_ros.synthesis.spatial_simulation import SpatialSimulation

ROPE = RodParameters(length=0.4, diameter=0.004, young_modulus=5e7, density=2500.0)
GRAVITY = np.array([0.0, 0.0, -9.81])
# Both ends held in their places alone, one of them led aside.
HUNG = {
    "initial_shape": [[0.0, 0.0], [0.15, -0.1], [0.25, -0.1], [0.33, 0.0]],
    "motion": {
        "control_point_1": [{"time": 0.0, "position": [0.0, 0.0, 0.0]}],
        "control_point_10": [
            {"time": 0.05, "position": [0.33, 0.0, 0.0]},
            {"time": 0.3, "position": [0.28, 0.0, 0.0]},
        ],
    },
}


def curved_between_pins(curvature):
    """A rod whose ends are held in their places alone, curved at rest about its second director."""
    rod = in_space(DiscreteRod.uniform(ROPE, DampingParameters(0.0, 0.0), edges=40), ROPE, GRAVITY)
    rod = replace(rod, second_curvature=np.full(len(rod.u), curvature))
    held = SpatialBoundary({0: np.zeros(3), 40: np.array([0.33, 0.0, 0.0])})
    x = np.column_stack([0.33 / 0.4 * rod.u, 0.0 * rod.u, -0.1 * np.sin(np.pi * rod.u / 0.4)])
    return SpatialSimulation(rod, lambda _: held, x)


@pytest.mark.parametrize("curvature", [2.0, 8.0])
def test_a_rod_that_no_clamp_holds_lies_as_if_laid_where_it_rests(curvature):
    """It falls aside, and its first director is that of a rod of this direction all the same."""
    simulation = curved_between_pins(curvature)
    simulation.settle()
    tangent, _ = edges_of(simulation.x)
    assert np.abs(simulation.x[:, 1]).max() > 0.01
    np.testing.assert_allclose(simulation.director[0], first_director(tangent[0]), atol=1e-8)


def test_a_rod_that_cannot_lie_as_laid_is_told(monkeypatch):
    monkeypatch.setattr(spatial_descent, "MOST_TURNS", 1)
    with pytest.raises(SimulationError, match="free of twist"):
        curved_between_pins(2.0).settle()


def test_the_spline_rod_hangs_between_two_pins_as_it_does():
    """Both are curved at rest about the same axis of the section, and swing aside as far."""
    found, points = compare(
        HUNG, {"intrinsic_curvature": {"across": 4.0}},
        duration=0.3, edges=60, step=2e-3, spans=14, tolerance=1e-4, young_modulus=1e9,
    )  # fmt: skip
    assert np.abs(points[0, :, 1]).max() > 0.05
    assert found.start < 5e-3 and found.worst < 8e-3


@pytest.mark.slow
@pytest.mark.long
def test_a_rope_that_turns_a_long_way_to_rest_gets_there(tmp_path):
    """Between both grips hardly anything leads it downhill: that takes a thousand short steps."""
    spatial.draw(9979, 2, own_rope=True).write(tmp_path)
    assert (tmp_path / "case.json").exists()


def test_a_rod_without_an_equilibrium_is_told(monkeypatch):
    monkeypatch.setattr(spatial_descent, "MOST_STEPS", 100)
    rod = in_space(DiscreteRod.uniform(ROPE, DampingParameters(0.0, 0.0), edges=20), ROPE, GRAVITY)
    straight = rod.u[:, None] * [1.0, 0.0, 0.0]
    with pytest.raises(SimulationError, match="no stable equilibrium"):
        SpatialSimulation(rod, lambda _: SpatialBoundary({}), straight).settle()
