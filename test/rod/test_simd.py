# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Vectors in registers, of which the rod's kernels are made, against NumPy."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from dlo_ros.rod.simd.four_lanes import lane, lanes, quad
from dlo_ros.rod.simd.row_operations import add_outer, add_rows, set_outer, set_rows


@njit
def arithmetic(a, b, c):
    """All that a Quad can do."""
    p, q = quad(a, b, c), quad(b, c, a)
    r = (p + q) * (p - 2.0) / (1.0 + q) - -p
    r += np.sqrt(q)
    r += 0.5 * (3.0 - p) * (q - 1.0 / p)
    return lanes(r), lane(r, 3)


def test_quads_are_the_arithmetic_of_numbers():
    a, b, c = 1.5, 0.25, 4.0
    p, q = np.array([a, b, c, c]), np.array([b, c, a, a])
    r = (p + q) * (p - 2.0) / (1.0 + q) + p + np.sqrt(q) + 0.5 * (3.0 - p) * (q - 1.0 / p)
    found, last = arithmetic(a, b, c)
    np.testing.assert_allclose([*found, last], r, rtol=1e-14)


@njit
def combined(out, at, factors, rows, start, fresh):
    if fresh:
        set_rows(out, at, factors, rows, start, 16)
    else:
        add_rows(out, at, factors, rows, start, 16)


@njit
def outer(out, at, left, i, right, j, factor, fresh):
    if fresh:
        set_outer(out, at, left, i, right, j)
    else:
        add_outer(out, at, factor, left, i, right, j)


@pytest.mark.parametrize("fresh", [True, False])
def test_rows_are_combined_and_multiplied_as_numpy_does(fresh):
    rng = np.random.default_rng(3)
    rows, old = rng.normal(size=(5, 16)), rng.normal(size=(4, 16))
    out, factors = old.copy(), (0.5, -2.0, 3.0)
    combined(out, 16, factors, rows, 32, fresh)  # three rows from the third on, to the second
    wanted = old.copy()
    wanted[1] = np.array(factors) @ rows[2:] + (0.0 if fresh else old[1])
    np.testing.assert_allclose(out, wanted, rtol=1e-13)
    left, right = rng.normal(size=8), rng.normal(size=(3, 4))
    out, product = old.copy(), np.outer(left[2:6], right[1]).ravel()
    outer(out, 32, left, 2, right, 4, 0.7, fresh)
    wanted = old.copy()
    wanted[2] = product if fresh else old[2] + 0.7 * product
    np.testing.assert_allclose(out, wanted, rtol=1e-13)


@pytest.mark.parametrize("wrong", [np.zeros((4, 16), np.float32), np.zeros((16, 4)).T])
def test_rows_live_in_contiguous_arrays_of_float64(wrong):
    with pytest.raises(TypingError, match="rows live in C-contiguous float64 arrays"):
        combined(wrong, 0, (1.0,), np.zeros((1, 16)), 0, True)
    with pytest.raises(TypingError, match="factors of rows are a tuple"):
        combined(np.zeros((4, 16)), 0, (1, 2), np.zeros((2, 16)), 0, True)
