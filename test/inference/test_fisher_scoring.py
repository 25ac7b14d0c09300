# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fisher scoring finds the maximum of a likelihood, within bounds and along flat directions."""

import numpy as np
import pytest

from dlo_ros.inference.fisher_scoring import scored

WIDE = np.array([[-30.0, 5.0]] * 2)


def of_variances(counts, means):
    """Minus the log likelihood of normal numbers, whose log variances are the unknowns."""

    def cost(x):
        relative = means * np.exp(-x)
        value = 0.5 * float(np.sum(counts * (x + relative)))
        return value, 0.5 * counts * (1.0 - relative), np.diag(0.5 * counts)

    return cost


def test_the_variance_of_normal_numbers_is_their_mean_square():
    means = np.array([1e-6, 3.0])
    found = scored(of_variances(np.array([50.0, 7.0]), means), np.zeros(2), WIDE, 40)
    assert np.exp(found) == pytest.approx(means, rel=0.02)


def test_what_is_flat_does_not_keep_the_rest_from_its_maximum():
    """The sum of two variances of which one is zero: the likelihood says nothing of its size."""
    count, mean = 200.0, 1e-4

    def cost(x):
        sizes = np.exp(x)
        total = sizes.sum()
        share = sizes / total
        slope = 0.5 * count * (1.0 - mean / total) * share
        value = 0.5 * count * (np.log(total) + mean / total)
        return value, slope, 0.5 * count * np.outer(share, share)

    found = scored(cost, np.array([0.0, -20.0]), WIDE, 40)
    assert np.exp(found).sum() == pytest.approx(mean, rel=0.01)


def test_no_number_leaves_its_bounds():
    bounds = np.array([[-2.0, 5.0], [-30.0, 0.5]])
    means = np.array([1e-6, 3.0])
    found = scored(of_variances(np.array([50.0, 7.0]), means), np.zeros(2), bounds, 40)
    assert found == pytest.approx([-2.0, 0.5])


def test_a_step_into_what_has_no_likelihood_is_shortened():
    inner = of_variances(np.array([50.0, 7.0]), np.array([1e-6, 3.0]))

    def cost(x):
        if x[0] < -14.5:
            raise np.linalg.LinAlgError
        return inner(x)

    found = scored(cost, np.array([-12.0, 0.0]), WIDE, 40)
    assert found[0] == pytest.approx(np.log(1e-6), abs=0.1)
