# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The std of a wall's direction grows where turned walls explain the data as well."""

from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.explain import profile_loss
from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.explain.turned_walls import ANGLE, OFFSET
from dlo_ros.diagnosis.findings import confirmed_uncertainty
from dlo_ros.diagnosis.findings.wall_direction import turned, wall_factors
from dlo_ros.effects.start import Start
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import cause_priors

STD = 0.02
TIP = np.array([0.4, -0.3])  # x, z [m]


def hit(angle=0.2, depth=1e-3):
    """A fit with a wall that the tip presses into by a millimetre."""
    normal = np.array([np.sin(angle), np.cos(angle)])
    block = {"offset": float(TIP @ normal) + depth, "angle": angle}
    settings = PAPER.with_effects({"wall": block})
    fitted, _ = cause_priors(PAPER, Start("wall", block, ("offset", "angle"), ("offset", "angle")))
    count = PAPER.rod.control_points
    shapes = np.zeros((3, count, 4))
    shapes[1, -1, [0, 2]] = TIP
    shapes[..., 2] += np.linspace(0.5, 0.0, count)
    covariance = np.diag([1e-6, STD**2])
    return SimpleNamespace(
        model=ParametricModel(settings, fitted), predicted=(shapes,), err=(np.ones(3),),
        posterior=SimpleNamespace(covariance=covariance),
    )  # fmt: skip


@pytest.mark.parametrize("turn", [-0.3, 0.1])
def test_a_wall_turns_about_the_point_that_is_hit_and_stays_in_that_direction(turn):
    at = hit()
    model = turned(at, turn)
    wall = model.settings.effects["wall"]
    assert wall["angle"] == pytest.approx(0.2 + turn)
    normal = np.array([np.sin(wall["angle"]), np.cos(wall["angle"])])
    assert wall["offset"] - TIP @ normal == pytest.approx(1e-3)
    k = model.index(ANGLE)
    assert model.parameters[k].std < 1e-3 * at.model.parameters[k].std
    assert model.offset()[k] == pytest.approx(0.0, abs=1e-9)
    assert model.parameters[model.index(OFFSET)] == at.model.parameters[at.model.index(OFFSET)]


@pytest.mark.parametrize(
    ("losses", "std"),
    [
        ({0.3: -2.0, -0.3: 40.0, 0.1: 0.0, -0.1: 0.0}, 0.3),  # one side is enough
        ({0.3: 2.0, -0.3: None, 0.1: 0.0, -0.1: 0.0}, 0.15),
        ({0.3: 90.0, -0.3: 70.0, 0.1: 90.0, -0.1: 2.0}, 0.05),
        ({0.3: 900.0, -0.3: 700.0, 0.1: 90.0, -0.1: 90.0}, STD),  # linearly 112 and 12
    ],
)
def test_the_direction_is_known_no_better_than_walls_differ_that_explain_as_much(
    monkeypatch, losses, std
):
    at = hit()

    def fitted(_, model, __):
        turn = round(model.settings.effects["wall"]["angle"] - 0.2, 6)
        return None if losses[turn] is None else SimpleNamespace(loss=losses[turn])

    monkeypatch.setattr(profile_loss, "fitted_beside", fitted)
    monkeypatch.setattr(profile_loss, "misfit", lambda e, _: getattr(e, "loss", 0.0))
    monkeypatch.setattr(profile_loss, "evidence_std", lambda *_: 0.0)
    factors = wall_factors(at, [None])
    assert factors.get(ANGLE, 1.0) * STD == pytest.approx(std)
    assert factors.get(OFFSET) == factors.get(ANGLE)
    assert wall_factors(at, [None, None]) == {}  # not a fit to these recordings


def test_only_a_wall_that_is_named_is_turned(monkeypatch):
    at = hit()
    monkeypatch.setattr(confirmed_uncertainty, "factor_along", lambda *_: 1.5)
    monkeypatch.setattr(confirmed_uncertainty, "wall_factors", lambda *_: {OFFSET: 4.0, ANGLE: 1.2})
    found = confirmed_uncertainty.confirmed
    names = ["young_modulus", "density"]
    at.model = SimpleNamespace(names=(*names, OFFSET, ANGLE), axis=lambda _: np.zeros(4))
    wall = Cause("wall", (OFFSET, ANGLE), {}, 0.0, 1.0, 0.0)
    other = Cause("gravity_tilt", tuple(names), {}, 0.0, 1.0, 0.0)
    assert found(at, [None], [other]).parameters == dict.fromkeys(names, 1.5)
    assert found(at, [None], [wall]).parameters == {OFFSET: 4.0, ANGLE: 1.5}
