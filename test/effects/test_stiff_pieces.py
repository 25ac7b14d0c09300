# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Stiff pieces: their ends, and that what Newton's method leaves does not shake them in motion."""

import numpy as np
from elastica import Cantilever
from rods import PAPER, held_start, settled
from twins import compare

ROD = PAPER.rod

HUNG = {
    "initial_shape": [[0.0, 0.0], [0.16, -0.11], [0.32, 0.0]],
    "motion": {
        "control_point_1": [{"time": 0.0, "position": [0.0, 0.0, 0.0]}],
        "control_point_10": [
            {"time": t, "position": [0.32 - 0.06 * np.sin(np.pi * t) ** 2, 0.0, 0.0]}
            for t in np.linspace(0.0, 1.0, 41).tolist()
        ],
    },
}  # both ends are held and free to turn


def test_a_plug_on_an_end_that_may_turn_moves_smoothly_at_the_usual_tolerance():
    """It is a thousand times as stiff as the rest: a hundredth of a micrometre bends it enough."""
    plug = {"connector": {"mass": 0.0015, "extent": 0.06}}
    found, _ = compare(HUNG, plug, tolerance=2e-4, spans=28)
    assert found.worst < 3e-4


def test_the_ends_of_a_segment_are_tapered():
    """By a tenth of an extent of 0.1 m to either side of both ends, evenly in the logarithm."""

    def curvature(moment, u):
        within = np.clip((0.06 - np.abs(u - 0.15)) / 0.02, 0.0, 1.0)
        return moment / (ROD.bending_stiffness * 4.0**within)

    def weight(u):
        return np.zeros_like(u), -ROD.linear_density * 9.81 * (ROD.length - u)

    segment = {"centre": 0.15, "extent": 0.1, "ratio": 4.0, "taper": 0.2}
    model, _, found = settled(PAPER.with_effects({"stiff_segment": segment}), held_start(), 28)
    expected = Cantilever(
        ROD.length, lambda u: u, ROD.young_modulus * ROD.area, weight, curvature=curvature,
        breaks=[0.09, 0.11, 0.19, 0.21],
    )  # fmt: skip
    u = np.linspace(0.0, ROD.length, 41)
    off = model.basis.evaluate(found.state.q, u)[:, [0, 2]] - expected.solve(u)
    assert np.abs(off).max() < 1e-3 * ROD.length
