# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A twist-free frame along a shape."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, START, Command
from dlo_ros.errors import InputError
from dlo_ros.kernel_cache import njit
from dlo_ros.rod.boundary.conditions import BODY, DIRECTOR, FRAME, TANGENT
from dlo_ros.rod.elements.rod_tables import Reference
from dlo_ros.rod.simd.vector_algebra import dot, mix, row, unit
from dlo_ros.spline import FloatArray, SplineBasis

LEAST_SPEED = 1e-3  # of the tangent dr/du, which is 1 in a DLO that is not stretched
SAME = 1e-9  # of the length: material coordinates closer together are the same
OPPOSITE = -0.99  # cosine of directions between which there is no short way


class EndFrame(NamedTuple):
    """The material frame at an end of the DLO.

    Args:
        end: 0 at u = 0, -1 at u = L.
        tangent: unit vector along growing u, shape (3,).
        director: first director, unit and normal to it, shape (3,).
    """

    end: int
    tangent: FloatArray
    director: FloatArray


def material_frame(command: Command, stamp: int) -> EndFrame | None:
    """Frame of the clamp whose y axis is the DLO's first director; None without a clamp.

    It is the clamp at the start, else that at the end.

    Args:
        command: command with all effects applied.
        stamp: instant at which the DLO is taken as free of twist [ns].
    """
    for name, end in ((START, 0), (END, -1)):
        if name in command.names:
            _, rotations = command.sample(stamp)
            axes = Rotation.from_quat(rotations[command.names.index(name)]).as_matrix()
            return EndFrame(end, axes[:, 0], axes[:, 1])
    return None


def twist_free(
    q: FloatArray, basis: SplineBasis, points: FloatArray, given: EndFrame | None = None
) -> tuple[Reference, FloatArray]:
    """A twist-free (Bishop) frame along a shape.

    Args:
        q: control points, shape (n, 4) (theta is not used).
        basis: spline basis of the control points.
        points: material coordinates of the bending points [m], shape (nb,), growing.
        given: frame at an end, carried the short way to the shape's tangent there; default: the
            first director is +y, or +z, made normal to the tangent at u = 0.

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
    frame = np.empty_like(tangent)
    if given is not None and given.end < 0:
        backwards = np.empty_like(tangent)
        backwards[0] = _first_director(tangent[-1], given)
        _carry_along(np.ascontiguousarray(r[::-1]), np.ascontiguousarray(tangent[::-1]), backwards)
        frame[:] = backwards[::-1]
    else:
        frame[0] = _first_director(tangent[0], given)
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


def _first_director(tangent: FloatArray, given: EndFrame | None) -> FloatArray:
    """The first director at an end with a tangent (3,), unit and normal to it."""
    start = np.eye(3)[1] if abs(tangent[1]) < 0.9 else np.eye(3)[2]
    if given is not None:
        near = given.tangent @ tangent
        if near > OPPOSITE:
            lean = (given.director @ tangent) / (1.0 + near)
            start = given.director - lean * (given.tangent + tangent)
    start = start - tangent * (tangent @ start)
    return np.asarray(start / np.linalg.norm(start))


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
