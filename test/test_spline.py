# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The spline basis at equal steps of u."""

import numpy as np

from dlo_ros.spline import SplineBasis


def test_a_grid_is_the_basis_at_equal_steps_and_fits_alike():
    basis = SplineBasis(8, 0.5)
    u = np.linspace(0.0, 0.5, 41)
    for derivative in range(4):
        assert np.array_equal(basis.grid(41, derivative), basis.matrix(u, derivative))
    points = np.column_stack([np.cos(4.0 * u), u])
    weights = 1.0 + u
    assert np.array_equal(basis.fit_grid(points, weights), basis.fit(u, points, weights))
