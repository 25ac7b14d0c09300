# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Causes beside a set-up that is as precise as the data tell, and where none is told to be."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis.explain import exact_setup
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.exact_setup import SHARED, beside_exact_set_up, exact, opened
from dlo_ros.diagnosis.explain.joint_explanation import explain
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.diagnosis.proposals.linear_evidence import freed
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference.parameter import SLAB
from dlo_ros.inference.thresholds import WORTH

TURN = np.radians(1.5)  # half of the tolerance of a clamp


def prepared(effects, seed):
    recording, given = moving("simple", effects, seed)
    begun = begin([recording], given)
    return training_set(begun, 1, begun.at.model.settings, given).prepared, given


@pytest.fixture(scope="module")
def turned():
    """One recording with a clamp that is turned by no more than the tolerance of a set-up."""
    return prepared({"clamp_angle": {"start": TURN}}, 31)


@pytest.mark.slow
def test_a_part_of_an_exact_set_up_stays_at_neutral_and_can_be_a_cause_all_the_same(turned):
    model = turned[0].setup.model
    here = exact(model, turned[0].recordings)
    for before, p, x in zip(model.parameters, here.parameters, here.theta(), strict=True):
        if before.tolerated:
            assert x == p.centre
            assert p.std < (0.1 if "camera" in p.name else 1e-3) * before.std
            assert p.step == pytest.approx(before.step)
        else:
            assert p == before
    for wide, cause in zip(freed(model), freed(here), strict=True):
        stds = [p.std for p in wide.parameters]
        assert [p.std for p in cause.parameters] == pytest.approx(stds)
        for before, p in zip(wide.columns, cause.parameters, strict=True):
            back = p.returned(SLAB)
            assert back.std == pytest.approx(here.parameters[here.index(before)].std)


def test_measured_points_tell_of_a_camera_no_more_than_what_shifts_them_all(turned):
    model, std = turned[0].setup.model, 1e-4
    points = SimpleNamespace(points=SimpleNamespace(std=np.full(50, std)))
    seen = SimpleNamespace(manipulation=SimpleNamespace(observations=[points]))
    here, none = exact(model, [seen]), exact(model)
    length = model.settings.rod.length
    for effect, expected in (
        ("camera_shift.x", SHARED * std), ("camera_scale.ratio", SHARED * std / length)
    ):  # fmt: skip
        name = f"effects.{effect}"
        assert here.parameters[here.index(name)].std == pytest.approx(expected)
        assert none.parameters[none.index(name)].std < 0.1 * expected
    for name in ("effects.clamp_angle.start", "effects.command_delay.delay"):
        assert here.parameters[here.index(name)] == none.parameters[none.index(name)]


@pytest.mark.parametrize(("stds", "held"), [(2.0, False), (4.0, True)])
def test_a_camera_that_is_farther_off_is_held_so_that_it_may_be_a_cause(
    turned, monkeypatch, stds, held
):
    model, recordings = turned[0].setup.model, turned[0].recordings
    name = "effects.camera_shift.x"

    def fitted(at, _):
        k = at.model.index(name)
        theta = at.model.theta()
        theta[k] += stds * at.model.parameters[k].std
        return SimpleNamespace(model=at.model.at(theta))

    monkeypatch.setattr(exact_setup, "evaluate", lambda model, _: SimpleNamespace(model=model))
    monkeypatch.setattr(exact_setup, "settled", fitted)
    found = exact_setup._fitted(model, recordings).model
    tight = exact(model) if held else exact(model, recordings)
    assert found.parameters == tight.parameters


def test_an_opened_set_up_has_its_tolerances_again(turned):
    at = turned[0].setup
    again = opened(replace(at, model=exact(at.model, turned[0].recordings).at(at.model.theta())))
    assert again.model.precision() == pytest.approx(at.model.precision())
    assert again.posterior.covariance == pytest.approx(at.posterior.covariance, rel=1e-3)


@pytest.mark.slow
def test_what_is_alone_off_is_named_although_it_is_within_its_tolerance(turned):
    """A set-up within tolerance explains it as well, by many numbers."""
    found = explain(*turned).with_names()
    assert found.setup.mean_err < found.material_err
    assert found.exact
    assert [c.effect for c in found.causes] == ["clamp_angle"]
    turned_by = found.at.model.settings.effects["clamp_angle"]["start"]
    assert turned_by == pytest.approx(TURN, rel=0.2)


def test_nothing_is_named_where_nothing_is_off():
    found = explain(*prepared({}, 32)).with_names()
    assert found.causes == ()


@pytest.mark.slow
def test_a_set_up_that_is_off_in_many_ways_is_not_exact():
    off = {
        "gravity_tilt": {"angle": 0.01}, "camera_rotation": {"angle": 5e-3},
        "clamp_angle": {"start": 0.03}, "command_delay": {"delay": 0.015},
        "intrinsic_curvature": {"curvature": 0.4}, "length_error": {"difference": 2e-3},
    }  # fmt: skip
    found = explain(*prepared(off, 33)).with_names()
    assert not found.exact


def test_no_set_up_is_told_to_be_exact_by_a_measurement_that_errs_in_other_ways(
    turned, monkeypatch
):
    at = turned[0].setup
    blurred = tuple(replace(v, lasting=9.0 * v.white) for v in at.variances)
    found = Search(replace(at, variances=blurred), (), (), None)
    monkeypatch.setattr(exact_setup, "_fitted", lambda *_: pytest.fail("nothing to fit"))
    assert beside_exact_set_up(found, at.model, (), (), 0.0, None) is None


def test_no_set_up_is_told_to_be_exact_by_single_pictures(turned, monkeypatch):
    at = turned[0].setup
    single = SimpleNamespace(times=np.zeros(1))
    monkeypatch.setattr(exact_setup, "_fitted", lambda *_: pytest.fail("nothing to fit"))
    found = Search(at, (), (), None)
    assert beside_exact_set_up(found, at.model, [single], (), 0.0, None) is None


def test_causes_that_leave_white_noise_alone_are_enough(turned, monkeypatch):
    """They need not be looked for again; but the data must be the more likely for it."""
    at = turned[0].setup
    white = replace(
        at,
        variances=tuple(
            replace(v, nodal=0.0 * v.white, fading=0.0 * v.white, lasting=0.0 * v.white,
                    rough=0.0 * v.white) for v in at.variances
        ),
    )  # fmt: skip
    found = Search(white, (), (), None)
    monkeypatch.setattr(exact_setup, "search", lambda *_: pytest.fail("nothing to look for"))
    for gain in (WORTH + 1.0, WORTH - 1.0):
        evidence = white.posterior.evidence + gain
        there = replace(white, posterior=replace(white.posterior, evidence=evidence))
        monkeypatch.setattr(exact_setup, "_fitted", lambda *_, there=there: there)
        result = beside_exact_set_up(found, at.model, (), (), 0.0, None)
        assert (result is not None) == (gain > WORTH)
        assert result is None or result.at is there
