# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled sums over pictures and places, against those of numpy and scipy."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from dlo_ros.vision.fit.material_coordinates import length_log_likelihood, locate_ends
from dlo_ros.vision.segmentation.cross_sections import Sections, offsets_for
from dlo_ros.vision.segmentation.picture_strip import smooth_strip
from dlo_ros.vision.segmentation.ridge_filter import second_differences
from dlo_ros.vision.tracing.tip_likelihood import Tip


@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_strip_is_smoothed_along_and_across(channels):
    strip = np.random.default_rng(1).uniform(0.0, 255.0, (60, 17, *channels)).astype(np.float32)
    expected = gaussian_filter1d(strip.astype(float), 2.0, axis=0, mode="nearest")
    assert smooth_strip(strip, 2.0) == pytest.approx(expected, abs=1e-3)
    expected = gaussian_filter1d(expected, 0.96, axis=1, mode="nearest")
    assert smooth_strip(strip, 2.0, 0.96) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("width", [3, 4, 19, 20, 21])
def test_second_differences_are_taken_of_every_third_pixel(width):
    image = np.random.default_rng(2).integers(0, 256, (5, width, 3)).astype(np.uint8)
    wide = image.astype(float)
    second = 2.0 * wide[:, 2:-2:3] - wide[:, :-4:3] - wide[:, 4::3]
    expected = np.linalg.norm(second, axis=2)
    assert second_differences(image, 2) == pytest.approx(expected, rel=1e-6)


def test_a_cross_section_is_the_median_of_those_of_the_dlo():
    offsets = offsets_for(10.0)
    strip = np.random.default_rng(3).normal(180.0, 5.0, (64, len(offsets), 3))
    strip[:, np.abs(offsets) < 5.0] -= 100.0
    sections = Sections.of(strip.astype(np.float32), offsets, 10.0)
    sides = strip[:, np.abs(offsets) > 7.4]
    assert sections.board == pytest.approx(np.median(sides.reshape(-1, 3), axis=0), abs=1e-3)
    usual = np.median(strip, axis=0) - sections.board
    expected = usual @ sections.axis / (sections.axis @ sections.axis)
    assert sections.shape == pytest.approx(expected, abs=1e-4)
    visible, ended = sections.odds(strip.astype(np.float32))
    assert np.median(visible) > 1.0
    assert not np.any(ended)
    # On the bare board it has ended.
    strip[:, :] = sections.board
    visible, ended = sections.odds(strip.astype(np.float32))
    assert np.all(visible < 0.0)
    assert np.all(ended > 1.0)


def test_the_places_of_two_free_ends_are_the_means_of_all_pairs():
    rng = np.random.default_rng(4)
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
