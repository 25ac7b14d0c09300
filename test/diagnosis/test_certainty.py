# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Numbers of the set-up that may be causes: far beyond their tolerance, or for certain."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import moving
from rods import PAPER

from dlo_ros.diagnosis.explain import certainty
from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.explain.certainty import (
    SCALES,
    beyond,
    certain,
    departures,
    has_other_stiffness,
    tolerances_off,
)
from dlo_ros.diagnosis.explain.explanation import Explanation, still_certain
from dlo_ros.diagnosis.explain.trials import fitted as fitted_model
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.diagnosis.proposals.linear_evidence import freed, proposal_of, with_proposals
from dlo_ros.effects import Start, starts
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference.joint import evaluate
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors
from dlo_ros.inference.thresholds import BEYOND

PEG = {"x": 0.1, "z": -0.1, "radius": 0.01}
TOLERANCE = np.radians(3.0)  # of a clamp's direction


def fitted(angle, seed):
    """The set-up prepared and fitted, of a recording with a clamp turned by an angle [rad]."""
    recording, given = moving("simple", {"clamp_angle": {"start": angle}}, seed)
    begun = begin([recording], given)
    return training_set(begun, 1, begun.at.model.settings, given).prepared


@pytest.fixture(scope="module")
def prepared():
    return fitted(1.5 * TOLERANCE, 21)


@pytest.fixture(scope="module")
def turned(prepared):
    return prepared.setup


def named(at):
    return {g.effect for g in beyond(at)}


def off(at, effect):
    (group,) = (g for g in freed(at.model) if g.effect == effect)
    return tolerances_off(at, group)


@pytest.mark.slow
def test_what_is_known_well_may_be_a_cause_less_than_twice_its_tolerance_off(turned):
    assert 1.3 < off(turned, "clamp_angle") < BEYOND
    assert "clamp_angle" in named(turned)


@pytest.mark.slow
def test_within_its_tolerance_it_is_none():
    at = fitted(0.7 * TOLERANCE, 22).setup
    assert 0.5 < off(at, "clamp_angle") < 1.0
    assert "clamp_angle" not in named(at)


@pytest.mark.slow
def test_a_number_that_is_freed_is_as_far_off_as_one_within_its_tolerance(turned):
    """One and a half tolerances: a clamp that was freed as a cause counts as a departure still."""
    (clamp,) = (g for g in freed(turned.model) if g.effect == "clamp_angle")
    opened = replace(turned, model=turned.model.with_prior(clamp.parameters))
    counts = departures(turned), departures(opened, (clamp,))
    assert counts[0] == counts[1] > 0


def test_what_is_known_badly_may_be_none_of_less_than_twice(turned):
    wide = replace(turned.posterior, covariance=1e6 * turned.posterior.covariance)
    assert "clamp_angle" not in named(replace(turned, posterior=wide))


@pytest.mark.parametrize(("stds", "certain"), [(5.0, False), (7.0, True)])
def test_it_may_be_one_as_little_beyond_as_it_is_known_well(turned, stds, certain):
    """Other laws than the true ones shift a number by up to five times its std."""
    k = turned.model.index("effects.clamp_angle.start")
    theta = turned.model.theta()
    theta[k] = np.sign(theta[k]) * 1.1 * TOLERANCE
    scale = 0.1 * TOLERANCE / stds / np.sqrt(turned.posterior.covariance[k, k])
    known = replace(turned.posterior, covariance=scale**2 * turned.posterior.covariance)
    at = replace(turned, model=turned.model.at(theta), posterior=known)
    assert ("clamp_angle" in named(at)) == certain


