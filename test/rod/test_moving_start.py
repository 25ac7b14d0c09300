# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Starts in a first shape as it was observed: noisy, too short or too long, its ends askew."""

from dataclasses import replace

import numpy as np
import pytest
from measured import swing
from rods import PAPER, SECOND, command

from dlo_ros.command import Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

MOVING = replace(PAPER, simulation=replace(PAPER.simulation, start="moving"))
BASIS = SplineBasis(10, PAPER.rod.length)


def started(observations, motion, spans):
    simulation = Simulation(MOVING, motion, spans=spans)
    simulation.start(observations)
    return simulation


def stretch(simulation):
    """Largest strain of the axis at the start."""
    return np.abs(simulation.state.strains.stretch).max()


@pytest.fixture(scope="module")
def swinging():
    recording = swing(PAPER, seconds=0.2)
    return Motion(list(recording.commands)), recording.observations[:2]


@pytest.mark.parametrize("spans", [7, 28, 112])
def test_no_noisy_first_shape_is_refused(swinging, spans):
    motion, observations = swinging
    for seed in range(16):
        rng = np.random.default_rng(seed)
        noise = 1.5e-3 * rng.normal(size=(2, 10, 4)) * np.array([1.0, 0.0, 1.0, 0.0])
        noisy = [
            replace(o, control_points=o.control_points + e)
            for o, e in zip(observations, noise, strict=True)
        ]
        simulation = started(noisy, motion, spans)
        away = simulation.prediction().control_points - noisy[1].control_points
        assert np.abs(away[:, :3]).max() < 0.02


def loop(scale, spans):
    """A loop in space, held at both ends 0.15 rad askew, and how far it begins from the observed.

    Args:
        scale: observed length over the true one.

    Returns:
        Its simulation, distances [m] along u, and the loop's radius [m].
    """
    turn = np.linspace(0.0, 1.6 * np.pi, 400)
    radius = PAPER.rod.length / turn[-1]
    path = radius * np.column_stack([np.sin(turn), 0.2 * turn, np.cos(turn) - 1.0])
    path *= scale * PAPER.rod.length / np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    shape = np.zeros((10, 4))
    shape[:, :3] = BASIS.fit(np.linspace(0.0, PAPER.rod.length, 400), path)
    observations = [Observation(k * SECOND // 100, shape) for k in range(2)]
    askew = [[[0.0, np.sin(a), 0.0, np.cos(a)] for a in (0.075, 0.075 + 0.8 * np.pi)]]
    held = command(["start", "end"], [0.0], [shape[[0, -1], :3]], askew)
    simulation = started(observations, Motion([held]), spans)
    u = np.linspace(0.0, PAPER.rod.length, 200)
    there = simulation.model.basis.evaluate(simulation.state.q[:, :3], u)
    return simulation, np.linalg.norm(there - BASIS.evaluate(shape[:, :3], u), axis=1), radius


@pytest.mark.parametrize("spans", [14, 56, 224])
@pytest.mark.parametrize("scale", [0.9, 1.08])
def test_a_loop_in_space_that_is_too_short_or_too_long(spans, scale):
    """Between its ends nothing may buckle in short waves."""
    simulation, away, radius = loop(scale, spans)
    assert stretch(simulation) < 1e-4
    assert away.max() < 0.12 * PAPER.rod.length
    # No curvature but about that of the loop and of the ends' corrections.
    bend = np.linalg.norm(simulation.state.strains.other[:, :2], axis=1)
    assert np.median(bend) < 2.0 / radius


@pytest.mark.parametrize("spans", [14, 56])
def test_grips_that_are_measured_askew_lead_the_rope_aside_near_them_alone(spans):
    simulation, away, _ = loop(1.0, spans)
    assert stretch(simulation) < 1e-4
    assert away.mean() < 2.5e-3  # 6.3e-3 with three times that bending radius
