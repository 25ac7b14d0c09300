# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""E of a flat section is that of the axis about which it bends more easily."""

import numpy as np
import pytest
from experiment_recordings import recorded
from twins import TWISTED, tree

from dlo_ros.diagnosis.findings.soft_axis import about_other_axis, with_soft_axis
from dlo_ros.effects import Start
from dlo_ros.inference.joint import evaluate
from dlo_ros.inference.measured import measured
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import cause_priors, material_priors

SAME = 1e-4  # [m] by which softer EA stretches the rope
FLAT = {"anisotropy": {"ratio": 0.4, "angle": 0.6}}
"""Seen from its other axis."""


@pytest.fixture(scope="module")
def flat():
    """A recording of a flat rope that moves in space, and the rope."""
    made = tree(TWISTED, FLAT, 0.4) | {"camera": {"rate": 25.0}}
    recording, _, truth = recorded(made, 3, step=4e-3)
    return measured(recording, truth), truth


@pytest.mark.parametrize("twist", [None, 0.7])
def test_both_forms_are_the_same_rod(flat, twist):
    recording, truth = flat
    given = FLAT if twist is None else FLAT | {"twisting_stiffness": {"ratio": twist}}
    before = truth.with_effects(given)
    after = about_other_axis(before)
    assert after.rod.young_modulus == pytest.approx(0.4 * truth.rod.young_modulus)
    assert after.effects["anisotropy"]["ratio"] == pytest.approx(2.5)
    assert after.effects["anisotropy"]["angle"] == pytest.approx(0.6 - np.pi / 2.0)
    assert after.effects["twisting_stiffness"]["ratio"] == pytest.approx((twist or 1.0) / 0.4)
    here, there = (
        evaluate(ParametricModel(s, material_priors(s)), [recording]).predicted[0]
        for s in (before, after)
    )
    np.testing.assert_allclose(here[..., :3], there[..., :3], atol=SAME)
    again = about_other_axis(after)
    assert again.rod.young_modulus == pytest.approx(truth.rod.young_modulus)
    assert again.effects["anisotropy"]["angle"] == pytest.approx(0.6)


def test_a_fit_is_told_about_the_soft_axis(flat):
    recording, truth = flat
    start = Start("anisotropy", FLAT["anisotropy"], ("ratio",), ("ratio", "angle"))
    model = ParametricModel(truth, material_priors(truth))
    model = model.extended("anisotropy", FLAT["anisotropy"], cause_priors(truth, start)[0])
    at = evaluate(model, [recording])
    round_ = truth.with_effects({})
    told = with_soft_axis(at, [recording], round_)
    assert told.model.names == at.model.names
    assert told.model.settings.effects["anisotropy"]["ratio"] == pytest.approx(2.5)
    assert told.mean_err == pytest.approx(at.mean_err, abs=SAME)
    # Both forms know the bending stiffness about the soft axis equally well.
    hard = at.model.axis("young_modulus") + at.model.axis("effects.anisotropy.ratio")
    soft = told.model.axis("young_modulus")
    known = [float(x @ e.posterior.covariance @ x) for x, e in ((hard, at), (soft, told))]
    assert known[1] == pytest.approx(known[0], rel=0.3)
    assert with_soft_axis(told, [recording], round_) is told
    assert with_soft_axis(at, [recording], truth.with_effects(FLAT)) is at
