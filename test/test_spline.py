# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The spline basis: at equal steps of u, and with knot spans that are halved at the ends."""

import numpy as np
import pytest

from dlo_ros.spline import SplineBasis


def test_a_grid_is_the_basis_at_equal_steps_and_fits_alike():
    basis = SplineBasis(8, 0.5)
    u = np.linspace(0.0, 0.5, 41)
    for derivative in range(4):
        assert np.array_equal(basis.grid(41, derivative), basis.matrix(u, derivative))
    points = np.column_stack([np.cos(4.0 * u), u])
    weights = 1.0 + u
    assert np.array_equal(basis.fit_grid(points, weights), basis.fit(u, points, weights))


@pytest.mark.parametrize(("even", "halvings"), [(2, 1), (5, 3), (14, 6)])
def test_halved_knot_spans_contain_the_even_ones(even, halvings):
    basis = SplineBasis(even + 2 * halvings + 3, 0.5, halvings)
    coarse = SplineBasis(even + 3, 0.5)
    assert basis.even_spans == even
    assert basis.span_length == coarse.span_length
    assert np.isin(np.round(coarse.breaks, 12), np.round(basis.breaks, 12)).all()
    ends = basis.span_length * 0.5 ** np.array([halvings, *range(halvings, 0, -1)])
    assert np.diff(basis.breaks)[: halvings + 1] == pytest.approx(ends)
    assert np.diff(basis.breaks)[::-1] == pytest.approx(np.diff(basis.breaks))
    u, weight = basis.quadrature()
    assert weight.sum() == pytest.approx(0.5)
    assert np.array_equal(basis.span_of(u), np.repeat(np.arange(basis.spans), 4))
    # A spline of the coarse basis is one of the finer, and comes back.
    points = np.random.default_rng(3).normal(size=(coarse.control_points, 2))
    finer = basis.projection(coarse) @ points
    places = np.linspace(0.0, 0.5, 101)
    np.testing.assert_allclose(
        basis.evaluate(finer, places), coarse.evaluate(points, places), atol=1e-12
    )
    np.testing.assert_allclose(coarse.projection(basis) @ finer, points, atol=1e-10)
