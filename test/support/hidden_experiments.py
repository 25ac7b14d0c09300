# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A small experiment with hidden effects, and its run."""

import copy

from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.true_motion import build_simulation, simulate

LENGTH = 0.4
TREE = {
    "parameters": {
        "rod": {"length": LENGTH, "diameter": 0.004, "young_modulus": 2e7, "density": 2500.0},
        "damping": {"air_drag": 0.02, "relaxation_time": 0.004},
        "camera": {"translation": [0.01, 0.02, 0.9]},
    },
    "duration": 1.0,
    "initial_shape": [[0.0, 0.0], [0.38, -0.12]],
    "motion": {
        "start": [
            {"time": 0.0, "position": [0.0, 0.0, 0.0], "angle": 0.3},
            {"time": 0.6, "position": [0.1, 0.0, 0.05], "angle": 0.5},
        ]
    },
    "measurement": {"std": 0.0},
}


def experiment(effects=None, foreign=None, **changes):
    tree = copy.deepcopy(TREE | changes)
    if effects:
        tree["parameters"]["effects"] = effects
    return read_experiment(tree | {"foreign": foreign}, "test", "test.yaml")


def run(effects=None, foreign=None, edges=80, **changes):
    made = experiment(effects, foreign, **changes)
    simulation, _ = build_simulation(made, edges=edges, step=2e-3)
    return simulate(simulation, made.stamps, made.truth.rod.length)
