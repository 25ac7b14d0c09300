# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A DLO that slips in each recording at another moment."""

import numpy as np
import pytest
import yaml
from experiment_recordings import recorded

from dlo_ros.diagnosis.explain import candidate_trials, trials
from dlo_ros.diagnosis.explain.own_moments import (
    for_recordings,
    has_common_moments,
    nearest_moments,
    of_model,
    refined_moments,
    with_own_moments,
)
from dlo_ros.diagnosis.findings.joint_numbers import effect_numbers
from dlo_ros.diagnosis.proposals.linear_evidence import PredictedGain, proposal_of, with_proposals
from dlo_ros.effects import Start
from dlo_ros.inference.forecast import as_started
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.measured import measured
from dlo_ros.inference.parameter import ParametricModel, value_of
from dlo_ros.inference.priors import material_priors
from dlo_ros.synthesis.experiment import find_experiment

LENGTH = 0.02
ONSETS = {"early": 0.2, "late": 0.8}
STEP = 1e-3  # [s]
ONSET, DURATION = "effects.clamp_slip.onset", "effects.clamp_slip.duration"
STARTS = [
    Start("clamp_slip", {"length": 0.0, "onset": onset, "duration": 0.1}, ("length",),
          ("length", "onset", "duration"))
    for onset in (0.3, 0.7, 1.1)
]  # fmt: skip


def slipped(name, onset, seed):
    """A recording of a rope that slips, and the rope without that."""
    tree = yaml.safe_load(find_experiment("simple").read_text())
    slip = {"length": LENGTH, "onset": onset, "duration": 0.2}
    tree["parameters"]["effects"] = {"clamp_slip": slip}
    recording, _, truth = recorded(tree, seed, name, step=1e-3)
    return measured(recording, truth), truth.with_effects({})


@pytest.fixture(scope="module")
def slipping():
    """Recordings of a rope that slips in each at another moment, and the rope without that."""
    rows = [slipped(name, onset, seed) for seed, (name, onset) in enumerate(ONSETS.items())]
    return [recording for recording, _ in rows], rows[0][1]


@pytest.fixture(scope="module")
def at_one_moment(slipping):
    """The cause, and its model with one moment for both recordings, midway."""
    _, settings = slipping
    cause = proposal_of(settings, STARTS[0])
    model = ParametricModel(settings, material_priors(settings))
    model, _ = with_proposals(model, [cause])
    theta = model.theta()
    theta[model.index("effects.clamp_slip.length")] = LENGTH
    theta[model.index(ONSET)] = 0.5
    return cause, model.at(theta)


def test_each_recording_has_numbers_of_its_own(slipping, at_one_moment):
    recordings, _ = slipping
    cause, model = at_one_moment
    assert has_common_moments(cause)
    own = with_own_moments(model, recordings)
    names = {f"{number}@{name}" for number in (ONSET, DURATION) for name in ONSETS}
    assert set(own.names) == set(model.names) - {ONSET, DURATION} | names
    assert not has_common_moments(of_model(cause, own))
    theta = own.theta()
    theta[own.index(f"{ONSET}@late")] = 0.9
    own = own.at(theta)
    assert own.theta() == pytest.approx(theta)
    # Elsewhere the mean counts, in files too; a further recording begins there.
    assert value_of(own.settings, ONSET) == pytest.approx(0.7)
    assert own.settings.flat()[ONSET] == pytest.approx(0.7)
    for recording, onset in zip(recordings, (0.5, 0.9), strict=True):
        settings = as_started(own.settings, recording.manipulation)
        assert value_of(settings, ONSET) == pytest.approx(onset)
    (further,) = [r for r in recordings if r.name == "late"]
    less = with_own_moments(model, [r for r in recordings if r.name == "early"])
    more = for_recordings(less, [*recordings])
    assert more.names == with_own_moments(model, recordings).names
    assert value_of(more.settings, f"{ONSET}@{further.name}") == pytest.approx(0.5)
    assert for_recordings(model, recordings) is model


