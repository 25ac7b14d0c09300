# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Strains of the discrete rod in space and their derivatives, compiled as with numba's @njit.

Shapes are nodes x [m], shape (N + 1, 3), and first directors of the edges, shape (N, 3). Vertex i
lies at node i and sees two edges. With tangents te, tf, directors d1, d2 of both and
kb = 2 te x tf / (1 + te . tf) its curvatures are kb . (d1e + d1f) / 2 and kb . (d2e + d2f) / 2.
Clamps stand for the edges beyond the ends; they do not depend on the nodes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.spline import FloatArray

DOF = 4  # of a node: x, y, z, and the spin of the edge after it
BANDS = 11  # a vertex couples three nodes and two spins: eleven numbers in a row
LOCAL = 8  # x, y, z of a vertex's first edge, its spin, x, y, z of the second edge, its spin


def _dot(a: FloatArray, b: FloatArray) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]


def _cross(a: FloatArray, b: FloatArray, result: FloatArray) -> None:
    result[0] = a[1] * b[2] - a[2] * b[1]
    result[1] = a[2] * b[0] - a[0] * b[2]
    result[2] = a[0] * b[1] - a[1] * b[0]


def _transport(
    director: FloatArray, before: FloatArray, after: FloatArray, result: FloatArray
) -> None:
    """Turn a director the short way from a unit tangent to another; result is unit and normal."""
    ratio = dot(director, after) / (1.0 + dot(before, after))
    for c in range(3):
        result[c] = director[c] - ratio * (before[c] + after[c])
    along, square = dot(result, after), 0.0
    for c in range(3):
        result[c] -= along * after[c]
        square += result[c] * result[c]
    for c in range(3):
        result[c] /= math.sqrt(square)


def _edges(x: FloatArray, tangent: FloatArray, size: FloatArray) -> None:
    """Unit tangents, shape (N, 3), and sizes [m], shape (N,), of the edges between nodes."""
    for i in range(size.shape[0]):
        for c in range(3):
            tangent[i, c] = x[i + 1, c] - x[i, c]
        size[i] = math.sqrt(dot(tangent[i], tangent[i]))
        for c in range(3):
            tangent[i, c] /= size[i]


