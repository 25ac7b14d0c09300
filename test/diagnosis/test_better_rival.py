# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rival that explains more than a cause takes its place, and everything is named anew."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis import pipeline
from dlo_ros.diagnosis.explain import joint_explanation
from dlo_ros.diagnosis.explain.cause_naming import Named
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.joint_explanation import EXCHANGES, explain
from dlo_ros.diagnosis.findings import joint_learning
from dlo_ros.diagnosis.findings.joint_learning import Errors, Learned, training_set, with_names
from dlo_ros.identification.offline.initial_fit import begin


@pytest.mark.parametrize("better", [1, 99])
def test_what_a_better_rival_leaves_is_explained_and_named_anew(monkeypatch, better):
    """It ends, however often a rival seems better."""
    recording, given = moving("simple", {}, 61)
    begun = begin([recording], given)
    prepared = training_set(begun, 1, begun.at.model.settings, given).prepared
    asked = []

    def search(at, *_, **__):
        return Search(at, (), (), None)

    def named(found, *_, exchange, **__):
        asked.append(exchange)
        if exchange and len(asked) <= better:
            return Named((), {}, replace(found, at=replace(prepared.setup)))
        return Named((), {"viscoelasticity": {}})

    monkeypatch.setattr(joint_explanation, "search", search)
    monkeypatch.setattr(joint_explanation, "named", named)
    monkeypatch.setattr(joint_explanation, "beside_exact_set_up", lambda *_: None)
    unnamed = explain(prepared, given)
    found = unnamed.with_names()
    assert "viscoelasticity" in found.shifts and found.naming is None
    assert found.at is not unnamed.at
    assert asked == [True] * min(better, EXCHANGES) + [better == 1]


@pytest.mark.parametrize("changed", [True, False])
def test_what_is_foretold_is_foretold_by_the_model_that_was_named(monkeypatch, changed):
    at, other = object(), SimpleNamespace(model="model")
    named = SimpleNamespace(at=other if changed else at)
    unnamed = SimpleNamespace(at=at, with_names=lambda: named)
    parts = (object(),)

    def refitted(found, recordings):
        assert found is other and recordings is parts
        return other

    monkeypatch.setattr(joint_learning, "refitted", refitted)
    monkeypatch.setattr(joint_learning, "nearest", lambda at, _: at)
    monkeypatch.setattr(joint_learning, "errors_of", lambda *_: "errors")
    before = Learned(unnamed, {}, (), Errors(), at, parts)
    found = with_names(before, ())
    assert found.explanation is named
    assert (found.predicting, found.err) == ((other, "errors") if changed else (at, before.err))


@pytest.mark.parametrize(("nearer", "refined"), [(True, 2), (False, 1)])
def test_a_model_that_comes_nearer_may_need_a_finer_simulation(monkeypatch, nearer, refined):
    far, near = (SimpleNamespace(explanation=SimpleNamespace(at=object())) for _ in range(2))
    beginning = SimpleNamespace(recordings=(), left_out=())
    seen = []

    def sharper(plain, found, begun):
        seen.append(found)

    def names(found, _):
        return near if nearer else found

    monkeypatch.setattr(pipeline, "searchable", lambda settings: settings)
    monkeypatch.setattr(pipeline, "_begun", lambda *_: beginning)
    monkeypatch.setattr(pipeline, "_explained", lambda *_: ("plain", far))
    monkeypatch.setattr(pipeline, "_better_plain_model", lambda *_: None)
    monkeypatch.setattr(pipeline, "_sharper", sharper)
    monkeypatch.setattr(pipeline, "with_names", names)
    monkeypatch.setattr(pipeline, "joint_outcome", lambda *words: words)
    monkeypatch.setattr(pipeline, "replace", lambda outcome, **_: outcome)
    monkeypatch.setattr(pipeline, "with_forces", lambda outcome, *_: outcome)
    outcome = pipeline.diagnose([object()], "given")
    assert outcome == (beginning, "plain", near if nearer else far, "given")
    assert seen == [far, near][:refined]
