# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The paper's error between two shapes, eq. (10)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dlo_ros.spline import DEGREE, FloatArray, SplineBasis


@lru_cache(maxsize=32)
def _rule(control_points: int, length: float) -> tuple[FloatArray, FloatArray]:
    basis = SplineBasis(control_points, length)
    # The distance has corners where two shapes cross; a finer rule than the basis' own sees them.
    u, weight = SplineBasis(4 * basis.spans + DEGREE, length).quadrature()
    return basis.matrix(u), weight


def shape_error(a: FloatArray, b: FloatArray, basis: SplineBasis) -> float:
    """ERR of eq. (10): mean distance along u between two splines, by quadrature [m].

    Args:
        a, b: control points, shape (n, 3) or more columns, of which x, y, z count.
        basis: the basis of both.
    """
    matrix, weight = _rule(basis.control_points, basis.length)
    distance = np.linalg.norm(matrix @ (a[:, :3] - b[:, :3]), axis=1)
    return float(weight @ distance / basis.length)
