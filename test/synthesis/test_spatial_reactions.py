# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forces of the grips on the discrete rod in space: balances of weight, momentum and moments."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.inference.forecast import forecast
from dlo_ros.parameters import DampingParameters, RodParameters, Settings
from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.experiment import find_experiment, load_experiment, with_wrench
from dlo_ros.synthesis.rod_reactions import reactions
from dlo_ros.synthesis.spatial_boundary import SpatialBoundary
from dlo_ros.synthesis.spatial_rod import in_space
from dlo_ros.synthesis.spatial_simulation import SpatialSimulation
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.synthesis.wrench_sensor import WrenchSensor

ROPE = RodParameters(length=0.4, diameter=0.004, young_modulus=5e7, density=2500.0)
DAMPING = DampingParameters(air_drag=0.0, relaxation_time=0.002)
GRAVITY = np.array([0.5, 3.0, -9.0])
WEIGHT = ROPE.linear_density * ROPE.length * 9.81
X = np.array([1.0, 0.0, 0.0])


def rod(edges=24):
    return in_space(DiscreteRod.uniform(ROPE, DAMPING, edges=edges), ROPE, GRAVITY)


def moment(places, forces):
    return np.cross(places, forces).sum(axis=0)


def test_a_clamp_at_rest_bears_weight_and_its_moment_in_space():
    own = rod()
    simulation = SpatialSimulation(
        own, lambda _: SpatialBoundary({0: np.zeros(3)}, (X, None)), own.u[:, None] * X
    )
    x = simulation.settle()
    found = reactions(simulation)
    assert set(found) == {"start"}
    pull = own.mass[:, None] * GRAVITY
    np.testing.assert_allclose(found["start"][:3], -pull.sum(axis=0), atol=1e-6 * WEIGHT)
    np.testing.assert_allclose(
        found["start"][3:], -moment(x, pull), atol=1e-5 * WEIGHT * ROPE.length
    )
    simulation.advance(0.05)  # at rest it stays
    np.testing.assert_allclose(reactions(simulation)["start"], found["start"], atol=1e-5 * WEIGHT)


def test_clamps_that_move_and_twist_change_momentum_and_moment_of_momentum():
    own, far, h = rod(), np.array([0.3, 0.02, 0.0]), 1e-3

    def boundary(t):
        turn = Rotation.from_rotvec([2.0 * t, 0.0, 1.5 * t]).as_matrix()
        moved = far + np.array([0.0, 6.0 * t**2, -4.0 * t**2])
        return SpatialBoundary(
            {0: np.zeros(3), len(own.u) - 1: moved}, (X, turn @ X), (np.eye(3), turn)
        )

    sagging = own.u[:, None] * np.array([0.75, 0.0, 0.0])
    sagging[:, 2] = -0.1 * np.sin(np.pi * own.u / ROPE.length)
    simulation = SpatialSimulation(own, boundary, sagging, step=h)
    simulation.settle()
    for _ in range(100):
        before = own.mass[:, None] * simulation.v
        places = simulation.x.copy()
        simulation.advance(simulation.time + h)
    now, there = reactions(simulation), simulation.x.copy()
    simulation.advance(simulation.time + h)
    later = own.mass[:, None] * simulation.v
    assert np.abs(now["end"][3:]).min() > 1e-4 * WEIGHT * ROPE.length  # all three components act
    pull = own.mass[:, None] * GRAVITY
    change = (later - before) / (2.0 * h)
    assert np.abs(change.sum(axis=0)).max() > 0.05 * WEIGHT
    forces = now["start"][:3] + now["end"][:3] + pull.sum(axis=0)
    np.testing.assert_allclose(forces, change.sum(axis=0), atol=5e-3 * WEIGHT)
    turned = (moment(simulation.x, later) - moment(places, before)) / (2.0 * h)
    turning = now["start"][3:] + now["end"][3:] + np.cross(there[-1], now["end"][:3])
    turning += moment(there, pull)
    np.testing.assert_allclose(turning, turned, atol=5e-3 * WEIGHT * ROPE.length)


@pytest.mark.slow
def test_an_experiment_in_space_has_the_forces_that_our_own_rod_predicts(tmp_path):
    made = with_wrench(load_experiment(find_experiment("twisted")), WrenchSensor())
    synthesize(made, tmp_path / "bag", images=False, edges=80, step=2e-3)
    true = Settings.load(tmp_path / "bag" / "params.yaml").with_material(
        made.truth.rod.young_modulus, made.truth.rod.density
    )
    recording = load_manipulation(tmp_path / "bag", true)
    weight = true.rod.linear_density * true.rod.length * 9.81
    found = forecast(recording, true, loads=True)
    assert [w.end for w in recording.wrenches] == ["start", "end"]
    for measured in recording.wrenches:
        at = np.searchsorted(measured.stamps, found.stamps)
        own = np.array([getattr(b, measured.end).force for b in found.loadings])
        apart = np.linalg.norm(measured.force[at] - own, axis=1)
        assert np.median(apart) < 0.005 * weight
        assert np.sqrt(np.mean(apart**2)) < 0.03 * weight  # the motion begins and ends abruptly
