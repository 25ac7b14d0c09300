# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Grips that give: what lies beside them, and what begins to give while it is simulated."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command, held_start

from dlo_ros.command import Motion
from dlo_ros.identification.cooperative_tasks import exhausted
from dlo_ros.observation import Observation
from dlo_ros.parameters import DampingParameters
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

ROD = PAPER.rod


@pytest.mark.parametrize("spans", [14, 28, 56])
@pytest.mark.parametrize("compliance", [0.1, 0.85, 30.0])
def test_a_grip_that_gives_leaves_a_stiff_piece_beside_it_its_compliance(spans, compliance):
    """A plug on an end that is held is a thousand times as stiff as the rest, and no stiffer."""
    basis = SplineBasis(spans + 3, ROD.length)
    plug = {"connector": {"mass": 0.0, "extent": 0.11 * ROD.length}}
    alone = PAPER.with_effects(plug).body(basis).bend
    body = PAPER.with_effects({**plug, "clamp_compliance": {"end": compliance}}).body(basis)
    assert body.bend.min() > 0.0
    assert body.bend.max() < 20.0 * alone.max()
    # Farther off than a knot span nothing changes.
    far = body.points < ROD.length - basis.span_length
    assert body.bend[far] == pytest.approx(alone[far])


def started(settings):
    """A cantilever that hangs at rest."""
    shape = np.zeros((settings.rod.control_points, 4))
    shape[:, 0] = SplineBasis(settings.rod.control_points, ROD.length).greville
    simulation = Simulation(settings, Motion([held_start()]))
    simulation.start([Observation(SECOND, shape)])
    return simulation


DAMPED = replace(PAPER, damping=DampingParameters(air_drag=0.2, relaxation_time=0.01))
GIVES = DAMPED.with_effects({"clamp_compliance": {"start": 20.0}})


def test_a_grip_begins_to_give_while_the_rod_is_simulated():
    """As a node's parameter is set: the spline becomes finer beside the grip, and goes on."""
    simulation, rest = started(DAMPED), started(GIVES).prediction().control_points
    before = simulation.prediction().control_points
    simulation.advance(SECOND + SECOND // 10)
    simulation.update(GIVES)
    assert simulation.basis.halvings > 0
    here = simulation.prediction().control_points
    assert np.abs(here - before).max() < 2e-4 * ROD.length
    simulation.advance(9 * SECOND)
    there = simulation.prediction().control_points
    assert np.abs(rest - before).max() > 0.03 * ROD.length
    assert np.abs(there - rest).max() < 5e-4 * ROD.length
    simulation.update(DAMPED)  # it is never coarsened
    assert simulation.basis.halvings > 0


def test_sets_run_together_where_all_have_the_same_knot_spans():
    for first, second, together in ((DAMPED, GIVES, False), (GIVES, DAMPED, True)):
        batch = exhausted(started(first).batching([first, second], 2 * SECOND))
        assert (batch is not None) == together


def waved(compliance, aside, names=()):
    """Shapes (T, n, 3) of a rod whose grip is waved, aside by a share of that, and derivatives."""
    t = np.linspace(0.0, 0.6, 61)
    positions = np.zeros((61, 1, 3))
    positions[:, 0] = 0.02 * ((1.0 - np.cos(10.0 * t)) ** 2)[:, None] * [-1.0, aside, 0.5]
    settings = DAMPED.with_effects({"clamp_compliance": {"start": compliance}})
    shape = np.zeros((settings.rod.control_points, 4))
    shape[:, 0] = SplineBasis(settings.rod.control_points, ROD.length).greville
    imposed = command(["start"], t, positions, stamp=SECOND)
    simulation = Simulation(settings, Motion([imposed]), parameters=names, spans=14)
    simulation.start([Observation(SECOND, shape)])
    track = simulation.advance_through([SECOND + k * SECOND // 30 for k in range(1, 19)])
    shapes = np.array([p.control_points[:, :3] for p in track])
    if not names:
        return shapes, None
    return shapes, np.array([p.sensitivity[0, :, :3] for p in track])


def test_a_grip_gives_in_space_as_in_the_plane():
    flat, _ = waved(20.0, 0.0)
    aside, _ = waved(20.0, 1e-7)
    np.testing.assert_allclose(aside, flat, atol=2e-5 * ROD.length)


def test_the_derivative_by_a_give_in_space_is_that_of_its_differences():
    found = waved(20.0, 0.6, ("effects.clamp_compliance.start",))[1]
    step = 0.5
    expected = (waved(20.0 + step, 0.6)[0] - waved(20.0 - step, 0.6)[0]) / (2.0 * step)
    np.testing.assert_allclose(found, expected, atol=0.02 * np.abs(expected).max())
