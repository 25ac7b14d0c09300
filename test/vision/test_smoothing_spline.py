# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The smoothing spline."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from dlo_ros.vision.fit.smoothing_spline import smooth


@pytest.mark.parametrize("derivative", [0, 1])
def test_a_curve_and_its_slope_are_those_of_its_b_splines(derivative):
    p = np.linspace(0.0, 100.0, 400)
    points = np.column_stack([np.sin(p / 9.0), np.cos(p / 14.0)])
    curve, weights = smooth(p, points, 6.0, (0.0, 100.0))
    assert np.abs(curve(p) - points).max() < 1e-2
    assert weights.max() == 1.0
    at = np.linspace(-3.0, 103.0, 77)  # its last pieces go on
    spline = BSpline(curve.knots, curve.coefficients, 3)
    assert curve(at, derivative) == pytest.approx(spline(at, derivative), abs=1e-12)
