# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A peg in the way of the discrete rod: its force, and that the rope never enters it."""

import numpy as np
import pytest
from hidden_experiments import LENGTH, experiment, run
from scipy.integrate import solve_bvp

from dlo_ros.synthesis.hidden_rod import build_rod
from dlo_ros.synthesis.rod_laws import press
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes

pytestmark = pytest.mark.long

PEG = {"x": 0.13, "z": -0.04, "radius": 0.012}


def over_a_peg(rod, x, settings):
    """The elastica that a peg bears, by a boundary value solver: points, normal force, angle there.

    Unknown are the place s of the contact, the normal force there and the angle; the simulated rope
    serves as a first guess only.
    """
    rope = settings.rod
    b, ea, w = rope.bending_stiffness, rope.young_modulus * rope.area, rope.linear_density * 9.81
    centre, radius = np.array([PEG["x"], PEG["z"]]), PEG["radius"] + 0.5 * rope.diameter

    def rate(t, y, p):
        at, force, angle = p
        rows = []
        for k, (start, width) in enumerate(((0.0, at), (at, LENGTH - at))):
            a, moment, _, _ = y[4 * k : 4 * k + 4]
            nx = (force * np.sin(angle) if k == 0 else 0.0) + 0.0 * a
            nz = (force * np.cos(angle) if k == 0 else 0.0) - w * (LENGTH - start - width * t)
            grown = 1.0 + (nx * np.cos(a) - nz * np.sin(a)) / ea
            rows += [width * moment / b, width * grown * (nx * np.sin(a) + nz * np.cos(a))]
            rows += [width * grown * np.cos(a), -width * grown * np.sin(a)]
        return np.array(rows)

    def ends(first, last, p):
        angle = p[2]
        on_peg = centre + radius * np.array([np.sin(angle), np.cos(angle)])
        return np.concatenate(
            [
                [first[0], first[2], first[3], last[5], last[0] - angle],
                first[4:] - last[:4],
                last[2:4] - on_peg,
            ]
        )

    e = np.diff(x, axis=0)
    slope = np.interp(rod.u, 0.5 * (rod.u[1:] + rod.u[:-1]), np.arctan2(-e[:, 1], e[:, 0]))
    near = int(np.argmin(np.linalg.norm(x - centre, axis=1)))
    at, grid = rod.u[near], np.linspace(0.0, 1.0, 60)
    guess = []
    for start, width in ((0.0, at), (at, LENGTH - at)):
        s = start + width * grid
        guess += [np.interp(s, rod.u, slope), b * np.interp(s, rod.u, np.gradient(slope, rod.u))]
        guess += [np.interp(s, rod.u, x[:, 0]), np.interp(s, rod.u, x[:, 1])]
    solution = solve_bvp(
        rate, ends, grid, np.array(guess), p=[at, 0.1, slope[near]], tol=1e-8, max_nodes=20000
    )
    assert solution.success
    at, force, angle = solution.p
    s = rod.u
    first, second = (
        solution.sol(np.clip(s / at, 0, 1)),
        solution.sol(np.clip((s - at) / (LENGTH - at), 0, 1)),
    )
    points = np.where(s < at, first[2:4], second[6:8]).T
    return points, force, angle


def test_a_peg_bears_the_rope_with_the_force_of_the_elastica():
    made = experiment({"obstacle": PEG})
    rod = build_rod(made.truth, made.hidden, edges=200)
    hold = ImposedNodes({0: np.zeros(2)}, start=0.0)
    x = np.column_stack([rod.u, np.zeros(len(rod.u))])
    simulation = DiscreteRodSimulation(rod, lambda _: hold, x)
    simulation.settle()
    points, force, angle = over_a_peg(rod, simulation.x, made.truth)
    assert np.linalg.norm(simulation.x - points, axis=1).max() < 1e-4
    gradient, band = np.zeros_like(x), np.zeros((6, 2 * len(x)))
    press(rod.contact(), simulation.x, rod.lengths, gradient, band)
    expected = force * np.array([np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose(-gradient.sum(axis=0), expected, atol=5e-3 * force)
    assert force > 0.5 * rod.mass.sum() * 9.81
    simulation.advance(0.2)
    assert np.linalg.norm(simulation.x - points, axis=1).max() < 1e-4


def test_a_peg_that_the_rope_is_drawn_over_is_never_entered():
    motion = {
        "start": [
            {"time": 0.0, "position": [0.0, 0.0, 0.0], "angle": 0.0},
            {"time": 0.8, "position": [-0.15, 0.0, 0.0], "angle": 0.0},
        ]
    }
    truth = run({"obstacle": PEG}, motion=motion, initial_shape=[[0, 0], [0.4, 0.0]], edges=150)
    u = np.linspace(0.0, LENGTH, 4001)
    gaps = []
    for i in range(len(truth.stamps)):
        points = truth.centreline(i, u)[:, [0, 2]]
        distance = np.linalg.norm(points - [PEG["x"], PEG["z"]], axis=1)
        gaps.append(distance.min() - PEG["radius"] - 0.002)
    assert min(gaps) > -2e-5 and np.median(gaps) < 1e-4
