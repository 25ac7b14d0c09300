# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled linear algebra of constraints: imposed degrees of freedom and pins.

Imposed degrees of freedom are eliminated exactly; pins (material points held in the middle of the
DLO) are linear constraints, met exactly by a Schur complement of the banded matrix.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.solve import banded_factorisation

LEAST_DETERMINANT = 1e-200  # of a matrix whose largest entry is 1; below it is singular


@linked()
def eliminate(band, fixed, rhs, increments):
    """Replace the equations of imposed degrees of freedom by x = increment.

    Args:
        band: matrix, lower rows (N, w + 1), changed in place.
        fixed: whether a degree of freedom is imposed, shape (N,).
        rhs, increments: right-hand sides and what the imposed ones become, shape (P, N).
    """
    size, last = band.shape[0], band.shape[1] - 1
    for j in range(size):
        if not fixed[j]:
            continue
        low, high = max(0, j - last), min(size, j + last + 1)
        for a in range(rhs.shape[0]):
            x = increments[a, j]
            if x != 0.0:
                for k in range(low, j):
                    rhs[a, k] -= band[j, last - j + k] * x
                for i in range(j + 1, high):
                    rhs[a, i] -= band[i, last - i + j] * x
        for k in range(low, j):
            band[j, last - j + k] = 0.0
        for i in range(j + 1, high):
            band[i, last - i + j] = 0.0
        band[j, last] = 1.0
    for a in range(rhs.shape[0]):
        for j in range(size):
            if fixed[j]:
                rhs[a, j] = increments[a, j]


@linked()
def stiffen(band, rhs, pins, gaps):
    """Add springs at the pins to a matrix K, which change no solution x with pins @ x = gaps.

    K of a DLO that pins alone hold is singular: it moves as a whole without them (augmented
    Lagrangian: Bertsekas, Constrained Optimization and Lagrange Multiplier Methods, 1982).

    Args:
        band, rhs: K, lower rows (N, w + 1), and right-hand sides (P, N), changed in place.
        pins, gaps: rows of the constraints, shape (m, N), and their values, shape (P, m).
    """
    size, last = band.shape[0], band.shape[1] - 1
    spring = 0.0
    for j in range(size if pins.shape[0] else 0):
        spring = max(spring, abs(band[j, last]))
    for a in range(pins.shape[0]):
        for j in range(size):
            by = spring * pins[a, j]
            if by == 0.0:
                continue
            for k in range(max(0, j - last), j + 1):
                band[j, last - j + k] += by * pins[a, k]
            for p in range(rhs.shape[0]):
                rhs[p, j] += by * gaps[p, a]


@linked()
def compliance(band, diagonal, pins):
    """Displacements of the pins by forces on them.

    Args:
        band, diagonal: factors of the matrix K.
        pins: rows P of the constraints, shape (m, N).

    Returns:
        K^-1 P^T as rows (m, N), and P K^-1 P^T (m, m).
    """
    m = pins.shape[0]
    y, schur = pins.copy(), np.empty((m, m))
    for a in range(m):
        banded_factorisation.solve(band, diagonal, y[a])
    for a in range(m):
        for b in range(m):
            schur[a, b] = np.dot(pins[a], y[b])
    return y, schur


@linked()
def constrain(pins, y, schur, gap, x):
    """Correct the solution x so that pins @ x = gap; returns False where that is impossible.

    Args:
        y, schur: see `compliance`.
    """
    m = pins.shape[0]
    if m == 0:
        return True
    force = np.empty(m)
    for a in range(m):
        force[a] = np.dot(pins[a], x) - gap[a]
    if not _solve_pivoted(schur.copy(), force):
        return False
    for a in range(m):
        for i in range(x.size):
            x[i] -= force[a] * y[a, i]
    return True


@linked()
def _solve_pivoted(matrix, x):
    """Solve a small dense system in place of x (m,); returns False where it is singular.

    Gaussian elimination with row pivots, as LAPACK does it, of which numba compiles ten times as
    much code. The matrix is changed.
    """
    m, scale, determinant = x.size, 0.0, 1.0
    for a in range(m):
        for b in range(m):
            scale = max(scale, abs(matrix[a, b]))
    if scale == 0.0:
        return False
    for k in range(m):
        pivot = k
        for a in range(k + 1, m):
            if abs(matrix[a, k]) > abs(matrix[pivot, k]):
                pivot = a
        determinant *= matrix[pivot, k] / scale
        if abs(determinant) < LEAST_DETERMINANT:
            return False
        x[k], x[pivot] = x[pivot], x[k]
        for b in range(m):
            matrix[k, b], matrix[pivot, b] = matrix[pivot, b], matrix[k, b]
        for a in range(k + 1, m):
            factor = matrix[a, k] / matrix[k, k]
            x[a] -= factor * x[k]
            for b in range(k + 1, m):
                matrix[a, b] -= factor * matrix[k, b]
    for a in range(m - 1, -1, -1):
        for b in range(a + 1, m):
            x[a] -= matrix[a, b] * x[b]
        x[a] /= matrix[a, a]
    return True


@linked()
def constrained_negative_modes(negative, schur):
    """Number of negative eigenvalues with the pins held, of `negative` without them.

    It follows from Haynsworth's formula for the inertia of the matrix bordered by the constraints.
    """
    if negative < 0 or schur.shape[0] == 0:
        return negative
    return negative + np.sum(np.linalg.eigvalsh(schur) > 0.0) - schur.shape[0]


@linked()
def pin_gap(fixed, pins, pin_rows, target, pinned):
    """Values that `pins @ q` must have, shape (m,), given the imposed values.

    Args:
        fixed: whether a degree of freedom is imposed, shape (N,).
        pins, pin_rows: rows of the pinned coordinates in the free ones and in all, shape (m, N).
        target: imposed values, shape (n, 4) or (n, 2).
        pinned: positions of the pinned points [m], shape (k, 3).
    """
    m, dof = pins.shape[0], target.shape[1]
    gap = np.empty(m)
    flat = target.ravel()
    per = 3 if dof == 4 else 2
    for a in range(m):
        point, c = a // per, a % per
        value = pinned[point, c] if dof == 4 else pinned[point, 2 * c]
        for i in range(flat.size):
            if fixed[i]:
                value -= pin_rows[a, i] * flat[i]
        gap[a] = value
    return gap


@linked()
def back_substitute(band, diagonal, pins, gaps, rhs):
    """Solve an eliminated and factorised system for several right-hand sides (P, N), in place.

    Args:
        pins, gaps: rows (m, N) and what pins @ x must be, shape (P, m).
    """
    y, schur = compliance(band, diagonal, pins)
    banded_factorisation.solve_several(band, diagonal, rhs)
    for a in range(rhs.shape[0]):
        constrain(pins, y, schur, gaps[a], rhs[a])
