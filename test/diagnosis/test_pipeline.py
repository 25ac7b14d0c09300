# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Held-out recordings are only predicted, and no effect is fitted to the simulation's own error."""

from dataclasses import replace

import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis import explanation_order, pipeline
from dlo_ros.diagnosis.fitting.evaluation import evaluate
from dlo_ros.diagnosis.fitting.initial_fit import begin
from dlo_ros.diagnosis.fitting.levenberg_marquardt import fit
from dlo_ros.diagnosis.pipeline import _learned
from dlo_ros.diagnosis.selection.effect_search import candidate


def test_the_plain_model_has_not_seen_what_is_held_out():
    recording, given = moving("simple", {}, 41)
    other, _ = moving("simple", {"gravity_tilt": {"angle": 0.3}}, 42)
    both = begin([recording, replace(other, name="other")], given)
    alone = begin([recording], given)
    found = _learned(both, 1, given)
    ratio, spoilt, expected = (
        at.model.settings.rod.specific_modulus for at in (found, both.at, alone.at)
    )
    assert abs(spoilt / expected - 1.0) > 0.1
    assert ratio == pytest.approx(expected, rel=4.5e-3)  # its std is 0.15 %
    assert found.cost < 1.01 * alone.at.cost
    assert len(found.residuals) == len(found.err) == 1
    assert float(found.err[0].mean()) == pytest.approx(float(alone.at.err[0].mean()), rel=0.02)
    # Nothing is fitted anew where nothing is held out.
    assert _learned(both, 2, given) is both.at


def test_nothing_is_fitted_to_the_simulation_s_own_error(monkeypatch):
    recording, given = moving("simple", {"gravity_tilt": {"angle": 0.3}}, 43)
    fine = begin([recording], given)
    rough = tuple(replace(r, spans=r.spans - 1) for r in fine.recordings)
    searched = []

    def search(team, before, *_, **__):
        """A tilt that explains the data, but for what the simulation itself does wrong."""
        searched.append(before.model.effects)
        model = before.model.extended("gravity_tilt", {"angle": 0.3}, ("angle",))
        found = candidate("gravity_tilt", "", fit(evaluate(model, *data), *data, 3), given)
        coarse = team.problem.recordings[0].spans < fine.recordings[0].spans
        return [replace(found, root_autocovariance=1.2 if coarse else 0.3)]

    data = fine.recordings, given
    monkeypatch.setattr(explanation_order, "training_set", lambda *_: None)
    monkeypatch.setattr(explanation_order, "screen", lambda *_: [])
    monkeypatch.setattr(explanation_order, "alarm", lambda _: (1.0, 0.0))
    monkeypatch.setattr(explanation_order, "pegs_beside_plain_model", lambda *_: [])
    monkeypatch.setattr(explanation_order, "search", search)
    monkeypatch.setattr(explanation_order, "finer", lambda *_: fine)
    begun = replace(fine, recordings=rough)
    sharper, plain, found = pipeline._search(begun, 1, given, 1, lambda *_: None)
    assert sharper is fine and len(plain.at.residuals) == 1
    assert found.decision.verdict == "explained"
    assert found.decision.chosen.effects == ("gravity_tilt",)
    assert searched == [(), ()]
