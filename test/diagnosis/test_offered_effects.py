# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that may be added to a model are simulated once for models of nearly the same shapes."""

from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.explain import offered_effects
from dlo_ros.diagnosis.explain.offered_effects import SHAPES_ALIKE, Offer, offered
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of, simulated_together
from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference.parameter import ParametricModel

MASS = Start("point_mass", {"mass": 0.0, "position": 0.2}, ("mass",), ("mass", "position"))
HEAVIER = Start("point_mass", {"mass": 0.0, "position": 0.4}, ("mass",), ("mass", "position"))
FORCE = Start("constant_force", {"x": 0.0, "z": 0.0}, ("x", "z"), ("x", "z"))
CREEP = Start("viscoelasticity", {"share": 0.0, "time": 0.5}, ("share",), ("share", "time"))
FRICTION = Start("surface_friction", {"force": 0.1}, ("force",), ("force",), neutral=False)


def simulated(moved, effects=()):
    settings = PAPER.with_effects({name: {"mass": 0.1} for name in effects})
    shapes = np.zeros((3, 10, 4))
    shapes[..., 0] = moved * PAPER.rod.length
    return SimpleNamespace(predicted=(shapes,), model=ParametricModel(settings, ()))


@pytest.mark.parametrize(("moved", "serves"), [(0.5, True), (1.5, False)])
def test_an_offer_serves_models_of_nearly_the_same_shapes(monkeypatch, moved, serves):
    known = Offer(simulated(0.0), (proposal_of(PAPER, MASS), proposal_of(PAPER, FORCE)), {})
    monkeypatch.setattr(offered_effects, "simulate", lambda *_: pytest.fail("simulated"))
    other = simulated(moved * SHAPES_ALIKE)
    assert known.serves(other) is serves
    if serves:
        assert offered(other, (), (MASS, FORCE), known).proposals == known.proposals


def test_what_a_model_contains_is_not_offered_to_it_again():
    known = Offer(simulated(0.0), (proposal_of(PAPER, MASS), proposal_of(PAPER, FORCE)), {})
    found = offered(simulated(0.0, ("point_mass",)), (), (MASS, FORCE), known)
    assert [p.effect for p in found.proposals] == ["constant_force"]


def test_effects_that_make_derivatives_expensive_are_simulated_apart():
    proposals = [proposal_of(PAPER, s) for s in (MASS, HEAVIER, FORCE, CREEP, FRICTION)]
    found = simulated_together(PAPER, proposals)
    assert [[p.start for p in group] for group in found] == [
        [FRICTION], [MASS, FORCE], [HEAVIER], [CREEP],
    ]  # fmt: skip


def test_an_effect_that_cannot_be_simulated_takes_no_other_one_away(monkeypatch):
    """They share simulations, since their derivatives cost little beside one another."""
    gives = Start("clamp_compliance", {"start": 0.0}, ("start",), ("start",))
    simulations = []

    def simulate(model, _, names):
        simulations.append(names)
        if any("clamp_compliance" in name for name in names):
            raise SimulationError("no equilibrium")
        return names

    monkeypatch.setattr(offered_effects, "simulate", simulate)
    monkeypatch.setattr(
        offered_effects, "columns", lambda _, together, found: {id(p): found for p in together}
    )
    found = offered(simulated(0.0), (), (MASS, gives, FORCE))
    assert [p.effect for p in found.proposals] == ["point_mass", "constant_force"]
    assert len(simulations) > 1