def _frames(
    x: FloatArray, director: FloatArray, end_tangent: FloatArray, end_director: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Tangents, both directors, shape (N + 2, 3), and 1 / size [1/m], shape (N + 2,), of the edges.

    The first and the last are those of clamps, whose 1 / size is 0; where an end is free, that of
    the edge beside it, so that no strain is left.
    """
    edges = director.shape[0]
    tangent, first = np.empty((edges + 2, 3)), np.empty((edges + 2, 3))
    size, inverse = np.empty(edges), np.zeros(edges + 2)
    measure(x, tangent[1:-1], size)
    for i in range(edges):
        inverse[i + 1] = 1.0 / size[i]
        for c in range(3):
            first[i + 1, c] = director[i, c]
    for end in range(2):
        k, beside = (0, 1) if end == 0 else (edges + 1, edges)
        free = math.isnan(end_tangent[end, 0])
        for c in range(3):
            tangent[k, c] = tangent[beside, c] if free else end_tangent[end, c]
            first[k, c] = first[beside, c] if free else end_director[end, c]
    second = np.empty_like(first)
    for k in range(edges + 2):
        cross(tangent[k], first[k], second[k])
    return tangent, first, second, inverse


def _vertex_strains(
    x: FloatArray, director: FloatArray, end_tangent: FloatArray, end_director: FloatArray
) -> FloatArray:
    """Integrated curvatures and twist of the vertices [rad], shape (N + 1, 3).

    Args:
        x, director: the shape.
        end_tangent, end_director: of the clamps at both ends, shape (2, 3); NaN where free.
    """
    t, first, second, _ = frames(x, director, end_tangent, end_director)
    strain = np.empty((x.shape[0], 3))
    binormal, carried, across = np.empty(3), np.empty(3), np.empty(3)
    for i in range(x.shape[0]):
        te, tf = t[i], t[i + 1]
        cross(te, tf, binormal)
        half = 1.0 / (1.0 + dot(te, tf))
        strain[i, 0] = half * (dot(binormal, first[i]) + dot(binormal, first[i + 1]))
        strain[i, 1] = half * (dot(binormal, second[i]) + dot(binormal, second[i + 1]))
        transport(first[i], te, tf, carried)
        cross(carried, first[i + 1], across)
        strain[i, 2] = math.atan2(dot(across, tf), dot(carried, first[i + 1]))
    return strain


def _differentiate(
    t: FloatArray, first: FloatArray, second: FloatArray, inverse: FloatArray, stress: FloatArray,
    work: FloatArray, jacobian: FloatArray, hessian: FloatArray,
) -> None:  # fmt: skip
    """Derivatives of a vertex's strains by its eight local numbers.

    Args:
        t, first, second, inverse: those of its two edges, see `frames`.
        stress: moments and torque [N m], shape (3,).
        work: to be written over, shape (10, 3).
        jacobian: receives the first derivatives, shape (3, 8).
        hessian: receives the second ones, summed with the stresses, shape (8, 8).
    """
    te, tf, e, f = t[0], t[1], inverse[0], inverse[1]
    open_ = 1.0 + dot(te, tf)
    kb, mean, te_across, tf_across, across = work[0], work[1], work[2], work[3], work[4]
    cross(te, tf, kb)
    for c in range(3):
        kb[c] *= 2.0 / open_
        mean[c] = (te[c] + tf[c]) / open_
    jacobian[:] = 0.0
    hessian[:] = 0.0
    for a in range(2):
        d = first if a == 0 else second
        kappa = 0.5 * (dot(kb, d[0]) + dot(kb, d[1]))
        for c in range(3):
            across[c] = (d[0, c] + d[1, c]) / open_
        cross(te, across, te_across)
        cross(tf, across, tf_across)
        for c in range(3):
            jacobian[a, c] = e * (tf_across[c] - kappa * mean[c])
            jacobian[a, 4 + c] = -f * (te_across[c] + kappa * mean[c])
    for k in range(2):
        jacobian[0, 3 + 4 * k] = 0.5 * dot(kb, second[k])
        jacobian[1, 3 + 4 * k] = -0.5 * dot(kb, first[k])
    for c in range(3):
        jacobian[2, c] = 0.5 * e * kb[c]
        jacobian[2, 4 + c] = 0.5 * f * kb[c]
    jacobian[2, 3], jacobian[2, 7] = -1.0, 1.0

    # Both curvatures at once: with moments M1, M2 they are that of kb . (De + Df) / 2 with the
    # vectors D = M1 d1 + M2 d2, whose derivative by the spin is D' = M1 d2 - M2 d1.
    de, df, ge, gf, skewed = work[5], work[6], work[7], work[8], work[9]
    for c in range(3):
        de[c] = stress[0] * first[0, c] + stress[1] * second[0, c]
        df[c] = stress[0] * first[1, c] + stress[1] * second[1, c]
        ge[c] = stress[0] * second[0, c] - stress[1] * first[0, c]
        gf[c] = stress[0] * second[1, c] - stress[1] * first[1, c]
        across[c] = (de[c] + df[c]) / open_
        skewed[c] = stress[2] / open_ * te[c] - across[c]
    energy, torque = 0.5 * (dot(kb, de) + dot(kb, df)), stress[2]
    cross(te, across, te_across)
    cross(tf, across, tf_across)
    for r in range(3):
        for c in range(3):
            both, one = 2.0 * energy * mean[r] * mean[c], 1.0 if r == c else 0.0
            ee = both - tf_across[r] * mean[c] - mean[r] * tf_across[c]
            ee += 0.25 * (kb[r] * de[c] + de[r] * kb[c]) - energy / open_ * (one - te[r] * te[c])
            ee -= 0.25 * torque * (kb[r] * (te[c] + mean[c]) + (te[r] + mean[r]) * kb[c])
            ff = both + te_across[r] * mean[c] + mean[r] * te_across[c]
            ff += 0.25 * (kb[r] * df[c] + df[r] * kb[c]) - energy / open_ * (one - tf[r] * tf[c])
            ff -= 0.25 * torque * (kb[r] * (tf[c] + mean[c]) + (tf[r] + mean[r]) * kb[c])
            ef = both - tf_across[r] * mean[c] + mean[r] * te_across[c]
            ef -= energy / open_ * (one + te[r] * tf[c]) + 0.5 * torque * kb[r] * mean[c]
            if r != c:  # the matrix of the vector product with `skewed`
                sign = 1.0 if (c - r) % 3 == 2 else -1.0
                ef += sign * skewed[3 - r - c]
            hessian[r, c] = e * e * ee
            hessian[4 + r, 4 + c] = f * f * ff
            hessian[r, 4 + c] = hessian[4 + c, r] = e * f * ef
    for k in range(2):
        g, d, at = (ge, de, 3) if k == 0 else (gf, df, 7)
        along = 0.5 * dot(kb, g)
        cross(te, g, te_across)
        cross(tf, g, tf_across)
        for c in range(3):
            by_e = e * (tf_across[c] / open_ - along * mean[c])
            by_f = -f * (te_across[c] / open_ + along * mean[c])
            hessian[c, at] = hessian[at, c] = by_e
            hessian[4 + c, at] = hessian[at, 4 + c] = by_f
        hessian[at, at] = -0.5 * dot(kb, d)


def _spread(local: FloatArray, result: FloatArray) -> None:
    """Rows of derivatives by the eight local numbers as such by a vertex's eleven, (m, 11)."""
    for r in range(local.shape[0]):
        result[r, 3], result[r, 7] = local[r, 3], local[r, 7]
        for c in range(3):
            result[r, c] = -local[r, c]
            result[r, 4 + c] = local[r, c] - local[r, 4 + c]
            result[r, 8 + c] = local[r, 4 + c]


def _add_bending(
    x: FloatArray, director: FloatArray, end_tangent: FloatArray, end_director: FloatArray,
    stress: FloatArray, stiffness: FloatArray, gradient: FloatArray, band: FloatArray,
) -> None:  # fmt: skip
    """Add what curvatures and twist contribute to a gradient and a Hessian.

    Args:
        x, director: the shape.
        end_tangent, end_director: of the clamps at both ends, shape (2, 3); NaN where free.
        stress: moments and torques [N m], shape (N + 1, 3).
        stiffness: their derivatives by the strains [N m], shape (N + 1, 3, 3).
        gradient: [N], [N m], shape (N + 1, 4).
        band: the Hessian's lower half, entry (j + d, j) at [d, j], shape (BANDS, 4 (N + 1)).
    """
    nodes = x.shape[0]
    t, first, second, inverse = frames(x, director, end_tangent, end_director)
    jacobian, hessian, work = np.empty((3, LOCAL)), np.empty((LOCAL, LOCAL)), np.empty((10, 3))
    slopes, rows, whole = np.empty((3, BANDS)), np.empty((LOCAL, BANDS)), np.empty((BANDS, BANDS))
    for i in range(nodes):
        two = slice(i, i + 2)
        differentiate(
            t[two], first[two], second[two], inverse[two], stress[i], work, jacobian, hessian
        )
        spread(jacobian, slopes)
        spread(hessian, rows)
        spread(rows.T, whole)
        start = DOF * (i - 1)
        for r in range(BANDS):
            row = start + r
            if row < 0 or row >= DOF * nodes:
                continue
            node, which = row // DOF, row % DOF
            for a in range(3):
                gradient[node, which] += stress[i, a] * slopes[a, r]
            for c in range(r + 1):
                if start + c < 0:
                    continue
                value = whole[r, c]
                for a in range(3):
                    for b in range(3):
                        value += slopes[a, r] * stiffness[i, a, b] * slopes[b, c]
                band[r - c, start + c] += value


def _add_stretch(
    x: FloatArray, lengths: FloatArray, stiffness: FloatArray, offset: FloatArray,
    gradient: FloatArray, band: FloatArray,
) -> None:  # fmt: skip
    """Add what the stretch of the edges contributes.

    Args:
        x: nodes [m], shape (N + 1, 3).
        lengths, stiffness, offset: reference lengths [m], stiffness [J] and the force against each
            strain [J], shape (N,).
        gradient, band: see `add_bending`.
    """
    edges = lengths.shape[0]
    tangent, size = np.empty((edges, 3)), np.empty(edges)
    measure(x, tangent, size)
    for i in range(edges):
        force = (stiffness[i] * (size[i] / lengths[i] - 1.0) - offset[i]) / lengths[i]
        along, across = stiffness[i] / lengths[i] ** 2, force / size[i]
        for r in range(3):
            gradient[i, r] -= force * tangent[i, r]
            gradient[i + 1, r] += force * tangent[i, r]
            for c in range(3):
                h = (along - across) * tangent[i, r] * tangent[i, c]
                if r == c:
                    h += across
                if r >= c:
                    band[r - c, DOF * i + c] += h
                    band[r - c, DOF * (i + 1) + c] += h
                band[DOF + r - c, DOF * i + c] -= h


def _hold(free: NDArray[np.bool_], gradient: FloatArray, band: FloatArray) -> None:
    """Take what is held out of gradient and Hessian.

    Args:
        free: whether a degree of freedom is free, shape (4 (N + 1),).
        gradient: shape (N + 1, 4).
        band: see `add_bending`.
    """
    for j in range(free.shape[0]):
        if free[j]:
            continue
        gradient[j // DOF, j % DOF] = 0.0
        band[:, j] = 0.0
        for d in range(1, min(BANDS, j + 1)):
            band[d, j - d] = 0.0
        band[0, j] = 1.0


def _move(x: FloatArray, director: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nodes and directors after a change of the degrees of freedom, shape (N + 1, 4)."""
    edges = director.shape[0]
    before, after, size = np.empty((edges, 3)), np.empty((edges, 3)), np.empty(edges)
    there, turned = x + change[:, :3], np.empty((edges, 3))
    measure(x, before, size)
    measure(there, after, size)
    carried, beside = np.empty(3), np.empty(3)
    for i in range(edges):
        transport(director[i], before[i], after[i], carried)
        cross(after[i], carried, beside)
        cosine, sine = math.cos(change[i, 3]), math.sin(change[i, 3])
        for c in range(3):
            turned[i, c] = cosine * carried[c] + sine * beside[c]
    return there, turned


dot = njit(from_python=False)(_dot)
cross = njit(from_python=False)(_cross)
transport = njit(from_python=False)(_transport)
measure = njit(from_python=False)(_edges)
spread = njit(from_python=False)(_spread)
differentiate = linked()(_differentiate)
frames = linked()(_frames)
vertex_strains = linked(from_python=True)(_vertex_strains)
add_bending = linked(from_python=True)(_add_bending)
add_stretch = linked(from_python=True)(_add_stretch)
hold = linked(from_python=True)(_hold)
move = linked(from_python=True)(_move)
