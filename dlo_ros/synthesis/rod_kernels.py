# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Strains of the planar discrete rod and banded solving, compiled as with numba's @njit.

Nodes x of shape (N + 1, 2) hold x and z [m]; edges have index 0..N-1; vertex i lies at node i.
A banded symmetric matrix is stored as its lower half, `band[d, j]` = entry (j + d, j).
"""

from __future__ import annotations

import math

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.rod_laws import BendingLaw, bend

BANDS = 6  # two coordinates, coupling over two neighbours: entries up to five below the diagonal


def _wrap(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


def _strains(
    x: FloatArray, lengths: FloatArray, clamps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Stretch of each edge, shape (N,), and turning angle of each vertex [rad], shape (N + 1,).

    `clamps` holds the imposed directions [rad] at the start and the end, NaN where an end is free
    to turn: the turning angle there is 0. Angles are positive from x towards -z.
    """
    edges = lengths.shape[0]
    stretch = np.empty(edges)
    angle = np.empty(edges)
    for i in range(edges):
        ex, ez = x[i + 1, 0] - x[i, 0], x[i + 1, 1] - x[i, 1]
        stretch[i] = math.sqrt(ex * ex + ez * ez) / lengths[i] - 1.0
        angle[i] = math.atan2(-ez, ex)
    turn = np.zeros(edges + 1)
    for i in range(1, edges):
        turn[i] = wrap(angle[i] - angle[i - 1])
    if not math.isnan(clamps[0]):
        turn[0] = wrap(angle[0] - clamps[0])
    if not math.isnan(clamps[1]):
        turn[edges] = wrap(clamps[1] - angle[edges - 1])
    return stretch, turn


def _elastic(
    x: FloatArray,
    lengths: FloatArray,
    clamps: FloatArray,
    stiffness: tuple[FloatArray, FloatArray],
    offsets: tuple[FloatArray, FloatArray],
    law: BendingLaw,
    gradient: FloatArray,
    band: FloatArray,
) -> float:
    """Energy sum(k e^2 / 2 - f e) over all strains e, and that of a law of bending.

    Adds its gradient and Hessian.

    Args:
        stiffness: k of each edge's stretch [J] and of each vertex's turning angle [J].
        offsets: f, the force that rest strain and strain history put against each strain [J].
        law: further moments, where bending is not linear.
        gradient: [N], shape (N + 1, 2), is added to.
        band: Hessian [N/m], shape (BANDS, 2 (N + 1)), is added to.

    Returns:
        The energy [J].
    """
    edges = lengths.shape[0]
    stretch, turn = strains(x, lengths, clamps)
    total = 0.0
    local = np.empty(6)
    hessian = np.empty((6, 6))
    for i in range(edges):
        k, f = stiffness[0][i], offsets[0][i]
        e = stretch[i]
        total += 0.5 * k * e * e - f * e
        force = (k * e - f) / lengths[i]
        ex, ez = x[i + 1, 0] - x[i, 0], x[i + 1, 1] - x[i, 1]
        size = math.sqrt(ex * ex + ez * ez)
        tx, tz = ex / size, ez / size
        along = k / lengths[i] ** 2
        across = force / size
        hxx = along * tx * tx + across * tz * tz
        hxz = (along - across) * tx * tz
        hzz = along * tz * tz + across * tx * tx
        a, b = 2 * i, 2 * i + 2
        gradient[i, 0] -= force * tx
        gradient[i, 1] -= force * tz
        gradient[i + 1, 0] += force * tx
        gradient[i + 1, 1] += force * tz
        for c in (a, b):
            band[0, c] += hxx
            band[1, c] += hxz
            band[0, c + 1] += hzz
        band[2, a] -= hxx
        band[3, a] -= hxz
        band[1, a + 1] -= hxz
        band[2, a + 1] -= hzz
    for i in range(edges + 1):
        free = (i == 0 and math.isnan(clamps[0])) or (i == edges and math.isnan(clamps[1]))
        if free:
            continue
        k, f = stiffness[1][i], offsets[1][i]
        total += 0.5 * k * turn[i] * turn[i] - f * turn[i]
        moment = k * turn[i] - f
        if law.active:
            stored, more, steeper = bend(law, i, turn[i])
            total += stored
            moment += more
            k += steeper
        # The turning angle is (direction of edge i) - (direction of edge i - 1); at a clamp one of
        # the two is imposed. d(direction)/d(edge) = n / size with n = (tz, -tx), its derivative
        # -(t n^T + n t^T) / size^2.
        local[:] = 0.0
        hessian[:, :] = 0.0
        for side in range(2):
            edge = i - 1 + side
            if edge < 0 or edge >= edges:
                continue
            sign = 2.0 * side - 1.0
            ex, ez = x[edge + 1, 0] - x[edge, 0], x[edge + 1, 1] - x[edge, 1]
            square = ex * ex + ez * ez
            gx, gz = sign * ez / square, -sign * ex / square
            cxx = -2.0 * sign * moment * ex * ez / square**2
            cxz = sign * moment * (ex * ex - ez * ez) / square**2
            at = 2 * side
            local[at] -= gx
            local[at + 1] -= gz
            local[at + 2] += gx
            local[at + 3] += gz
            for p in range(2):
                for q in range(2):
                    s = 1.0 if p == q else -1.0
                    r, c = at + 2 * p, at + 2 * q
                    hessian[r, c] += s * cxx
                    hessian[r, c + 1] += s * cxz
                    hessian[r + 1, c] += s * cxz
                    hessian[r + 1, c + 1] -= s * cxx
        first = 2 * (i - 1)
        for r in range(6):
            row = first + r
            if row < 0 or row >= 2 * (edges + 1):
                continue
            gradient[row // 2, row % 2] += moment * local[r]
            for c in range(r + 1):
                column = first + c
                if column >= 0:
                    band[row - column, column] += k * local[r] * local[c] + hessian[r, c]
    return total


def _solve(band: FloatArray, right: FloatArray) -> bool:
    """Solve in place by a banded Cholesky factorisation; False where not positive definite."""
    size = right.shape[0]
    for j in range(size):
        pivot = band[0, j]
        if not pivot > 0.0:
            return False
        root = math.sqrt(pivot)
        last = min(BANDS, size - j)
        for d in range(last):
            band[d, j] /= root
        for c in range(1, last):
            factor = band[c, j]
            for d in range(c, last):
                band[d - c, j + c] -= factor * band[d, j]
    for j in range(size):
        right[j] /= band[0, j]
        for d in range(1, min(BANDS, size - j)):
            right[j + d] -= band[d, j] * right[j]
    for j in range(size - 1, -1, -1):
        for d in range(1, min(BANDS, size - j)):
            right[j] -= band[d, j] * right[j + d]
        right[j] /= band[0, j]
    return True


wrap = njit(from_python=False)(_wrap)
strains = linked(from_python=True)(_strains)
elastic = linked(from_python=True)(_elastic)
solve = linked()(_solve)
