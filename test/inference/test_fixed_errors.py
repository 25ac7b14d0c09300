# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Errors that keep their direction in space while the DLO turns, and what they do to numbers."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up

from dlo_ros.inference.fixed_errors import MODES, shifts_by_fixed_errors
from dlo_ros.inference.joint import judged
from dlo_ros.inference.smooth_modes import smooth_functions
from dlo_ros.inference.variances import SHARED_STD, posterior

DRAWS = 300


@pytest.fixture(scope="module")
def fitted():
    return fitted_set_up()


def seen_with(at, recording, size, rng):
    """The fit to shapes with an error as large as `size`, the same on the board in all pictures."""
    n = at.model.settings.rod.control_points
    error = np.zeros((n, 3))
    error[:, [0, 2]] = size * smooth_functions(n)[:, :MODES] @ rng.normal(size=(MODES, 2))
    ((left, slopes),) = at.fields
    shifted = left + recording.coefficients(np.broadcast_to(error, (len(left), n, 3)))
    return replace(at, fields=((shifted, slopes),))


def test_a_measurement_without_such_errors_has_none(fitted):
    assert shifts_by_fixed_errors(*fitted) == {}


def test_another_measurement_tells_of_none(fitted):
    at, recordings = fitted
    assert shifts_by_fixed_errors(at, [*recordings, *recordings]) == {}


@pytest.mark.slow
def test_numbers_are_shifted_by_as_much_as_such_errors_shift_them(fitted):
    """Steps of linear fits to shapes that have them, with the weights of the fit that there is."""
    at, recordings = fitted
    rng = np.random.default_rng(5)
    size = SHARED_STD * at.model.settings.rod.length
    shown = judged(seen_with(at, recordings[0], size, rng))
    shifts = shifts_by_fixed_errors(shown, recordings)
    assert len(shifts) == 2 * MODES
    rows = np.array([[s[n] for n in at.model.names] for s in shifts.values()])
    told = np.sqrt(np.sum(rows**2, axis=0))
    offset, precision = at.model.offset(), at.model.precision()

    def step(found):
        bins = judged(found, shown.variances).spectra
        return posterior(bins, shown.variances, offset, precision).step

    steps = [step(seen_with(at, recordings[0], size, rng)) - step(at) for _ in range(DRAWS)]
    # The size is told by a single error, and so to some factor.
    ratio = told / np.std(steps, axis=0)
    assert ratio == pytest.approx(np.full(len(ratio), np.median(ratio)), rel=0.3)
    assert 0.4 < np.median(ratio) < 1.5
