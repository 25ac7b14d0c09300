# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A local effect that did its work at a wrong place while another cause was missing."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from cause_fits import evaluation, model_of
from rods import PAPER

from dlo_ros.diagnosis.explain import cause_search, far_starts
from dlo_ros.diagnosis.explain.far_starts import with_best_in_place
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of, with_proposals
from dlo_ros.effects import Start

FITTED = ("centre", "extent", "ratio")
SOFT = Start(
    "stiff_segment", {"centre": 0.1, "extent": 0.1, "ratio": 0.5}, (), FITTED, form="at 0.1 m"
)
STIFF = replace(SOFT, block={"centre": 0.3, "extent": 0.1, "ratio": 5.0}, form="at 0.3 m")
FORCE = Start("constant_force", {"x": 0.0, "z": 0.0}, ("x", "z"), ("x", "z"))


def model_with(*starts):
    model = model_of(PAPER)
    for start in starts:
        model, _ = with_proposals(model, [proposal_of(model.settings, start)])
    return model


def fit_of(evidence, err, model):
    found = evaluation(evidence, err)
    found.model = model
    return found


@pytest.fixture
def fits(monkeypatch):
    """A list of the effects with which fits begin; each of these fits explains more."""
    begun = []

    def settled(model, proposal, _):
        begun.append(model.settings.effects)
        return fit_of(600.0, 0.5e-3, model), proposal

    monkeypatch.setattr(far_starts, "_settled", settled)
    return begun


def causes_of(*starts):
    return [proposal_of(PAPER, start) for start in starts]


def test_a_soft_stretch_becomes_a_stiff_one_beside_it(fits):
    """A soft stretch gained 1269 in log evidence, the stiff one 784; with the force beside them the
    stiff one gained 613 more.
    """
    force = replace(FORCE, block={"x": 0.001, "z": -0.01})
    at = fit_of(0.0, 2e-3, model_with(SOFT, force))
    soft, pull, stiff = causes_of(SOFT, FORCE, STIFF)
    there = fit_of(-400.0, 1.8e-3, model_with(STIFF))
    found, causes = with_best_in_place(at, [soft, pull], (), [], {soft.label: [(there, stiff)]})
    assert [c.label for c in causes] == [stiff.label, pull.label]
    assert found.posterior.evidence == 600.0
    assert fits == [{"stiff_segment": STIFF.block, "constant_force": force.block}]


def test_what_was_fitted_beside_something_that_is_no_cause_any_more_tells_nothing(fits):
    at = fit_of(0.0, 2e-3, model_with(SOFT))
    soft, stiff = causes_of(SOFT, STIFF)
    there = fit_of(-400.0, 1.8e-3, model_with(FORCE, STIFF))
    assert with_best_in_place(at, [soft], (), [], {soft.label: [(there, stiff)]}) == (at, [soft])
    assert not fits


def test_other_places_are_those_of_the_same_effect():
    soft, pull, stiff = causes_of(SOFT, FORCE, STIFF)
    trials = [(evaluation(9.0 - k, 1e-3), c) for k, c in enumerate((soft, pull, stiff))]
    assert cause_search._elsewhere(trials, trials[0]) == [trials[2]]
    assert cause_search._elsewhere(trials, trials[1]) == []
    tilt = SimpleNamespace(effect="gravity_tilt", label="tilt", start=None)
    assert cause_search._elsewhere([(None, tilt), *trials], (None, tilt)) == []
