# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A twist-free frame along a shape."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import InputError
from dlo_ros.kernel_cache import njit
from dlo_ros.rod.boundary.conditions import BODY, DIRECTOR, FRAME, TANGENT
from dlo_ros.rod.elements.rod_tables import Reference
from dlo_ros.rod.simd.vector_algebra import dot, mix, row, unit
from dlo_ros.spline import FloatArray, SplineBasis

LEAST_SPEED = 1e-3  # of the tangent dr/du, which is 1 in a DLO that is not stretched
SAME = 1e-9  # of the length: material coordinates closer together are the same


def twist_free(
    q: FloatArray, basis: SplineBasis, points: FloatArray, director: FloatArray | None = None
) -> tuple[Reference, FloatArray]:
    """A twist-free (Bishop) frame along a shape.

    Args:
        q: control points, shape (n, 4) (theta is not used).
        basis: spline basis of the control points.
        points: material coordinates of the bending points [m], shape (nb,), growing.
        director: first director at u = 0, shape (3,); default: any.

    Returns:
        The reference at the points, and the frames at both ends (2, FRAME), see `conditions`.

    Raises:
        InputError: control points coincide, so that the shape has no direction.
    """
    u, at, matrices = _stations(basis, points.tobytes())
    r, p, s = (m @ q[:, :3] for m in matrices)
    speed = np.linalg.norm(p, axis=1, keepdims=True)
    if not speed.min() > LEAST_SPEED:
        raise InputError(
            f"the shape has control points that coincide at u = {u[speed.argmin()]:.3g} m; it has "
            "no direction there"
        )
    tangent = p / speed
    rate = (s - tangent * np.sum(tangent * s, axis=1, keepdims=True)) / speed
    start = director
    if start is None:
        start = np.eye(3)[1] if abs(tangent[0, 1]) < 0.9 else np.eye(3)[2]
    start = start - tangent[0] * (tangent[0] @ start)
    frame = np.empty_like(tangent)
    frame[0] = start / np.linalg.norm(start)
    _carry_along(r, tangent, frame)
    reference = Reference(
        np.ascontiguousarray(tangent[at]),
        np.ascontiguousarray(rate[at]),
        np.ascontiguousarray(frame[at]),
        np.zeros(len(points)),
    )
    ends = np.zeros((2, FRAME))
    for end, k in enumerate((0, -1)):
        ends[end, TANGENT:DIRECTOR], ends[end, DIRECTOR:BODY] = tangent[k], frame[k]
    return reference, ends


@lru_cache(maxsize=64)
def _stations(
    basis: SplineBasis, points: bytes
) -> tuple[FloatArray, NDArray[np.intp], tuple[FloatArray, FloatArray, FloatArray]]:
    """Material coordinates through which a frame is carried.

    Args:
        points: wanted coordinates [m], float64.

    Returns:
        The coordinates, shape (m,); indices of the wanted ones; matrices (m, n) of the basis
        functions and of their first and second derivatives there.
    """
    wanted = np.frombuffer(points)
    between = np.linspace(0.0, basis.length, 16 * basis.spans + 1)
    u = np.unique(np.concatenate([between, wanted]))
    # Two that differ by rounding would be one point with a chord of any direction.
    u = u[np.insert(np.diff(u) > SAME * basis.length, 0, True)]
    at = np.searchsorted(u, wanted - SAME * basis.length)
    return u, at, (basis.matrix(u), basis.matrix(u, 1), basis.matrix(u, 2))


@njit()
def _carry_along(r, tangent, frame):
    """Fill the rows of frame (m, 3) from the first, along points r and tangents.

    Two reflections carry it from point to point with an error of fourth order in the spacing.
    """
    for k in range(len(r) - 1):
        v1 = mix(1.0, row(r, k + 1), -1.0, row(r, k))
        c1 = max(dot(v1, v1), 1e-300)
        before, t0, t1 = row(frame, k), row(tangent, k), row(tangent, k + 1)
        d = mix(1.0, before, -2.0 / c1 * dot(v1, before), v1)
        t = mix(1.0, t0, -2.0 / c1 * dot(v1, t0), v1)
        v2 = mix(1.0, t1, -1.0, t)
        c2 = dot(v2, v2)
        if c2 > 1e-30:
            d = mix(1.0, d, -2.0 / c2 * dot(v2, d), v2)
        d = unit(mix(1.0, d, -dot(t1, d), t1))
        frame[k + 1, 0], frame[k + 1, 1], frame[k + 1, 2] = d
