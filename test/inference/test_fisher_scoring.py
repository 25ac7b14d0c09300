# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fisher scoring finds the maximum of a likelihood, within bounds and along flat directions."""

import numpy as np
import pytest
from scipy.optimize import minimize

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


@pytest.mark.parametrize("seed", range(8))
def test_it_ends_where_a_long_search_along_the_gradient_does(seed):
    """Variances of which most are nearly zero, with spectra that are alike."""
    rng = np.random.default_rng(seed)
    frequency = np.linspace(0.0, np.pi, 60)
    memories = np.array([0.0, 0.3, 0.9, 0.93, 0.99])[:, None]
    shapes = (1.0 - memories**2) / (1.0 - 2.0 * memories * np.cos(frequency) + memories**2)
    counts = rng.integers(4, 40, 60).astype(float)
    true = np.exp([-18.0, -40.0, -22.0, -40.0, -40.0]) @ shapes
    squares = true * rng.chisquare(counts)

    def cost(x):
        parts = np.exp(x)[:, None] * shapes
        total = parts.sum(axis=0)
        value = 0.5 * float(counts @ np.log(total) + squares @ (1.0 / total))
        relative = parts / total
        slope = relative @ (0.5 * (counts - squares / total))
        return value, slope, (relative * (0.5 * counts)) @ relative.T

    bounds = np.array([[-33.0, -2.0]] * 5)
    begin = np.array([-18.5, -18.5, -22.5, -22.5, -22.5])
    best = minimize(
        lambda x: cost(x)[:2], begin, jac=True, method="L-BFGS-B", bounds=bounds,
        options={"maxiter": 2000, "ftol": 1e-15},
    )  # fmt: skip
    assert cost(scored(cost, begin, bounds, 40))[0] < best.fun + 0.05
