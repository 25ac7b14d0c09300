# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The contact with which the search for causes begins, and its rivals."""

from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.contact.contact_search import ContactBesideSetUp
from dlo_ros.diagnosis.explain import contact_trials, trials
from dlo_ros.diagnosis.explain.cause_naming import Cause, beside_contact
from dlo_ros.effects import Start
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference import joint_fit
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors


def evaluation(evidence, err):
    return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)


def test_the_peg_that_explains_most_is_where_the_search_begins(monkeypatch):
    """Unless predictions can come no nearer, or it gains too little."""
    monkeypatch.setattr(trials, "own_err", lambda *_: 0.0)
    monkeypatch.setattr(joint_fit, "approached", lambda at, _: at)
    peg = {"x": 0.1, "z": -0.1, "radius": 0.01}
    before = ParametricModel(PAPER, material_priors(PAPER))
    pegs = [
        ContactBesideSetUp(
            before, Start("obstacle", {**peg, "x": x}, (), tuple(peg), neutral=False, form=f"{x}")
        )
        for x in (0.1, 0.2, 0.3)
    ]

    def first_peg(evidences, errs):
        fits = dict(zip((0.1, 0.2, 0.3), zip(evidences, errs, strict=True), strict=True))
        monkeypatch.setattr(
            contact_trials, "fitted",
            lambda model, _: evaluation(*fits[model.settings.effects["obstacle"]["x"]]),
        )  # fmt: skip
        found = contact_trials.best_contact(evaluation(0.0, 2e-3), (), pegs)
        return found and found.trial[1].form

    assert first_peg((9.0, 20.0, 30.0), (1e-3, 1e-3, 4e-3)) == "0.2"
    assert first_peg((1.0, 2.0, 2.5), (1e-3,) * 3) is None
    assert contact_trials.best_contact(evaluation(0.0, 2e-3), (), ()) is None


@pytest.mark.parametrize(
    ("gain", "err", "named", "rivals"),
    [
        (25.0, 1e-3, "wall", ["obstacle"]),
        (15.0, 1e-3, "obstacle", ["wall"]),
        (25.0, 0.5e-3, "wall", []),
        (15.0, 1.5e-3, "obstacle", []),
    ],
)
def test_of_a_wall_and_a_peg_the_one_that_explains_more_stays(
    monkeypatch, gain, err, named, rivals
):
    """The other is a rival where it comes as near."""
    peg = {"x": 0.1, "z": -0.1, "radius": 0.01}
    start = Start("obstacle", peg, (), tuple(peg), neutral=False)
    before = ParametricModel(PAPER, material_priors(PAPER))
    wall = StraightWall.touching(np.array([-1.0, 0.0]), -0.11)
    contacts = [ContactBesideSetUp(before, s) for s in (start, wall)]

    def fitted(model, _):
        flat = "wall" in model.settings.effects
        found = evaluation(gain, err) if flat else evaluation(20.0, 1e-3)
        assert len(model.settings.effects) == 1
        found.model = model
        return found

    monkeypatch.setattr(contact_trials, "fitted", fitted)
    found = contact_trials.best_contact(evaluation(0.0, 2e-3), (), contacts)
    at, proposal = found.trial
    assert proposal.effect == named and named in at.model.settings.effects
    assert list(found.rivals) == rivals
    causes = tuple(Cause(e, (), {}, 9.0, 1e-2, 0.0) for e in (named, "point_mass"))
    whole, lacking = (beside_contact(causes, found, complete=c) for c in (True, False))
    assert list(whole[0].rivals) == rivals
    assert list(lacking[0].rivals) == [{"wall": "obstacle", "obstacle": "wall"}[named]]
    assert not whole[1].rivals and not lacking[1].rivals
    if named == "wall":
        assert at.model.settings.effects["wall"] == pytest.approx(
            {"offset": -0.11, "angle": -0.5 * np.pi}
        )
