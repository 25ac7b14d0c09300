# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pegs of other sizes that touch the DLO in the same point: which one is taken."""

from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.explain import peg_size, profile_loss
from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.explain.peg_size import PEG, RADIUS, best_sized, peg_factors, resized
from dlo_ros.diagnosis.findings import confirmed_uncertainty
from dlo_ros.effects.start import Start
from dlo_ros.inference.parameter import HELD, ParametricModel
from dlo_ros.inference.priors import cause_priors

HIT = np.array([0.2, -0.1])  # x, z [m], in the middle of a straight, hanging DLO
OUTWARDS = np.array([-1.0, 0.0])
BIG = 0.02  # radius [m] of the fit's peg


def hit(evidence=0.0):
    """A fit with a large peg on the right of a DLO that touches it."""
    centre = HIT - BIG * OUTWARDS
    block = {"x": float(centre[0]), "z": float(centre[1]), "radius": BIG}
    settings = PAPER.with_effects({"obstacle": block})
    fitted, _ = cause_priors(PAPER, Start("obstacle", block, (), tuple(block), neutral=False))
    shapes = np.zeros((3, PAPER.rod.control_points, 4))
    shapes[..., 0] = HIT[0]
    shapes[..., 2] = np.linspace(0.0, -PAPER.rod.length, PAPER.rod.control_points)
    return SimpleNamespace(
        model=ParametricModel(settings, fitted), predicted=(shapes,), err=(np.ones(3),),
        posterior=SimpleNamespace(evidence=evidence, covariance=np.diag([1e-8, 1e-8, 1e-4])),
    )  # fmt: skip


def radius(model):
    return model.settings.effects["obstacle"]["radius"]


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (0.25, 0.25 * BIG),
        (2.0, 2.0 * BIG),
        (50.0, 0.3 * PAPER.rod.length),  # at most as large as it is looked for
        (0.01, 0.25 * PAPER.rod.diameter),
    ],
)
def test_a_peg_of_another_size_touches_the_same_point_and_keeps_its_size(size, expected):
    at = hit()
    model = resized(at, size)
    peg = model.settings.effects["obstacle"]
    assert peg["radius"] == pytest.approx(expected)
    surface = np.array([peg["x"], peg["z"]]) + peg["radius"] * OUTWARDS
    assert surface == pytest.approx(HIT, abs=2e-3)  # places along the DLO lie 8 mm apart
    k = model.index(RADIUS)
    assert model.parameters[k].std < 1e-3 * at.model.parameters[k].std


@pytest.mark.parametrize(
    ("best", "largest", "expected"),
    [
        (0.25, np.inf, 0.25),
        (0.37, np.inf, 0.5**1.5),
        (1.0, np.inf, 1.0),
        (2.6, np.inf, 2.0**1.5),
        (2.6, 2.5, 2.0),  # a larger one cannot be simulated
    ],
)
def test_the_size_that_explains_most_is_taken_and_held(monkeypatch, best, largest, expected):
    at = hit(evidence=500.0)  # that of derivatives by the size

    def fitted(_, model, __):
        size = radius(model) / BIG
        if size > largest:
            return None
        evidence = -90.0 * np.log(size / best) ** 2
        return SimpleNamespace(
            model=model, predicted=at.predicted, posterior=SimpleNamespace(evidence=evidence)
        )

    ends = []
    monkeypatch.setattr(peg_size, "fitted_beside", fitted)
    monkeypatch.setattr(peg_size, "fit", lambda begun, *_: ends.append(begun) or begun)
    found = best_sized(at, ())
    assert ends == [found]  # one is fitted to its end
    assert radius(found.model) == pytest.approx(expected * BIG)
    again = resized(SimpleNamespace(model=found.model, predicted=at.predicted), 1.0)
    assert again.parameters[again.index(RADIUS)].std == HELD
    monkeypatch.setattr(peg_size, "fitted_beside", lambda *_: None)
    assert best_sized(at, ()) is at


def test_a_model_without_a_peg_stays_as_it_is():
    at = SimpleNamespace(model=SimpleNamespace(names=("young_modulus",)))
    assert best_sized(at, ()) is at
    assert peg_factors(at, ()) == {}


@pytest.mark.parametrize(
    ("losses", "std"),
    [
        ({0.25: -2.0, 4.0: 90.0, 0.5: 90.0, 2.0: 90.0}, np.log(4.0)),  # one side is enough
        ({0.25: 2.0, 4.0: None, 0.5: 0.0, 2.0: 90.0}, np.log(4.0) / 2.0),
        ({0.25: -90.0, 4.0: 70.0, 0.5: -500.0, 2.0: -40.0}, np.log(2.0)),  # all explain more
        ({0.25: 90.0, 4.0: 90.0, 0.5: 90.0, 2.0: 2.0}, np.log(2.0) / 2.0),
        ({0.25: 90.0, 4.0: 90.0, 0.5: 50.0, 2.0: 8.0}, np.log(2.0) / 4.0),
    ],
)
def test_a_size_is_known_no_better_than_pegs_differ_that_explain_as_much(monkeypatch, losses, std):
    at = hit()

    def fitted(_, model, __):
        loss = losses[round(radius(model) / BIG, 6)]
        return None if loss is None else SimpleNamespace(loss=loss)

    monkeypatch.setattr(profile_loss, "fitted_beside", fitted)
    monkeypatch.setattr(profile_loss, "misfit", lambda e, _: getattr(e, "loss", 0.0))
    monkeypatch.setattr(profile_loss, "evidence_std", lambda *_: 0.0)
    factors = peg_factors(at, [None])
    assert factors[RADIUS] * 0.01 == pytest.approx(std)
    # Its place changes with it, towards the DLO and away from it.
    assert factors["effects.obstacle.x"] > factors["effects.obstacle.z"]
    assert peg_factors(at, [None, None]) == {}  # not a fit to these recordings


def test_the_largest_peg_is_known_no_better_than_smaller_ones_tell(monkeypatch):
    """One as large as any that is looked for, beside which a larger one would be itself."""
    at = hit()
    at.model = resized(at, 50.0)
    largest = 0.3 * PAPER.rod.length
    losses = {0.25: 90.0, 0.5: 8.0}

    def fitted(_, model, __):
        return SimpleNamespace(loss=losses[round(radius(model) / largest, 6)])

    monkeypatch.setattr(profile_loss, "fitted_beside", fitted)
    monkeypatch.setattr(profile_loss, "misfit", lambda e, _: getattr(e, "loss", 0.0))
    monkeypatch.setattr(profile_loss, "evidence_std", lambda *_: 0.0)
    assert peg_factors(at, [None])[RADIUS] * 0.01 == pytest.approx(np.log(2.0) / 4.0)


def test_only_a_peg_that_is_named_is_resized(monkeypatch):
    at = hit()
    monkeypatch.setattr(confirmed_uncertainty, "factor_along", lambda *_: 1.5)
    monkeypatch.setattr(confirmed_uncertainty, "peg_factors", lambda *_: dict.fromkeys(PEG, 4.0))
    names = ["young_modulus", "density"]
    at.model = SimpleNamespace(names=(*names, *PEG), axis=lambda _: np.zeros(5))
    found = confirmed_uncertainty.confirmed
    other = Cause("gravity_tilt", tuple(names), {}, 0.0, 1.0, 0.0)
    assert found(at, [None], [other]).parameters == dict.fromkeys(names, 1.5)
    assert found(
        at, [None], [Cause("obstacle", PEG, {}, 0.0, 1.0, 0.0)]
    ).parameters == dict.fromkeys(PEG, 4.0)
