# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The smoothing spline and the compiled sums that replace scipy's."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter1d

from dlo_ros.vision.fit.material_coordinates import length_log_likelihood, locate_ends
from dlo_ros.vision.fit.smoothing_spline import smooth
from dlo_ros.vision.segmentation.picture_strip import smooth_strip
from dlo_ros.vision.tracing.tip_likelihood import Tip


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


@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_strip_is_smoothed_along_and_across(channels):
    strip = np.random.default_rng(1).uniform(0.0, 255.0, (60, 17, *channels)).astype(np.float32)
    expected = gaussian_filter1d(strip.astype(float), 2.0, axis=0, mode="nearest")
    assert smooth_strip(strip, 2.0) == pytest.approx(expected, abs=1e-3)
    expected = gaussian_filter1d(expected, 0.96, axis=1, mode="nearest")
    assert smooth_strip(strip, 2.0, 0.96) == pytest.approx(expected, abs=1e-3)


def test_the_places_of_two_free_ends_are_the_means_of_all_pairs():
    rng = np.random.default_rng(2)
    arc = np.arange(401.0) * 1e-3
    tips = tuple(
        Tip(at, rng.normal(0.0, 2.0, len(at)), float(at[0]))
        for at in (np.arange(-20.0, 40.0), np.arange(350.0, 430.0))
    )
    odds = tips[0].likelihood[:, None] + tips[1].likelihood
    odds = odds + length_log_likelihood((tips[1].at - tips[0].at[:, None]) * 1e-3, 0.38, 0.0)
    weight = np.exp(odds - odds.max())
    weight /= weight.sum()
    expected = [tips[0].at @ weight.sum(axis=1), tips[1].at @ weight.sum(axis=0)]
    found = locate_ends(arc, tips, 0.38, 0.0, 0.01)
    assert found.places == pytest.approx(expected, abs=1e-9)
