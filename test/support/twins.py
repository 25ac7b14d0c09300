# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The spline rod and the discrete rod of the synthesis, in one manipulation with one effect."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import SimulationParameters
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import NANOSECONDS, START_STAMP, read_experiment
from dlo_ros.synthesis.true_motion import build_simulation, simulate

LENGTH, DIAMETER = 0.4, 0.004
RATE = 50.0  # shapes a second
GRAVITY = -9.81

# A clamp that is lifted and turned, the other end free.
WAVED = {
    "initial_shape": [[0.0, 0.0], [0.2, -0.02], [0.38, -0.1]],
    "motion": {
        "start": [
            {"time": 0.05, "position": [0.0, 0.0, 0.0], "angle": 0.0},
            {"time": 0.35, "position": [0.03, 0.0, 0.06], "angle": -0.5},
            {"time": 0.7, "position": [-0.03, 0.0, 0.02], "angle": 0.4},
        ]
    },
}
# Both ends clamped along x, brought together: the rope sags into a U.
CLOSED = {
    "initial_shape": [[0.0, 0.0], [0.08, -0.1], [0.2, -0.16], [0.32, -0.1], [0.34, 0.0]],
    "motion": {
        "start": [{"time": 0.0, "position": [0.0, 0.0, 0.0], "angle": 0.6}],
        "end": [
            {"time": 0.05, "position": [0.33, 0.0, 0.0], "angle": -0.6},
            {"time": 0.6, "position": [0.2, 0.0, 0.05], "angle": -1.2},
        ],
    },
}
# Pinned ends and a second control point that gives a direction.
PINNED = {
    "initial_shape": [[0.0, 0.0], [0.1, -0.08], [0.2, -0.1], [0.36, 0.0]],
    "motion": {
        "control_point_1": [{"time": 0.0, "position": [0.0, 0.0, 0.0]}],
        "control_point_2": [{"time": 0.0, "position": [0.02, 0.0, -0.01]}],
        "control_point_10": [
            {"time": 0.05, "position": [0.36, 0.0, 0.0]},
            {"time": 0.6, "position": [0.25, 0.0, 0.04]},
        ],
    },
}

# In space: both ends clamped, one led aside, swung out of the plane and turned about the rope.
TWISTED = {
    "initial_shape": [[0.0, 0.0, 0.0], [0.08, 0.02, -0.1], [0.2, 0.05, -0.12], [0.3, 0.05, 0.0]],
    "motion": {
        "start": [{"time": 0.0, "position": [0.0, 0.0, 0.0], "angle": 0.6}],
        "end": [
            {"time": 0.05, "position": [0.3, 0.05, 0.0], "angle": -0.6, "swing": 0.3},
            {"time": 0.6, "position": [0.22, -0.06, 0.04], "angle": -0.9, "swing": -0.4,
             "turn": 3.0},
        ],
    },
}  # fmt: skip


@dataclass(frozen=True)
class Apart:
    """How far both are apart, over L: mean along the rope, mean and largest over time."""

    mean: float
    worst: float
    start: float
    moved: float  # how far the effect moves the rope, likewise
    times: tuple[float, float]  # CPU seconds of the discrete and of the spline rod


def tree(manipulation: dict, effects: dict, duration: float, **rod) -> dict:
    properties = {"length": LENGTH, "diameter": DIAMETER, "young_modulus": 2e7, "density": 2500.0}
    return {
        "parameters": {
            "rod": {**properties, **rod},
            "damping": {"air_drag": 0.05, "relaxation_time": 0.004},
            "effects": effects,
        },
        "duration": duration,
        "camera": {"rate": RATE},
        **manipulation,
    }  # fmt: skip


def discrete(manipulation, effects, duration, edges, step, **rod):
    """Points seen (T, 81, 3) and the experiment."""
    made = read_experiment(tree(manipulation, effects, duration, **rod), "twin", "twin")
    simulation, _ = build_simulation(made, edges=edges, step=step)
    length = made.truth.rod.length
    truth = simulate(simulation, made.stamps, length)
    u = np.linspace(0.0, length, 81)
    points = np.array([
        made.hidden.measured(truth.centreline(k, u), (s - START_STAMP) / NANOSECONDS)
        for k, s in enumerate(made.stamps)
    ])  # fmt: skip
    return points, made, u


def ours(made, effects, first, u, spans, tolerance):
    settings = replace(made.truth, simulation=SimulationParameters(tolerance=tolerance))
    settings = settings.with_effects(effects)
    simulation = Simulation(settings, Motion([made.command]), spans=spans)
    simulation.start([Observation(made.stamps[0], first)], made.stamps[-1])
    simulation.published = simulation.model.basis  # what the projection loses is not the matter
    basis = simulation.model.basis
    predictions = [simulation.prediction(), *simulation.advance_through(made.stamps[1:])]
    return np.array([basis.evaluate(p.control_points[:, :3], u) for p in predictions])


def compare(manipulation, effects, *, duration=1.0, edges=300, step=5e-4, spans=56,
            tolerance=2e-5, plain=None, **rod) -> tuple[Apart, np.ndarray]:  # fmt: skip
    clock = time.process_time()
    points, made, u = discrete(manipulation, effects, duration, edges, step, **rod)
    took = time.process_time() - clock
    length = made.truth.rod.length
    basis = SplineBasis(made.truth.rod.control_points, length)
    fit = basis.matrix(u)
    first = np.zeros((basis.control_points, 4))
    first[:, :3] = np.linalg.lstsq(fit, points[0], rcond=None)[0]
    values = {
        k: {a: tuple(b) if isinstance(b, list) else b for a, b in v.items()}
        for k, v in effects.items()
    }
    clock = time.process_time()
    mine = ours(made, values, first, u, spans, tolerance)
    own = time.process_time() - clock
    far = np.linalg.norm(mine - points, axis=2).mean(axis=1) / length
    moved = np.nan
    if plain is not None:
        moved = np.linalg.norm(plain - points, axis=2).mean() / length
    return Apart(far.mean(), far.max(), far[0], moved, (took, own)), points
