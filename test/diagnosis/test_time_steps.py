# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Time steps that are short enough for what may be added."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis.proposals.time_steps import SHORTEST, with_short_steps
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.identification.offline.without_own_error import refined
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.parameter import ParametricModel

LONG = 1e-2


@pytest.fixture(scope="module")
def begun():
    recording, given = moving("simple", {"connector": {"mass": 0.004, "extent": 0.03}}, 31)
    found = begin([recording], given)
    rough = tuple(replace(r, tolerance=LONG) for r in found.recordings)
    return rough, found.at


def error(recording, settings):
    """Root mean square error [m] of a simulation with a heavy plug, of its own steps."""
    plug = {"mass": 0.5 * settings.scale.mass, "extent": 0.12 * settings.rod.length}
    model = ParametricModel(settings.with_effects({"connector": plug}), ())
    finest = replace(recording, tolerance=1e-6)
    (a,), (b,) = (simulate(model, [r], ()).predicted for r in (recording, finest))
    return float(np.sqrt(np.mean(np.sum((a - b)[..., :3] ** 2, axis=2))))


def test_steps_that_do_for_the_plain_model_are_shortened_for_a_heavy_plug_alone(begun):
    (rough,), at = begun
    (found,) = with_short_steps([rough], at)
    assert found.tolerance == LONG == found.tolerance_with(["gravity_tilt"])
    assert SHORTEST <= found.tolerance_with(["gravity_tilt", "connector"]) < LONG
    assert found.tolerance_with(["hysteresis"]) == LONG
    settings = at.model.settings
    assert error(found, settings) < 0.5 * error(rough, settings)
    assert found.observed is rough.observed
    assert simulate(at.model, [found], ()).mean_err == simulate(at.model, [rough], ()).mean_err


def test_steps_that_are_refined_for_a_model_are_refined_from_its_own(begun):
    (rough,), at = begun
    given = replace(rough, rapid={"connector": 1e-3})
    settings = at.model.settings
    plug = settings.with_effects({"connector": {"mass": 0.004, "extent": 0.03}})
    assert refined(given, settings).tolerance == pytest.approx(LONG / 8.0)
    assert refined(given, plug).tolerance == pytest.approx(1e-3 / 8.0)
    assert not refined(given, plug).rapid


def test_steps_that_are_short_enough_stay_as_they_are(begun):
    (rough,), at = begun
    for tolerance in (SHORTEST, None):
        (found,) = with_short_steps([replace(rough, tolerance=tolerance)], at)
        assert not found.rapid and found.tolerance == tolerance
    loose = replace(rough, noise=1e6 * rough.noise)  # nothing that it does wrong would be seen
    assert not with_short_steps([loose], at)[0].rapid


def test_what_cannot_be_simulated_asks_for_no_shorter_steps(begun, monkeypatch):
    (rough,), at = begun

    def fails(*_):
        raise SimulationError("no")

    monkeypatch.setattr("dlo_ros.diagnosis.proposals.time_steps.simulate", fails)
    assert not with_short_steps([rough], at)[0].rapid
