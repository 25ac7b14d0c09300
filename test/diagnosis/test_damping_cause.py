# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Damping that the parameter file only guesses is a cause where it is far off."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import moving
from rods import PAPER

from dlo_ros.diagnosis.explain import cause_naming, cause_search
from dlo_ros.diagnosis.explain.joint_explanation import explain
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.diagnosis.findings.joint_numbers import damping_as_effects, effect_numbers
from dlo_ros.diagnosis.proposals.linear_evidence import freed
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference import joint_fit
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors


def told(settings):
    """Effects as which damping may be told."""
    return {p.effect for p in freed(ParametricModel(settings, material_priors(settings)))}


def test_only_guessed_damping_may_be_off():
    assert told(PAPER) == {"air_drag", "internal_damping"}
    damping = PAPER.damping
    known = replace(damping, relaxation_time_std=0.1 * damping.relaxation_time)
    assert told(replace(PAPER, damping=known)) == {"air_drag"}
    assert told(replace(PAPER, damping=replace(damping, air_drag=0.0))) == {"internal_damping"}


def test_told_as_an_effect_it_is_the_same_damping():
    found = replace(PAPER, damping=replace(PAPER.damping, relaxation_time=0.3, air_drag=0.5))
    shown = damping_as_effects(found, PAPER, ["internal_damping"])
    added = shown.effects["internal_damping"]["relaxation_time"]
    assert shown.damping.relaxation_time == PAPER.damping.relaxation_time
    assert shown.damping.relaxation_time + added == pytest.approx(0.3, rel=1e-12)
    assert shown.damping.air_drag == 0.5 and set(shown.effects) == {"internal_damping"}
    assert damping_as_effects(found, PAPER, []) == found


@pytest.mark.slow
def test_damping_far_off_the_file_is_a_cause():
    hidden = {"internal_damping": {"relaxation_time": 0.25}, "clamp_angle": {"start": 0.02}}
    recording, given = moving("simple", hidden, 11)
    begun = begin([recording], given)
    prepared = training_set(begun, 1, begun.at.model.settings, given)
    assert prepared is not None
    found = explain(prepared.prepared, given).with_names()
    assert "internal_damping" in {c.effect for c in found.causes}
    number = effect_numbers("internal_damping", found.at, given)["relaxation_time"]
    assert number.unit == "s" and isinstance(number.std, float)
    assert abs(number.value - 0.25) < max(0.1 * 0.25, 2.0 * number.std)
    assert np.isfinite(found.at.mean_err) and found.at.mean_err < 2.0 * found.own_err


def test_a_damping_that_has_its_guess_again_is_left_out_once(monkeypatch):
    """It may be a cause as well; without its number there is nothing left to try."""
    cause = SimpleNamespace(
        effect="internal_damping", label="internal_damping", start=None, parameters=()
    )
    guess = SimpleNamespace(
        effect="internal_damping", label="internal_damping", start=None, parameters=()
    )
    softer = PAPER.with_material(2e6, PAPER.rod.density)
    at, bare = (
        SimpleNamespace(
            posterior=SimpleNamespace(evidence=evidence), mean_err=err, err=[np.full(9, err)],
            model=ParametricModel(settings, material_priors(settings)),
        )
        for evidence, err, settings in ((100.0, 1e-3, PAPER), (60.0, 1.05e-3, softer))
    )  # fmt: skip
    tried = []

    def without(_, group, __, wholly):
        tried.append((group, wholly))
        return bare

    monkeypatch.setattr(cause_naming, "without", without)
    monkeypatch.setattr(joint_fit, "approached", lambda at, *_: at)
    monkeypatch.setattr(cause_naming, "_guessed_dampings", lambda _: [guess])
    cause.other = "equal to nothing else"  # a cause is freed from a tolerance, a guess again
    search = cause_search.Search(at, (cause,), (), None)
    found, _, shifts = cause_naming.without_needless(search, (), [], 0.0, complete=False)
    assert tried == [(guess, True)] and not found.causes
    change = np.log(2e6 / PAPER.rod.young_modulus)
    assert shifts["internal_damping"]["young_modulus"] == pytest.approx(change)
