# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A coarse simulation's fit ends where a fine one's does; motion from the independent rod."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import moving

from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline import without_own_error as module
from dlo_ros.identification.offline.without_own_error import without_own_error
from dlo_ros.inference.joint import evaluate
from dlo_ros.inference.joint_fit import fit, settled
from dlo_ros.inference.losses import TO_REPORT
from dlo_ros.inference.measured import measured
from dlo_ros.inference.priors import joint_model
from dlo_ros.inference.scene import imposed_names, scene

COARSE, FINE = (3e-4, 14), (3e-7, 28)


def fitted(recording, given, resolution):
    tolerance, spans = resolution
    seen = replace(measured(recording, given), tolerance=tolerance, spans=spans)
    view = scene(given, imposed_names([recording]), [seen.observed])
    model = joint_model(given, given, view)
    at = settled(evaluate(model, [seen]), [seen])
    return fit(at, [seen], 20, loss=TO_REPORT), [seen]


@pytest.fixture(scope="module")
def fits():
    recording, given = moving("simple", {}, 31)
    return {
        name: fitted(recording, given, r) for name, r in {"coarse": COARSE, "fine": FINE}.items()
    }


def log_ratio(at):
    return float((at.model.axis("young_modulus") - at.model.axis("density")) @ at.model.theta())


def std(at):
    axis = at.model.axis("young_modulus") - at.model.axis("density")
    return float(np.sqrt(axis @ at.posterior.covariance @ axis))


def test_the_error_of_long_steps_and_few_spans_leaves_the_numbers(fits):
    (coarse, recordings), (fine, _) = fits["coarse"], fits["fine"]
    here, adjusted = without_own_error(coarse, recordings)
    found = fit(here, adjusted, 20, loss=TO_REPORT)
    before, after = (abs(log_ratio(at) - log_ratio(fine)) for at in (coarse, found))
    assert before > std(fine)
    assert after < 0.3 * before
    assert after < std(fine)
    assert (adjusted[0].tolerance, adjusted[0].spans) == (COARSE[0], COARSE[1])
    assert not np.array_equal(adjusted[0].observed, recordings[0].observed)


def test_a_fit_of_a_fine_simulation_stays_as_it_is(fits):
    fine, recordings = fits["fine"]
    assert without_own_error(fine, recordings) == (fine, recordings)


@pytest.mark.slow
def test_where_nothing_finer_can_be_simulated_the_fit_stays(fits, monkeypatch):
    def refused(*_):
        raise SimulationError("diverges")

    monkeypatch.setattr(module, "simulate", refused)
    coarse, recordings = fits["coarse"]
    assert without_own_error(coarse, recordings) == (coarse, recordings)
