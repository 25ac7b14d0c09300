# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Stiff pieces: their ends, and that what Newton's method leaves does not shake them in motion."""

import numpy as np
from cantilevers import B, apart, cantilever, elastica, own_weight
from rods import PAPER
from twins import compare

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

    def law(u, moment):
        within = np.clip((0.06 - np.abs(u - 0.15)) / 0.02, 0.0, 1.0)
        return moment / (B * 4.0**within)

    segment = {"centre": 0.15, "extent": 0.1, "ratio": 4.0, "taper": 0.2}
    found, _ = cantilever(PAPER, stiff_segment=segment)
    expected = elastica(law, own_weight, breaks=[0.09, 0.11, 0.19, 0.21])
    assert apart(found, expected) < 1e-3
