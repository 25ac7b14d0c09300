# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Standard deviations grow where simulations do not bear the derivatives out."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up

from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.findings.confirmed_uncertainty import confirmed
from dlo_ros.diagnosis.findings.joint_numbers import fitted_material, outer_stds
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import judged

ANGLE = "effects.clamp_angle.start"
TOO_STEEP = 50.0
NOT_MISSED = 1e-12


@pytest.fixture(scope="module")
def fitted():
    return fitted_set_up()


def with_steep(at, name):
    """The fit with derivatives by a parameter that no simulation bears out."""
    k = at.model.index(name)
    fields = []
    for residual, jacobian in at.fields:
        steep = jacobian.copy()
        steep[:, k] *= TOO_STEEP
        fields.append((residual, steep))
    return judged(replace(at, fields=tuple(fields)), at.variances)


def caused_by(*names, evidence=NOT_MISSED):
    """A cause with some parameters."""
    return [Cause("clamp_angle", names, {}, evidence, 1.0, 0.0)]


def test_what_simulations_bear_out_stays(fitted):
    found = confirmed(*fitted, caused_by("young_modulus", ANGLE, "effects.not_there.size"))
    assert set(found.parameters) == {"young_modulus", ANGLE}
    assert max(*found.parameters.values(), found.material) < 2.0


def test_a_std_from_derivatives_that_are_too_steep_grows(fitted):
    at, recordings = fitted
    k = at.model.index(ANGLE)
    steep = with_steep(at, ANGLE)
    before, claimed = outer_stds(at)[k], outer_stds(steep)[k]
    assert claimed < 0.1 * before
    factor = confirmed(steep, recordings, caused_by(ANGLE)).parameters[ANGLE]
    assert 0.5 * before < factor * claimed < 2.0 * before


def test_what_is_missed_is_known_well_enough_for_that(fitted):
    """Without a cause as many std off as it is, half their square is lost."""
    at, recordings = fitted
    steep = with_steep(at, ANGLE)
    k = at.model.index(ANGLE)
    stds = abs(steep.model.offset()[k]) / np.sqrt(steep.posterior.covariance[k, k])
    causes = caused_by(ANGLE, evidence=0.5 * (stds / 3.0) ** 2)
    assert confirmed(steep, recordings, causes).parameters[ANGLE] == pytest.approx(3.0)
    certain = caused_by(ANGLE, evidence=0.5 * (2.0 * stds) ** 2)
    assert confirmed(steep, recordings, certain).parameters[ANGLE] == 1.0


def test_a_fit_to_other_recordings_confirms_nothing(fitted):
    at, recordings = fitted
    found = confirmed(at, [*recordings, *recordings], caused_by(ANGLE))
    assert found.parameters == {} and found.material == 1.0


def test_the_material_takes_its_factor(fitted):
    at, _ = fitted
    narrow, wide = (fitted_material(at, None, None, factor) for factor in (1.0, 30.0))
    assert wide.specific_modulus[1] > 2.0 * narrow.specific_modulus[1]
    assert wide.specific_modulus[0] == narrow.specific_modulus[0]
    doubtful = fitted_material(at, None, None, doubts=[{"young_modulus": 0.5}])
    value, std = doubtful.specific_modulus
    assert std == pytest.approx(value * np.hypot(0.5, narrow.specific_modulus[1] / value))


def test_what_cannot_be_simulated_confirms_nothing(fitted, monkeypatch):
    at, recordings = fitted

    def fails(*_):
        raise SimulationError("no shape")

    monkeypatch.setattr("dlo_ros.diagnosis.findings.confirmed_uncertainty.borrowed", fails)
    assert confirmed(at, recordings, caused_by(ANGLE)).parameters == {ANGLE: 1.0}
