# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Values of a spline basis from a table, or in compiled code: many times faster than SciPy's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import DEGREE, FloatArray, SplineBasis

PER_SPAN = 100  # rows of the table in a knot span: interpolated they are right to 1e-5


@dataclass(frozen=True, eq=False)
class BasisTable:
    """A basis and its slope at equal steps of u, and at a few places more.

    Args:
        basis: spline basis of k control points.
        values, slope: values and slopes of the basis functions at equal steps of u, shape (m, k).
        halves: slope at two places of each knot span, shape (2 spans, k).
        third: third derivative in each knot span, shape (spans, k).
        ends, end_slopes: values and slopes at both ends, shape (2, k).
    """

    basis: SplineBasis
    values: FloatArray
    slope: FloatArray
    halves: FloatArray
    third: FloatArray
    ends: FloatArray
    end_slopes: FloatArray

    @staticmethod
    @lru_cache(maxsize=16)
    def of(basis: SplineBasis) -> BasisTable:
        """The table of a basis, kept."""
        u = np.linspace(0.0, basis.length, PER_SPAN * basis.spans + 1)
        ends = np.array([0.0, basis.length])
        middle = (np.arange(basis.spans) + 0.5) * basis.span_length
        return BasisTable(
            basis, basis.matrix(u), basis.matrix(u, 1), basis.matrix(basis.quadrature(2)[0], 1),
            basis.matrix(middle, 3), basis.matrix(ends), basis.matrix(ends, 1),
        )  # fmt: skip

    def matrix(self, u: FloatArray) -> FloatArray:
        """Basis functions at u [m] between 0 and L, shape (len(u), k)."""
        return self._read(self.values, u)

    def slopes(self, u: FloatArray) -> FloatArray:
        """Their derivatives, likewise."""
        return self._read(self.slope, u)

    def _read(self, table: FloatArray, u: FloatArray) -> FloatArray:
        at = u * ((len(table) - 1) / self.basis.length)
        row = np.clip(at.astype(np.int64), 0, len(table) - 2)
        share = (at - row)[:, None]
        return np.asarray((1.0 - share) * table[row] + share * table[row + 1])


def basis_functions(basis: SplineBasis, u: FloatArray) -> FloatArray:
    """Basis functions at u, as `SplineBasis.matrix`, shape (m, k).

    Args:
        basis: spline basis of k control points.
        u: material coordinates [m], shape (m,); values outside [0, L] are clipped to it.
    """
    return np.asarray(_basis_functions(np.clip(u, 0.0, basis.length), basis.knots))


@njit()
def _basis_functions(u: FloatArray, knots: FloatArray) -> FloatArray:
    """The recursion of de Boor, A practical guide to splines, 1978, chapter X, for each u."""
    count = len(knots) - DEGREE - 1
    result = np.zeros((len(u), count))
    values = np.zeros(DEGREE + 1)
    for i in range(len(u)):
        span = min(max(np.searchsorted(knots, u[i], side="right") - 1, DEGREE), count - 1)
        values[0] = 1.0
        for order in range(1, DEGREE + 1):
            carried = 0.0
            for n in range(order):
                high, low = knots[span + n + 1], knots[span + n + 1 - order]
                share = values[n] / (high - low)
                values[n] = carried + share * (high - u[i])
                carried = share * (u[i] - low)
            values[order] = carried
        for n in range(DEGREE + 1):
            result[i, span - DEGREE + n] = values[n]
    return result
