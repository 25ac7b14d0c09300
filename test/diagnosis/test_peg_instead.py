# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A peg in the place of a wall that the DLO touches in one place."""

from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.contact.wall_places import normal
from dlo_ros.diagnosis.explain import contact_trials
from dlo_ros.diagnosis.explain import peg_instead as module
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.contact_trials import Contact
from dlo_ros.diagnosis.explain.peg_instead import pegs_touched, with_peg_or_wall
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors

ANGLE = 0.4
TIP = np.array([0.2, -0.3])  # x, z of the place that touches [m]
START = StraightWall.touching(normal(ANGLE), float(TIP @ normal(ANGLE)) - 0.5 * PAPER.rod.diameter)
WALL = proposal_of(PAPER, START)


def hit(err=1e-3):
    """A fit with a wall that the end of a straight DLO touches."""
    model = ParametricModel(PAPER, material_priors(PAPER))
    model = model.extended(START.effect, dict(START.block), WALL.parameters)
    shapes = np.zeros((3, PAPER.rod.control_points, 4))
    along = np.linspace(PAPER.rod.length, 0.0, PAPER.rod.control_points)
    shapes[..., [0, 2]] = TIP + along[:, None] * normal(ANGLE)
    return SimpleNamespace(
        model=model, predicted=(shapes,), mean_err=err, posterior=SimpleNamespace(evidence=0.0)
    )


def test_pegs_touch_the_dlo_where_the_wall_does():
    found = pegs_touched(hit())
    assert len({start.block["radius"] for start in found}) == len(found) > 1
    for start in found:
        centre = np.array([start.block["x"], start.block["z"]])
        away = start.block["radius"] + 0.5 * PAPER.rod.diameter
        assert centre + away * normal(ANGLE) == pytest.approx(TIP, abs=1e-3)


@pytest.mark.parametrize(
    ("err", "goes_on_to", "evidence", "named", "rivals"),
    [
        (0.5e-3, 1e-3, -50.0, "obstacle", []), (0.5e-3, 1e-3, -500.0, "wall", ["obstacle"]),
        (1e-3, None, 0.0, "wall", ["obstacle"]),
        (1e-3, None, 50.0, "obstacle", ["wall"]), (1.3e-3, None, 50.0, "wall", []),
        (None, None, 0.0, "wall", []),
        # The wall's fit had not ended, and the peg's has just gone on.
        (0.5e-3, 0.52e-3, -50.0, "wall", ["obstacle"]),
    ],
)  # fmt: skip
def test_a_peg_that_comes_nearer_is_taken_and_one_as_near_is_a_rival_or_has_it(
    monkeypatch, err, goes_on_to, evidence, named, rivals
):
    at = hit()
    found = Search(at, (WALL,), (), None)
    tried, ended = [], []

    def fitted(model, *_, draft):
        assert draft
        assert set(model.settings.effects) == {"obstacle"}
        tried.append(model)
        return None if err is None else SimpleNamespace(model=model, mean_err=1.5 * err)

    def fit(begun, *_):
        if begun is at:
            return hit(goes_on_to)
        posterior = SimpleNamespace(evidence=evidence)
        ended.append(SimpleNamespace(model=begun.model, mean_err=err, posterior=posterior))
        return ended[-1]

    monkeypatch.setattr(contact_trials, "fitted", fitted)
    monkeypatch.setattr(module, "nearest_err", lambda e, _: e.mean_err)
    monkeypatch.setattr(module, "fit", fit)
    apart = lambda better, other: better.posterior.evidence > 100.0 + other.posterior.evidence
    monkeypatch.setattr(module, "tells_apart", apart)
    after, contact = with_peg_or_wall(found, None, ())
    assert len(tried) > 1
    assert [c.effect for c in after.causes] == [named]
    assert (after.at in ended) == (named == "obstacle")
    assert (after.at is at) == (named == "wall" and goes_on_to is None)
    assert len(ended) == (err is not None)  # one of them is fitted to its end
    assert list(contact.rivals if contact else {}) == rivals
    if contact:  # beside a model that lacks something the other one may be as right
        other = {"wall": "obstacle", "obstacle": "wall"}[named]
        assert list(contact.instead(complete=False)) == [other]


def test_no_peg_is_tried_without_a_wall_or_beside_a_known_one(monkeypatch):
    monkeypatch.setattr(contact_trials, "fitted", lambda *_: pytest.fail("a peg was fitted"))
    at = hit()
    bare = Search(at, (), (), None)
    assert with_peg_or_wall(bare, None, ()) == (bare, None)
    known = Contact((at, WALL), {"obstacle": {"x": 0.1, "z": 0.0, "radius": 0.01}})
    found = Search(at, (WALL,), (), None)
    assert with_peg_or_wall(found, known, ()) == (found, known)