def test_without_the_effect_no_recording_has_it(slipping, at_one_moment):
    recordings, settings = slipping
    cause, model = at_one_moment
    own = with_own_moments(model, recordings)
    # A cause that was found with one of them takes that of the other along.
    known = of_model(cause, with_own_moments(model, recordings[:1]))
    bare = own.without([p.name for p in known.parameters])
    assert bare.settings.effects == settings.effects == {}
    assert not bare.settings.own
    assert all("clamp_slip" not in name for name in bare.names)


def test_moments_far_from_the_true_ones_are_found_without_derivatives(slipping, at_one_moment):
    recordings, _ = slipping
    own = with_own_moments(at_one_moment[1], recordings)
    found = refined_moments(own, recordings)
    before, after = (simulate(m, recordings, ()).mean_err for m in (own, found))
    assert after < 0.3 * before
    for name, onset in ONSETS.items():
        began, took = (value_of(found.settings, f"{n}@{name}") for n in (ONSET, DURATION))
        assert began + 0.5 * took == pytest.approx(onset + 0.1, abs=0.03)
    # Nothing else is changed.
    same = [k for k, n in enumerate(own.names) if "@" not in n]
    assert found.theta()[same] == pytest.approx(own.theta()[same], rel=0.0, abs=0.0)


def test_a_moment_moves_its_own_recording_alone(slipping, at_one_moment):
    recordings, _ = slipping
    own = with_own_moments(at_one_moment[1], recordings)
    names = (f"{ONSET}@early", f"{ONSET}@late", "young_modulus")
    found = simulate(own, recordings, names)
    for k, recording in enumerate(recordings):
        residual, slopes = found.fields[k]
        moves = np.abs(slopes).max(axis=(0, 2))
        assert moves[1 - k] == 0.0
        assert moves[k] > 1e-3
        theta = own.theta()
        theta[own.index(names[k])] += STEP
        (there, _), *_ = simulate(own.at(theta), [recording], ()).fields
        np.testing.assert_allclose(slopes[:, k], (residual - there) / STEP, atol=0.05 * moves[k])


def test_the_moments_are_found(slipping, at_one_moment):
    recordings, given = slipping
    cause, model = at_one_moment
    begun = nearest_moments(with_own_moments(model, recordings), recordings, STARTS)
    for name, onset in (("early", 0.3), ("late", 0.7)):
        assert value_of(begun.settings, f"{ONSET}@{name}") == onset
    at = trials.fitted(model, recordings)
    offers = [(at, [PredictedGain(proposal_of(given, s), 1.0, model, model) for s in STARTS])]
    found, own = candidate_trials._at_own_moments((at, cause), offers, recordings)
    assert not has_common_moments(own)
    assert found.posterior.evidence > at.posterior.evidence + 100.0
    assert found.mean_err < 0.2 * at.mean_err
    numbers = effect_numbers("clamp_slip", found, given)
    for name, onset in ONSETS.items():
        middle = numbers["onset"].own[name] + 0.5 * numbers["duration"].own[name]
        assert middle == pytest.approx(onset + 0.1, abs=0.02)
    assert numbers["length"].value == pytest.approx(LENGTH, rel=0.1)
    assert numbers["onset"].value == pytest.approx(np.mean(list(numbers["onset"].own.values())))
    assert numbers["onset"].std > 0.2  # as far as they differ
    assert not numbers["length"].own


@pytest.mark.slow
def test_one_moment_stays_where_others_explain_no_more(slipping, at_one_moment):
    recordings, _ = slipping
    cause, model = at_one_moment
    alike = [recordings[0], slipped("again", ONSETS["early"], 5)[0]]
    theta = model.theta()
    theta[model.index(ONSET)] = ONSETS["early"]
    for chosen in (alike, alike[:1]):
        trial = trials.fitted(model.at(theta), chosen), cause
        assert candidate_trials._at_own_moments(trial, [], chosen) is trial
