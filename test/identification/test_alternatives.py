# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A DLO that creeps, and one that is damped more than guessed, in `identify`."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import moving, true_modulus
from rods import PAPER

from dlo_ros.cli.identify_results import remarks, summary, tree
from dlo_ros.effects import Start
from dlo_ros.identification.offline import alternatives as module
from dlo_ros.identification.offline.recording_identification import identify

CREEP = {"share": 0.7, "time": 0.3}


def test_a_creep_that_looks_like_damping_is_told_and_its_modulus_lies_within_the_std():
    recording, given = moving("simple", {"viscoelasticity": CREEP}, 12)
    found = identify([recording], given)
    estimate, modulus = found.estimate, true_modulus("simple")
    assert estimate.specific_modulus < 0.4 * modulus  # that of slow motion
    (other,) = found.fitted.alternatives
    assert other.effect == "viscoelasticity"
    assert other.specific_modulus == pytest.approx(modulus, rel=0.25)
    std = estimate.specific_modulus_std
    relative = np.inf if std is None else std / estimate.specific_modulus
    assert relative > np.log(modulus / estimate.specific_modulus) / 2.0
    assert not estimate.identifiable["specific_modulus"]
    assert "(not determined by the recordings)" in summary(found)[2]
    for lines in (summary(found), remarks(found)):
        assert any("part of the DLO's stiffness gives way with time (share" in s for s in lines)
    assert tree(found)["alternatives"][0]["effect"] == "viscoelasticity"
    # One with which E/mu is the same, to 2 %, is no news.
    alike = replace(other, specific_modulus=1.02 * estimate.specific_modulus)
    quiet = replace(found, fitted=replace(found.fitted, alternatives=(alike,)))
    assert not any("gives way" in s for s in summary(quiet))


@pytest.mark.slow
def test_a_damping_that_is_larger_than_guessed_is_no_creep():
    recording, given = moving("simple", {"internal_damping": {"relaxation_time": 0.05}}, 12)
    found = identify([recording], replace(given, rod=replace(given.rod, density_std=1.0)))
    assert found.fitted.alternatives == ()
    assert tree(found)["alternatives"] == []
    damped = found.estimate.settings.damping.relaxation_time
    assert damped == pytest.approx(given.damping.relaxation_time + 0.05, rel=0.05)
    estimate = found.estimate
    off = estimate.specific_modulus - true_modulus("simple")
    assert estimate.specific_modulus_std < 0.1 * estimate.specific_modulus
    assert abs(off) < 3.0 * estimate.specific_modulus_std


@pytest.mark.parametrize(("moment", "found"), [(0.0, ()), (1e-4, ("hysteresis",))])
def test_an_effect_that_a_fit_takes_back_to_nothing_is_no_alternative(monkeypatch, moment, found):
    """Better is then the plain DLO elsewhere, and no friction is told of."""

    def fitted(settings, evidence):
        model = SimpleNamespace(settings=settings)
        return SimpleNamespace(model=model, posterior=SimpleNamespace(evidence=evidence))

    plain = PAPER
    rubs = plain.with_effects({"hysteresis": {"moment": moment, "curvature": 12.0}})
    start = Start("hysteresis", rubs.effects["hysteresis"], (), ("moment",))
    monkeypatch.setattr(module, "scene_of", lambda *_: None)
    monkeypatch.setattr(module, "starts", lambda _: [start])
    monkeypatch.setattr(module, "instead_of_plain", lambda *_: [(start, None)])
    monkeypatch.setattr(module, "evaluate", lambda *_: None)
    monkeypatch.setattr(module, "fit", lambda *_, **__: fitted(rubs, 100.0))
    others = module.alternatives(fitted(plain, 0.0), [])
    assert tuple(a.effect for a in others) == found
