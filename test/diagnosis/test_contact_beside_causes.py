# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pegs and walls are looked for again beside other causes that leave something."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.contact.contact_search import ContactBesideSetUp
from dlo_ros.diagnosis.explain import contact_beside_causes as module
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.contact_beside_causes import with_contact
from dlo_ros.effects import Start
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import cause_priors, material_priors

FORCE = Start("constant_force", {"x": 0.0, "z": 0.05}, ("x", "z"), ("x", "z"))
PARAMETERS, _ = cause_priors(PAPER, FORCE)
CAUSE = SimpleNamespace(label="force", effect="constant_force", parameters=PARAMETERS)
PEG = SimpleNamespace(label="peg", effect="obstacle", parameters=())


def evaluation(evidence, err, model=None):
    return SimpleNamespace(
        posterior=SimpleNamespace(evidence=evidence), mean_err=err, model=model
    )  # fmt: skip


def fitted_with_a_force():
    model = ParametricModel(PAPER, material_priors(PAPER))
    model = model.extended(FORCE.effect, dict(FORCE.block), PARAMETERS)
    return Search(evaluation(100.0, 2e-3, model), (CAUSE,), ("first",), None)


@pytest.fixture
def asked(monkeypatch):
    """A contact that comes nearer, and the models in which contacts were looked for."""
    looked_in = []

    def contacts(recordings, given, model):
        looked_in.append(model)
        moved = model.theta()
        moved[0] += 0.1
        return [ContactBesideSetUp(model.at(moved), FORCE)]

    monkeypatch.setattr(module, "contacts_beside_set_up", contacts)
    monkeypatch.setattr(module, "leaves_something", lambda at, *_: at.mean_err >= 2e-3)
    monkeypatch.setattr(module, "takes_little", lambda *_: False)
    monkeypatch.setattr(module, "comes_nearer", lambda a, b, _: a.mean_err < b.mean_err)
    hit = SimpleNamespace(trial=(evaluation(150.0, 1e-3), PEG))
    given = SimpleNamespace(looked_in=looked_in, hit=hit, contacts=[])
    monkeypatch.setattr(
        module, "best_contact", lambda _, __, found: given.contacts.extend(found) or given.hit
    )
    return given


@pytest.mark.parametrize(
    ("evidence", "err", "better"), [(160.0, 1e-3, True), (101.0, 1e-3, False), (160.0, 3e-3, False)]
)
def test_a_search_goes_on_with_what_was_hit_where_that_explains_more(
    monkeypatch, asked, evidence, err, better
):
    def search(at, neutral, recordings, begun, enough, *, present):
        assert present == (CAUSE, PEG)
        return Search(evaluation(evidence, err), present, ("more",), None)

    monkeypatch.setattr(module, "search", search)
    found = fitted_with_a_force()
    after, contact = with_contact(found, PAPER, None, (), (), 1e-4)
    assert contact is (asked.hit if better else None)
    assert len(asked.looked_in) == 1
    if better:
        assert after.causes == (CAUSE, PEG) and after.trace == ("first", "more")
    else:
        assert after is found


def test_causes_stay_what_they_are_in_undisturbed_pictures_and_are_free_afterwards(
    monkeypatch, asked
):
    asked.hit = None
    found = fitted_with_a_force()
    model = found.at.model
    assert with_contact(found, PAPER, None, (), (), 1e-4) == (found, None)
    held, open_ = asked.looked_in  # these are fitted to undisturbed pictures, too
    assert open_ is model
    for p, x in zip(held.parameters, model.theta(), strict=True):
        free = model.parameters[model.index(p.name)]
        of_cause = p.name in {q.name for q in PARAMETERS}
        assert (p.std < 1e-3 * free.std and p.centre == pytest.approx(x)) == of_cause
    assert len(asked.contacts) == 2
    for contact in asked.contacts:
        assert contact.before.parameters == model.parameters
        assert contact.before.theta() == pytest.approx(
            model.theta() + 0.1 * np.eye(len(model.parameters))[0]
        )


@pytest.mark.parametrize("left", [False, True])
def test_nothing_is_looked_for_where_nothing_is_left_or_a_contact_is_known(
    monkeypatch, asked, left
):
    monkeypatch.setattr(module, "leaves_something", lambda *_: left)
    found = fitted_with_a_force()
    if left:
        monkeypatch.setattr(module, "takes_little", lambda *_: True)
    assert with_contact(found, PAPER, None, (), (), 1e-4) == (found, None)
    assert bool(asked.looked_in) == left
    known = Search(found.at, (CAUSE, PEG), (), None)
    monkeypatch.setattr(module, "leaves_something", lambda *_: False)
    assert with_contact(known, PAPER, None, (), (), 1e-4, shown=True) == (known, None)
    alone = Search(found.at, (), (), None)
    assert with_contact(alone, PAPER, None, (), (), 1e-4) == (alone, None)
    assert bool(asked.looked_in) == left


