# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A single edge, or edges beside a gap, count where the sections around them predict the middle."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from dlo_ros.vision.segmentation.picture_strip import normals_of
from dlo_ros.vision.segmentation.section_confirmation import confirm

WIDTH, SPACING, ALONG, LONGEST, NOISE = 10.0, 2.0, 2.0, 8, 0.05
COUNT = 300
STRETCH = slice(144, 156)  # 2.4 widths


def bend(radius=150.0):
    angle = SPACING * np.arange(COUNT) / radius
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def confirmed(aside, seen=None, single=STRETCH):
    """Mask and doubt of a bend with noise, whose single edges tell a middle that lies aside."""
    curve = bend()
    normals = normals_of(curve)
    offset = np.random.default_rng(3).normal(0.0, NOISE, COUNT)
    offset[single] += aside
    both = np.ones(COUNT, bool)
    both[single] = False
    seen = np.ones(COUNT, bool) if seen is None else seen
    points = curve + offset[:, None] * normals
    return confirm(points, normals, seen, both, WIDTH, SPACING, ALONG, LONGEST, NOISE)


def test_single_edges_on_the_course_are_kept_with_the_std_of_the_prediction():
    seen, doubt = confirmed(0.0)
    assert np.mean(seen) > 0.99
    assert np.all(doubt[STRETCH] > 0.0)
    assert np.all(doubt[STRETCH] < 4.0 * NOISE)
    assert np.all(doubt[:20] == 0.0)


@pytest.mark.parametrize("aside", [-5.0, -1.5, 1.5, 5.0])
def test_edges_of_a_strand_beside_are_left_out(aside):
    seen, _ = confirmed(aside)
    assert not np.any(seen[STRETCH])
    assert np.all(seen[:130])
    assert np.all(seen[170:])


def test_true_middle_is_confirmed_whatever_the_scatter_of_the_others():
    curve = bend()
    normals = normals_of(curve)
    both = np.ones(COUNT, bool)
    both[STRETCH] = False
    kept, apart, doubts = [], [], []
    for seed in range(200):
        # Means along the DLO, as `locate` takes them, correlate the sections.
        white = np.random.default_rng(seed).normal(0.0, NOISE, COUNT)
        offset = gaussian_filter1d(white, ALONG) * np.sqrt(2.0 * np.sqrt(np.pi) * ALONG)
        offset[STRETCH] = 0.0
        points = curve + offset[:, None] * normals
        seen, doubt = confirm(
            points, normals, np.ones(COUNT, bool), both, WIDTH, SPACING, ALONG, LONGEST, NOISE
        )
        kept.append(np.mean(seen[STRETCH]))
        doubts.append(doubt[150])
        apart.append(offset[120:140].std())
    assert np.mean(kept) > 0.98
    # Some six independent means to either side of the stretch determine a cubic's four numbers.
    assert 0.5 * np.median(apart) < np.median(doubts) < 1.5 * np.median(apart)


def test_edges_between_two_long_gaps_count_where_they_continue_the_course():
    seen = np.ones(COUNT, bool)
    seen[120:150] = seen[156:186] = False
    kept, _ = confirmed(2.0, seen, single=slice(150, 156))
    assert not np.any(kept[150:156])
    kept, doubt = confirmed(0.0, seen, single=slice(150, 156))
    assert np.all(kept <= seen)
    assert np.all(doubt[150:156] > NOISE)


def test_scatter_too_scarce_to_tell_changes_nothing():
    seen = np.zeros(COUNT, bool)
    seen[::7] = True
    kept, doubt = confirmed(0.0, seen.copy())
    assert np.array_equal(kept, seen)
    assert not np.any(doubt)
