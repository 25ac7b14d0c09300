# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A DLO that creeps, which a fit takes for a much softer one that is damped strongly."""

import numpy as np
import pytest
from experiment_recordings import moving, true_modulus

from dlo_ros.diagnosis.explain.candidate_trials import begun_instead
from dlo_ros.diagnosis.explain.cause_search import without
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.effects import PlainRod, effects, starts
from dlo_ros.identification.offline.initial_fit import begin

CREEP = {"share": 0.7, "time": 0.3}


def prepared(creep):
    """A recording of the discrete rod with the set-up fitted, and the true E / mu."""
    recording, given = moving("simple", {"viscoelasticity": creep}, 12)
    begun = begin([recording], given)
    found = training_set(begun, 1, begun.at.model.settings, given).prepared
    return found, true_modulus("simple")


@pytest.fixture(scope="module")
def creeping():
    return prepared(CREEP)


def test_creep_is_found_where_the_fit_had_taken_it_for_damping(creeping):
    found, modulus = creeping
    soft = found.setup.model.settings
    assert soft.rod.specific_modulus < 0.4 * modulus
    assert soft.damping.relaxation_time > 0.1
    trials = begun_instead(found.setup, found.recordings, starts(found.scene))
    assert [proposal.effect for _, proposal in trials] == ["viscoelasticity"]
    at, proposal = trials[0]
    assert at.posterior.evidence > found.setup.posterior.evidence + 100.0
    settings = at.model.settings
    creep = settings.effects["viscoelasticity"]
    assert settings.rod.specific_modulus == pytest.approx(modulus, rel=0.1)  # it has only begun
    assert creep["share"] == pytest.approx(CREEP["share"], abs=0.03)
    assert creep["time"] == pytest.approx(CREEP["time"], rel=0.2)
    # Without the creep it is the softer DLO again.
    bare = without(at, proposal, found.recordings)
    assert bare.posterior.evidence == pytest.approx(found.setup.posterior.evidence, abs=3.0)


def test_no_creep_is_fitted_where_the_model_has_one_or_the_damping_is_as_guessed(creeping):
    found, _ = creeping
    begun = starts(found.scene)
    ((at, _),) = begun_instead(found.setup, found.recordings, begun)
    assert begun_instead(at, found.recordings, begun) == []
    others = [s for s in begun if s.effect != "viscoelasticity"]
    assert begun_instead(found.setup, found.recordings, others) == []
    elastic, _ = prepared({"share": 0.0, "time": 1.0})
    assert begun_instead(elastic.setup, elastic.recordings, starts(elastic.scene)) == []


@pytest.mark.parametrize("name", sorted(effects()))
def test_what_stands_for_a_plain_rod_is_taken_for_it(name):
    effect = effects()[name]
    fitted, guessed = PlainRod(2e6, 0.4), PlainRod(9e6, 0.01)
    instead = effect.instead_of(fitted, guessed)
    if instead is None:
        assert name != "viscoelasticity"
        return
    other, beside = instead
    assert np.allclose(other.taken_for(beside), fitted)
    assert effect.instead_of(guessed._replace(relaxation_time=1e-3), guessed) is None
