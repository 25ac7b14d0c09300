# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The edges of known profiles."""

import numpy as np
import pytest

from dlo_ros.vision.segmentation.edge_search import (
    climbing_length,
    slope_towards,
    steepest_change,
)
from dlo_ros.vision.tracing.ridge_snapping import contrasts, scores

OFFSETS = 0.5 * np.arange(-20, 21.0)
CHANGE = np.array([30.0, -40.0, 120.0], dtype=np.float32)  # 130 grey levels


def ramps(places, length):
    """Colours that change by `CHANGE` evenly over a length [px] around each place [px]."""
    share = np.clip((OFFSETS[None, :] - np.asarray(places)[:, None]) / length + 0.5, 0.0, 1.0)
    return (100.0 + share[:, :, None] * CHANGE).astype(np.float32)


@pytest.mark.parametrize("length", [3.0, 5.0])
def test_an_even_climb_has_its_slope_length_and_middle(length):
    places = np.array([-1.0, 0.0, 1.5])
    change = np.tile(CHANGE, (3, 1))
    slope, climb = slope_towards(ramps(places, length), OFFSETS, change)
    assert climb == pytest.approx(130.0)
    assert slope.max(axis=1) == pytest.approx(130.0 / length, rel=1e-5)
    expected = places + 0.25
    assert climbing_length(slope, OFFSETS, climb, expected, 6.0) == pytest.approx(length, rel=1e-5)
    at, found = steepest_change(slope, OFFSETS, climb, places, np.full(3, 8.0), 10.0)
    assert found.all()
    assert at == pytest.approx(places, abs=1e-4)


def test_a_change_the_other_way_or_outside_of_the_window_is_no_edge():
    places, window = np.zeros(2), np.full(2, 4.0)
    falling, climb = slope_towards(ramps(places, 3.0), OFFSETS, np.tile(-CHANGE, (2, 1)))
    at, found = steepest_change(falling, OFFSETS, climb, places + 1.0, window, 10.0)
    assert not found.any() and at == pytest.approx(1.0)
    slope, climb = slope_towards(ramps(places, 3.0), OFFSETS, np.tile(CHANGE, (2, 1)))
    assert not steepest_change(slope, OFFSETS, climb, places + 6.0, window, 10.0)[1].any()


def test_a_bar_has_its_contrast_to_the_weaker_side_and_scores_by_its_colour():
    strip = np.full((4, 30, 3), 200.0, dtype=np.float32)
    strip[:, 18:] = 150.0
    strip[:, 12:18] = 50.0
    ranges = np.array([[4, 8], [0, 2], [10, 12]])
    core, contrast = contrasts(strip, ranges, 18)
    assert core[:, :, 9] == pytest.approx(50.0)
    assert contrast[:, 9] == pytest.approx(100.0 * 3**0.5)
    assert contrast[:, 0] == pytest.approx(0.0)
    usual = float(contrast[0, 9])
    unknown = scores(core, contrast, np.zeros(0, np.float32), 2.0 * usual)
    assert unknown[:, 9] == pytest.approx(0.5)
    other = scores(core, contrast, np.full(3, 150.0, np.float32), usual)
    assert other[:, 9] == pytest.approx(0.0, abs=1e-6)
