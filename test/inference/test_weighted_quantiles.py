# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Quantiles of values that do not count alike."""

import numpy as np
import pytest

from dlo_ros.inference.weighted_quantiles import weighted_quantiles


def test_equal_weights_give_the_middle_of_each_value():
    values = np.array([3.0, 1.0, 2.0, 4.0])
    found = weighted_quantiles(values, np.full(4, 0.25), (0.125, 0.5, 0.875))
    assert found == pytest.approx([1.0, 2.5, 4.0])


def test_a_few_values_may_count_as_much_as_many():
    """A recording of three pictures, all 100 mm off, beside one of 300 that is 1 mm off."""
    values = np.concatenate([np.full(3, 100.0), np.full(300, 1.0)])
    weights = np.concatenate([np.full(3, 0.5 / 3), np.full(300, 0.5 / 300)])
    assert weighted_quantiles(values, weights, (0.05, 0.95)) == pytest.approx([1.0, 100.0])