@pytest.mark.parametrize(
    ("shift", "certain"),
    [(-1.5, True), (-1.15, False), (1.5, False), (-0.8, False), (-2.5, True), (2.5, True)],
)
def test_a_damping_of_more_than_three_times_its_guess_may_be_a_cause(turned, shift, certain):
    """One of less than a third may as well be a guess that was too high, up to a ninth; a little
    more than three times is what another law may make of it.
    """
    off_guess = tuple(
        replace(p, centre=x + shift * p.std) if p.guessed and not p.effect else p
        for p, x in zip(turned.model.parameters, turned.model.theta(), strict=True)
    )
    known = replace(turned.posterior, covariance=1e-6 * turned.posterior.covariance)
    model = turned.model.with_prior(off_guess)
    dampings = {"air_drag", "internal_damping"}
    assert (dampings & named(replace(turned, model=model, posterior=known))) == (
        dampings if certain else set()
    )
    wide = replace(turned.posterior, covariance=1e6 * turned.posterior.covariance)
    if abs(shift) < BEYOND:
        assert not dampings & named(replace(turned, model=model, posterior=wide))


def test_an_added_cause_that_the_final_fit_denies_is_none(prepared):
    start = next(s for s in starts(prepared.scene) if s.effect == "quadratic_drag")
    proposal = proposal_of(prepared.setup.model.settings, start)
    model, _ = with_proposals(prepared.setup.model, [proposal])
    final = fitted_model(model, prepared.recordings)
    names = tuple(p.name for p in proposal.parameters)
    causes = (
        Cause("quadratic_drag", names, {}, 20.0, 1.5 * final.mean_err, final.mean_err),
        Cause("clamp_angle", ("effects.clamp_angle.start",), {}, 9.0, 0.1, 0.09),
    )
    found = Explanation(prepared.setup, final, causes, 1e-4, 1e-3, 1e-4, (proposal,), ())
    spread = final.posterior.covariance
    kept = still_certain(found, final, spread)
    assert [c.effect for c in kept.causes] == ["clamp_angle"]
    assert kept.uncertain == tuple(c for c in found.causes if c.effect != "clamp_angle") != ()
    # Of a cause that takes most of ERR away, the numbers alone are denied: a grip slips by another
    # length in each recording.
    most = replace(found, causes=(replace(causes[0], err=3.0 * final.mean_err), causes[1]))
    assert still_certain(most, final, spread) == most
    theta = final.model.theta()
    k = final.model.index(names[0])
    theta[k] += 5.0 * np.sqrt(final.posterior.covariance[k, k])
    assert still_certain(found, replace(final, model=final.model.at(theta)), spread) == found


def test_a_set_up_is_no_cause_whose_reported_uncertainty_leaves_it_within_its_tolerance(turned):
    cause = Cause("clamp_angle", ("effects.clamp_angle.start",), {}, 9.0, 0.1, 0.09)
    found = Explanation(turned, turned, (cause,), 1e-4, 1e-3, 1e-4, (), ())
    spread = turned.posterior.covariance
    assert still_certain(found, turned, spread) == found
    k = turned.model.index("effects.clamp_angle.start")
    wide = spread * (0.35 * TOLERANCE) ** 2 / spread[k, k]
    assert still_certain(found, turned, wide).causes == ()
    # No better is what is known for a given E alone.
    e = turned.model.index("young_modulus")
    doubt = np.zeros(len(spread))
    doubt[[k, e]] = turned.model.offset()[k] / 2.0, 1.0
    tied = spread + np.outer(doubt, doubt)
    assert certain(turned, next(iter(beyond(turned))), SCALES, tied)
    assert still_certain(found, turned, tied).causes == ()


def beside_set_up(prepared, start):
    """An effect beside the set-up, simulated where it begins, and its proposal."""
    model, _ = with_proposals(
        prepared.setup.model, [proposal := proposal_of(prepared.setup.model.settings, start)]
    )
    return evaluate(model, prepared.recordings), proposal


