# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A wall is turned about the place that is touched as long as that explains more."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.contact.wall_places import normal
from dlo_ros.diagnosis.explain import contact_trials, turned_walls
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.turned_walls import MOST_TURNS, TURN, touched, with_turned_wall
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors

TIP = np.array([0.2, -0.3])  # x, z of the place that touches [m]
START = StraightWall.touching(normal(0.4), float(TIP @ normal(0.4)) - 0.5 * PAPER.rod.diameter)
WALL = proposal_of(PAPER, START)


def hit(model=None, evidence=0.0):
    """A fit with a wall that the end of a straight DLO touches."""
    if model is None:
        model = ParametricModel(PAPER, material_priors(PAPER))
        model = model.extended(START.effect, dict(START.block), WALL.parameters)
    shapes = np.zeros((3, PAPER.rod.control_points, 4))
    along = np.linspace(PAPER.rod.length, 0.0, PAPER.rod.control_points)
    shapes[..., [0, 2]] = TIP + along[:, None] * normal(0.4)
    return SimpleNamespace(
        model=model, predicted=(shapes,), posterior=SimpleNamespace(evidence=evidence)
    )


def turns(at):
    """Turns of a model's wall from where it was, and whether it touches the same place."""
    wall = at.model.settings.effects["wall"]
    assert TIP @ normal(wall["angle"]) - wall["offset"] == pytest.approx(
        0.5 * PAPER.rod.diameter, abs=1e-3
    )
    return (wall["angle"] - 0.4) / TURN


@pytest.fixture
def tried(monkeypatch):
    """The turns that are tried, with a function that sets the evidence of a turn."""
    made, law = [], {}

    def fitted(model, *_, draft):
        at = hit(model)
        made.append(round(turns(at)))
        evidence = law["of"](made[-1])
        return None if evidence is None else hit(model, evidence)

    monkeypatch.setattr(contact_trials, "fitted", fitted)
    monkeypatch.setattr(turned_walls, "fit", lambda at, *_: at)
    monkeypatch.setattr(turned_walls, "tells_apart", lambda *_: law.get("apart", True))
    return made, law


@pytest.mark.parametrize(
    ("best", "asked"),
    [(-2, [1, -1, -2, -3]), (1, [1, 2]), (0, [1, -1]), (-9, [1, -1, -2, -3, -4])],
)
def test_a_wall_is_turned_to_where_it_explains_most(tried, best, asked):
    made, law = tried
    law["of"] = lambda turn: 100.0 * (abs(best) - abs(turn - best))
    at = hit()
    found = with_turned_wall(Search(at, (WALL,), (), None), ())
    assert made == asked
    assert round(turns(found.at)) == max(best, -MOST_TURNS)
    assert [c.effect for c in found.causes] == ["wall"]
    assert (found.at is at) == (best == 0)


@pytest.mark.parametrize(("turn", "turned"), [(1, False), (-1, True)])
def test_where_data_do_not_tell_a_wall_stands_upright_or_a_table_lies_level(tried, turn, turned):
    _, law = tried
    law["of"], law["apart"] = lambda there: 50.0 * (there == turn), False
    at = hit()
    found = with_turned_wall(Search(at, (WALL,), (), None), ())
    assert (found.at is not at) == turned


def test_a_wall_that_cannot_be_turned_or_gains_nothing_by_that_stays(tried):
    made, law = tried
    law["of"] = {1: None, -1: 0.1}.get
    found = Search(hit(), (WALL,), (), None)
    assert with_turned_wall(found, ()) is found
    assert made == [1, -1]


def test_only_a_wall_is_turned(tried):
    made, _ = tried
    bare = Search(hit(), (), (), None)
    assert with_turned_wall(bare, ()) is bare
    peg = replace(bare, causes=(SimpleNamespace(effect="obstacle"),))
    assert with_turned_wall(peg, ()) is peg
    assert not made


def test_the_place_that_is_touched_is_that_of_the_dlo_s_axis():
    assert touched(hit()) == pytest.approx(TIP, abs=1e-3)
