# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The paper's error between two shapes, eq. (10)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dlo_ros.spline import DEGREE, FloatArray, SplineBasis


@lru_cache(maxsize=32)
def rule(basis: SplineBasis) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points along u [m], basis functions there, and weights [m] for the distance of two shapes.

    It has corners where they cross; a finer quadrature than the basis' own sees them.

    Returns:
        Shapes (Q,), (Q, n) and (Q,).
    """
    u, weight = SplineBasis(4 * basis.spans + DEGREE, basis.length).quadrature()
    return u, basis.matrix(u), weight


@dataclass(frozen=True)
class Deviation:
    """Distance between two splines along u.

    Args:
        mean: ERR of eq. (10) [m].
        std: standard deviation along u [m].
        maximum: largest distance at the ends and the points of the quadrature [m].
    """

    mean: float
    std: float
    maximum: float


def deviation(a: FloatArray, b: FloatArray, basis: SplineBasis) -> Deviation:
    """How far two splines are apart along u, by quadrature.

    Args:
        a, b: control points, shape (n, 3) or more columns, of which x, y, z count.
        basis: the basis of both.
    """
    distance, weight = _apart(a, b, basis)
    ends = np.linalg.norm((a - b)[[0, -1], :3], axis=1)
    mean = float(weight @ distance / basis.length)
    variance = float(weight @ (distance - mean) ** 2 / basis.length)
    return Deviation(mean, math.sqrt(variance), float(max(distance.max(), ends.max())))


def shape_error(a: FloatArray, b: FloatArray, basis: SplineBasis) -> float:
    """ERR of eq. (10): mean distance along u between two splines [m]; see `deviation`."""
    return float(shape_errors(a[None], b[None], basis)[0])


def shape_errors(a: FloatArray, b: FloatArray, basis: SplineBasis) -> FloatArray:
    """ERR of eq. (10) of each of F pairs of splines [m], shape (F,).

    Args:
        a, b: control points, shape (F, n, 3) or more columns, of which x, y, z count.
        basis: the basis of all.
    """
    distance, weight = _apart(a, b, basis)
    return np.asarray(distance @ weight / basis.length)


def _apart(a: FloatArray, b: FloatArray, basis: SplineBasis) -> tuple[FloatArray, FloatArray]:
    """Distances at Q points along u, shape (..., Q), and weights of their quadrature, shape (Q,).

    Args:
        a, b: shape (..., n, 3) or more columns.
    """
    _, matrix, weight = rule(basis)
    squares = [((a[..., c] - b[..., c]) @ matrix.T) ** 2 for c in range(3)]
    return np.sqrt(sum(squares)), weight