def test_a_plug_is_none_of_which_neither_mass_nor_length_is_known(prepared):
    """It begins at a finite length, where no derivative tells of it."""
    keys = ("mass", "extent")
    plug = Start("connector", {"mass": 1e-3, "extent": 0.02}, (), keys, neutral=False)
    at, proposal = beside_set_up(prepared, plug)
    mass, extent = (at.model.index(f"effects.connector.{key}") for key in keys)
    size = abs(at.model.theta()[mass] - at.model.parameters[mass].inner(0.0))
    log = at.model.parameters[extent].logarithmic
    length = 1.0 if log else at.model.settings.effects["connector"]["extent"]
    for of_mass, of_extent, shown in ((1.0, 0.7, False), (0.1, 0.7, True), (1.0, 0.1, True)):
        spread = at.posterior.covariance.copy()
        for k, std in ((mass, of_mass * size), (extent, of_extent * length)):
            spread[k] = spread[:, k] = 0.0
            spread[k, k] = max(std, 1e-12) ** 2
        assert certain(at, proposal, (), spread) == shown
    hit = proposal_of(PAPER, Start("obstacle", PEG, (), tuple(PEG), neutral=False))
    assert certainty._numbers(hit) == []


def test_a_size_without_a_neutral_value_must_be_known_to_a_factor(prepared):
    first = next(s for s in starts(prepared.scene) if s.effect == "nonlinear_stiffness")
    model, _ = with_proposals(
        prepared.setup.model, [proposal := proposal_of(prepared.setup.model.settings, first)]
    )
    at = fitted_model(model, prepared.recordings)
    k = at.model.index("effects.nonlinear_stiffness.half_curvature")
    spread = at.posterior.covariance
    for std, shown in ((0.1, True), (0.5, False)):
        assert certain(at, proposal, (), spread * std**2 / spread[k, k]) == shown


def test_another_stiffness_is_told_by_what_is_known_of_the_ratio_alone():
    """E and mu are known to 50 %, E / mu to 5 %."""
    model = ParametricModel(PAPER, material_priors(PAPER)[:2])
    assert model.names == ("young_modulus", "density")
    covariance = np.full((2, 2), 0.25) + np.diag([0.05**2, 0.0])
    at = SimpleNamespace(model=model, posterior=SimpleNamespace(covariance=covariance))
    stiffer = model.at(model.theta() + np.array([0.12, 0.0]))
    assert has_other_stiffness(stiffer, at, 2.0)
    assert not has_other_stiffness(stiffer, at, 3.0)
    assert not has_other_stiffness(model.at(model.theta() + 0.5), at, 1.0)


@pytest.mark.parametrize(("disagreement", "certain"), [(0.0, True), (0.05, False)])
def test_recordings_that_disagree_about_the_stiffness_leave_another_one_possible(
    monkeypatch, disagreement, certain
):
    """E / mu is known to 4 %, and 20 % off, unless the recordings disagree by 5 %."""
    model = ParametricModel(PAPER, material_priors(PAPER)[:2])
    wide = np.full((2, 2), 0.25) + np.diag([0.04**2 + disagreement**2, 0.0])
    monkeypatch.setattr(certainty, "widened_covariance", lambda *_: wide)
    at = SimpleNamespace(model=model, spectra=(), variances=())
    stiffer = model.at(model.theta() + np.array([0.18, 0.0]))
    assert certainty.has_certainly_other_stiffness(stiffer, at) == certain


def test_no_friction_is_certain_because_of_the_curvature_within_which_it_would_turn(prepared):
    keys = ("moment", "curvature")
    rubs = Start("hysteresis", {"moment": 1e-3, "curvature": 8.0}, (), keys, neutral=False)
    at, proposal = beside_set_up(prepared, rubs)
    moment, curvature = (at.model.index(f"effects.hysteresis.{key}") for key in keys)
    size = abs(at.model.theta()[moment] - at.model.parameters[moment].inner(0.0))

    def shown(of_moment, correlation=0.0):
        spread = at.posterior.covariance.copy()
        for k in (moment, curvature):
            spread[k, :] = spread[:, k] = 0.0
        spread[moment, moment], spread[curvature, curvature] = (of_moment * size) ** 2, 0.01**2
        spread[moment, curvature] = spread[curvature, moment] = (
            correlation * of_moment * size * 0.01
        )
        return certain(at, proposal, covariance=spread)

    assert not shown(0.7)
    assert shown(0.1)
    assert shown(0.7, correlation=0.99)  # their ratio is known: it stiffens small bends
