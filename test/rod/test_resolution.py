# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The number of knot spans that a simulation needs."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command

from dlo_ros.errors import SimulationError
from dlo_ros.rod import resolution
from dlo_ros.rod.resolution import choose

SHAPE = np.zeros((10, 4))
SHAPE[:, 0] = np.linspace(0.0, 0.4, 10)
STAMPS = [int(t) for t in np.linspace(0, SECOND, 200)]


def turned(angle):
    """A clamp at the start that turns by an angle [degrees] in a second."""
    half = np.radians(np.linspace(0.0, angle, 9)) / 2.0
    turns = [[[0.0, np.sin(a), 0.0, np.cos(a)]] for a in half]
    return command(["start"], np.linspace(0.0, 1.0, 9), [[[0.0, 0.0, 0.0]]] * 9, turns)


@pytest.mark.parametrize("angle", [-200.0, 170.0])
def test_different_branches_are_no_discretisation_error(angle, caplog):
    """A clamp that turns a rope far up: it hangs over to either side, and snaps in between."""
    imposed = turned(angle)
    for young_modulus in (5e6, 2e8):
        settings = PAPER.with_material(young_modulus, 2500.0)
        found = choose(settings, imposed, SHAPE, STAMPS)
        assert found.error <= settings.simulation.tolerance
    assert not caplog.records


def without_equilibria(monkeypatch, spans, after):
    """From so many spans on, no equilibrium is found after an instant [s]."""
    settle = resolution.settle

    def sometimes(model, boundary, state, imposed, stamp, **words):
        if model.basis.spans >= spans and stamp > after * SECOND:
            raise SimulationError("no static equilibrium found")
        return settle(model, boundary, state, imposed, stamp, **words)

    monkeypatch.setattr(resolution, "settle", sometimes)


def test_a_resolution_without_some_equilibria_is_judged_before_them(monkeypatch):
    """As where strands rub, and the rod is led from one instant to the next in one step."""
    settings = PAPER.with_material(2e8, 2500.0)
    whole = choose(settings, turned(60.0), SHAPE, STAMPS)
    without_equilibria(monkeypatch, 2 * whole.spans, 0.9)
    found = choose(settings, turned(60.0), SHAPE, STAMPS)
    assert found.spans <= whole.spans
    assert 0.0 < found.error <= settings.simulation.tolerance
    fine = replace(settings, simulation=replace(settings.simulation, tolerance=1e-6))
    kept = choose(fine, turned(60.0), SHAPE, STAMPS)
    assert kept.spans > whole.spans


def test_a_rod_without_any_equilibrium_is_refused(monkeypatch):
    without_equilibria(monkeypatch, 1, -1.0)
    with pytest.raises(SimulationError, match="no static equilibrium"):
        choose(PAPER, turned(60.0), SHAPE, STAMPS)
