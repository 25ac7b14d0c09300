# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The search for causes: what is added, and why the others are not."""

from types import SimpleNamespace

from dlo_ros.diagnosis.explain import cause_search


def evaluation(evidence, err):
    return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)


def best_of(monkeypatch, fits):
    """The cause that is added, and what became of each, by name: fits are (evidence, ERR)."""
    promises = [
        SimpleNamespace(proposal=SimpleNamespace(label=name), gain=10.0, model=name)
        for name in fits
    ]
    monkeypatch.setattr(cause_search, "_checked", lambda promise, _: (1e-3, promise))
    monkeypatch.setattr(cause_search, "fitted", lambda model, *_: evaluation(*fits[model]))
    monkeypatch.setattr(cause_search, "fit", lambda found, *_: found)
    best, trace = cause_search._best_of(1, evaluation(0.0, 2e-3), promises, ())
    return best and best[1].label, {step.name: step.outcome for step in trace}


def test_what_gains_most_is_added(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (9.0, 1e-3), "tilt": (20.0, 1.5e-3)})
    assert added == "tilt"
    assert told == {"tilt": "added", "mass": "fitted, but another gains more"}


def test_what_moves_predictions_away_from_the_shapes_is_not(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (9.0, 1e-3), "tilt": (20.0, 4e-3)})
    assert added == "mass"
    assert told == {"tilt": "makes matters worse", "mass": "added"}
    added, told = best_of(monkeypatch, {"tilt": (20.0, 4e-3)})
    assert added is None and told == {"tilt": "makes matters worse"}


def test_a_small_gain_is_no_cause(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (2.0, 1e-3)})
    assert added is None and told == {"mass": "gains too little"}
