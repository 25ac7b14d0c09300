# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled medians are those of NumPy and SciPy, to the last bit."""

import numpy as np
import pytest
from scipy import ndimage

from dlo_ros.vision.segmentation.medians import median, median_filter


@pytest.mark.parametrize("count", [1, 2, 5, 40, 501])
def test_medians_are_those_of_numpy(count):
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == np.median(values)
    assert np.isnan(median(values[:0]))


@pytest.mark.parametrize("size", [3, 4, 11, 32, 33])
@pytest.mark.parametrize("count", [9, 40, 501])
def test_running_medians_are_those_of_scipy(count, size):
    rng = np.random.default_rng(count + size)
    for values in (rng.normal(size=count), rng.integers(0, 4, count).astype(float)):  # ties, too
        for reflect in (False, True):
            mode = "reflect" if reflect else "nearest"
            expected = ndimage.median_filter(values, size=size, mode=mode)
            assert np.array_equal(median_filter(values, size, reflect=reflect), expected)