@pytest.mark.parametrize(("left", "beside_all"), [(False, False), (True, True), (True, False)])
def test_the_last_cause_may_do_the_work_of_what_was_hit(monkeypatch, asked, left, beside_all):
    """A stiffer segment for a peg beside a creep, of which all was explained."""
    bare = fitted_with_a_force()
    segment = SimpleNamespace(label="segment", effect="stiff_segment", parameters=(), start=FORCE)
    found = replace(bare, at=evaluation(100.0, 2e-3, bare.at.model), causes=(CAUSE, segment))
    monkeypatch.setattr(module, "leaves_something", lambda at, *_: left and at.mean_err >= 2e-3)
    monkeypatch.setattr(module, "without", lambda at, cause, _: cause is segment and bare.at)
    hit = asked.hit
    monkeypatch.setattr(
        module, "best_contact", lambda at, *_: hit if at is bare.at or beside_all else None
    )

    def search(at, neutral, recordings, begun, enough, *, present):
        return Search(evaluation(160.0, 1e-3), present, ("more",), None)

    monkeypatch.setattr(module, "search", search)
    after, contact = with_contact(found, PAPER, None, (), (), 1e-4)
    assert contact is hit
    assert after.causes == ((CAUSE, segment, PEG) if beside_all else (CAUSE, PEG))


@pytest.mark.parametrize(
    ("evidence", "err", "rivals"),
    [
        (160.0, 1e-3, None),  # the peg takes its place
        (-600.0, 1.5e-3, {"obstacle": {"x": 0.1}}),  # beside impacts evidence does not tell
        (-600.0, 3e-3, {}),
    ],
)
def test_a_wall_that_no_picture_has_shown_may_be_a_peg(monkeypatch, asked, evidence, err, rivals):
    """A horizontal wall 11 cm below the peg, which friction had hidden from the search."""
    bare = fitted_with_a_force()
    wall = SimpleNamespace(label="wall (table)", effect="wall", parameters=())
    effects = {"wall": {"offset": 0.0}, "obstacle": {"x": 0.1}}
    model = SimpleNamespace(settings=SimpleNamespace(effects=effects))
    found = replace(bare, at=evaluation(100.0, 2e-3, model), causes=(CAUSE, wall))
    monkeypatch.setattr(module, "without", lambda at, cause, _: cause is wall and bare.at)
    monkeypatch.setattr(module, "leaves_something", lambda *_: False)
    monkeypatch.setattr(module, "nearest_err", lambda at, _: at.mean_err)

    def search(at, neutral, recordings, begun, enough, *, present):
        assert present == (CAUSE, PEG)
        return Search(evaluation(evidence, err, model), present, ("more",), None)

    monkeypatch.setattr(module, "search", search)
    after, contact = with_contact(found, PAPER, None, (), (), 1e-4)
    assert asked.looked_in
    if rivals is None:
        assert after.causes == (CAUSE, PEG) and contact is asked.hit
    else:
        assert after is found and contact.trial[1] is wall and contact.rivals == rivals


@pytest.mark.parametrize("apart", [True, False])
def test_a_wall_is_elsewhere_only_where_data_tell_it_from_the_one_that_was_found(
    monkeypatch, asked, apart
):
    bare = fitted_with_a_force()
    wall, other = (SimpleNamespace(label=n, effect="wall", parameters=()) for n in ("a", "b"))
    found = replace(bare, causes=(CAUSE, wall))
    asked.hit.trial = asked.hit.trial[0], other
    more = Search(evaluation(160.0, 1e-3), (CAUSE, other), ("more",), None)
    monkeypatch.setattr(module, "without", lambda *_: bare.at)
    monkeypatch.setattr(module, "leaves_something", lambda *_: False)
    monkeypatch.setattr(module, "search", lambda *_, **__: more)
    monkeypatch.setattr(module, "tells_apart", lambda *_: apart)
    after, contact = with_contact(found, PAPER, None, (), (), 1e-4)
    assert after.causes == ((CAUSE, other) if apart else (CAUSE, wall))
    assert contact is (asked.hit if apart else None)


@pytest.mark.parametrize(("evidence", "better"), [(160.0, True), (101.0, False)])
def test_beside_what_was_hit_something_else_may_have_been(monkeypatch, asked, evidence, better):
    """A peg above a table on which the rope lands, where a segment leaves something."""
    bare = fitted_with_a_force()
    wall = SimpleNamespace(label="wall (table)", effect="wall", parameters=())
    found = replace(bare, causes=(CAUSE, wall))

    def search(at, neutral, recordings, begun, enough, *, present):
        assert present == (CAUSE, wall, PEG)
        return Search(evaluation(evidence, 1e-3), present, ("more",), None)

    monkeypatch.setattr(module, "search", search)
    after, contact = with_contact(found, PAPER, None, (), (), 1e-4, shown=True)
    assert contact is None  # that is what was hit first
    assert after.causes == ((CAUSE, wall, PEG) if better else (CAUSE, wall))
    assert after.trace == (("first", "more") if better else ("first",))
    assert all(m.names == bare.at.model.names for m in asked.looked_in)


def test_nothing_hit_that_needs_no_other_cause_is_looked_for_again(monkeypatch, asked):
    monkeypatch.setattr(module, "leaves_something", lambda *_: False)
    wall = SimpleNamespace(label="wall (table)", effect="wall", parameters=())
    alone = replace(fitted_with_a_force(), causes=(wall,))
    assert with_contact(alone, PAPER, None, (), (), 1e-4) == (alone, None)
    monkeypatch.setattr(module, "without", lambda *_: None)  # it cannot be simulated
    found = replace(alone, causes=(CAUSE, wall))
    assert with_contact(found, PAPER, None, (), (), 1e-4) == (found, None)
    assert not asked.looked_in
