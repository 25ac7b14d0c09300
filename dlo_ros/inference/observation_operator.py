# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Observation operator: measured points of the centreline against a predicted shape.

A prediction is linear in its control points, and so is its distance from a measured point across
and along the DLO. All that the points of one picture tell of the prediction, in each direction, are
weighted sums of these distances with the basis functions, so n numbers take the place of hundreds
of points without loss: b = sum w_i B(u_i) d_i with the information matrix H = sum w_i B(u_i)
B(u_i)^T and w_i = 1 / std_i^2 (information form of least squares). H^(-1/2) b has unit white noise.
Where nothing was seen it is zero, whatever is predicted there: no spline bridges the gap.

A prediction comes as n control points, projected from a finer simulation. What n control points
cannot follow is therefore taken from the points as well: a finer spline through them is projected
likewise (`SplineBasis.projection`), and the points are moved by what it loses. Without that a small
n would count as an error of the model.

Along the DLO the error of u is added, a smooth function of u with the stated standard deviation
(`smooth_modes`). It is marginalised: the numbers along the DLO are whitened by its covariance and
that of the noise, so that a u that is stretched towards a free end counts for what it is worth.

In units of the least standard deviation that these numbers can have, evenly spread points of equal
std give what the spline space gives: squares sum to the mean squared distance along u.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np

from dlo_ros.inference.smooth_modes import smooth_functions
from dlo_ros.inference.thresholds import LARGEST_GAP
from dlo_ros.observation import Observation
from dlo_ros.spline import DEGREE, ORDER, FloatArray, SplineBasis
from dlo_ros.spline_table import BasisTable

ALONG_STD = 0.001
"""Standard deviation of u over L where none is stated, that is with both ends held."""
LEAST_SHARE = 0.5
"""Smallest std of a point over the typical one of its picture: scatter is an estimate itself."""
NEGLECTED = 1e-9
"""Eigenvalue of the information matrix over the largest, below which nothing was seen."""
FACING = 1e-3
"""Length of a unit tangent's part in the board's plane, below which the DLO faces the camera."""
FINER_SPANS = 32
"""Knot spans at least of the spline that finds what the published one cannot follow."""
POINTS_EACH = 2
"""Points for each of its control points at least."""
RIDGE = 0.01
"""Weight of the published spline against that of a point, in the finer one."""


@dataclass(frozen=True, eq=False)
class Operator:
    """Linear map from control points to the points of one picture, in units of their stated noise.

    Args:
        rows: matrices from control points [m] to numbers, for each direction (across in the plane,
            along, out of the plane), shape (3, n, n, 3).
        offset: offsets of the points, shape (3, n).
        turn: unit vectors of these directions at the Greville abscissae, shape (n, 3, 3).
        information: sum of 1 / std^2 [1/m^2].
    """

    rows: FloatArray
    offset: FloatArray
    turn: FloatArray
    information: float

    def residual(self, control_points: FloatArray) -> FloatArray:
        """Measured minus predicted, shape (3, n).

        Args:
            control_points: predicted [m], shape (n, 3).
        """
        return self.offset - self.moved(control_points)

    def moved(self, change: FloatArray) -> FloatArray:
        """Change of the predicted numbers by changes of the control points, shape (..., 3, n).

        Args:
            change: [m], shape (..., n, 3).
        """
        return np.tensordot(change, self.rows, ((-2, -1), (2, 3)))

    def in_space(self, numbers: FloatArray) -> FloatArray:
        """Numbers (..., 3, n) as vectors of the board frame, shape (..., n, 3)."""
        return np.asarray(np.einsum("...pk,kpc->...kc", numbers, self.turn))


_KNOWN: WeakKeyDictionary[Observation, tuple[float, Operator | None]] = WeakKeyDictionary()


def operator_of(observation: Observation, length: float) -> Operator | None:
    """The operator of an observation; None where it has no usable points, or too few.

    Args:
        observation: observation, whose splines fix the basis and the directions.
        length: L [m].
    """
    if observation.points is None:
        return None
    known = _KNOWN.get(observation)
    if known is None or known[0] != length:
        basis = SplineBasis(len(observation.control_points), length)
        known = (length, _operator(observation, basis))
        _KNOWN[observation] = known
    return known[1]


def noise_unit(observations: Sequence[Observation], length: float) -> float | None:
    """Stated standard deviation of one number in a typical picture with points [m]; None: none.

    In this unit a picture that was measured as usual counts as in the spline space.
    """
    found = [operator_of(o, length) for o in observations]
    information = [f.information for f in found if f is not None]
    return float(1.0 / np.sqrt(np.median(information))) if information else None


def directions(tangent: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors across the DLO in the board's plane, along it, and out of the plane.

    Args:
        tangent: tangents of any length, shape (..., 3).
    """
    tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-12)
    x, y, z = (tangent[..., k] for k in range(3))
    # In the board's plane, or in space by the shortest way from there.
    size = np.hypot(x, z)
    steep = size <= FACING
    scale = 1.0 / np.where(steep, 1.0, size)
    a, c = np.where(steep, 1.0, z * scale), np.where(steep, 0.0, -x * scale)
    normal = np.stack([a, np.zeros_like(a), c], axis=-1)
    return normal, tangent, np.stack([y * c, z * a - x * c, -y * a], axis=-1)


def _operator(observation: Observation, basis: SplineBasis) -> Operator | None:
    points = observation.points
    assert points is not None
    usable = np.isfinite(points.std) & np.isfinite(points.u) & (points.std > 0.0)
    usable &= np.isfinite(points.positions).all(axis=1)
    if np.count_nonzero(usable) < ORDER:
        return None
    u, place, std = points.u[usable], points.positions[usable], points.std[usable]
    std = np.maximum(std, LEAST_SHARE * np.sqrt(np.mean(std**2)))
    if points.std_along is None:
        along = np.full(len(u), ALONG_STD * basis.length)
    else:
        along = points.std_along[usable]
    shape, n = observation.control_points[:, :3], basis.control_points
    table = BasisTable.of(basis)
    b = table.matrix(u)
    apart = place - b @ shape
    if np.mean(apart**2) > (LARGEST_GAP * basis.length) ** 2:
        return None
    place = place - _not_followed(basis, u, apart)
    slopes = table.slopes(np.concatenate([u, basis.greville]))
    frames = np.stack(directions(slopes @ shape), axis=1)
    frame, turn = frames[: len(u)], frames[len(u) :]  # (m, 3, 3), (n, 3, 3)
    weighted = b / (std**2)[:, None]
    values, vectors = np.linalg.eigh(weighted.T @ b)
    seen = values > NEGLECTED * values[-1]
    root = np.where(seen, 1.0 / np.sqrt(np.where(seen, values, 1.0)), 0.0)
    project = (vectors * root) @ vectors.T @ weighted.T  # (n, m)
    rows = np.zeros((3, n, n, 3))
    for p, c in zip(*np.nonzero(frame.any(axis=0)), strict=True):
        rows[p, :, :, c] = (project * frame[:, p, c]) @ b
    offset = (project @ np.sum(frame * place[:, None], axis=2)).T
    slides = project @ (along[:, None] * (b @ smooth_functions(n)))
    values, vectors = np.linalg.eigh(np.eye(n) + slides @ slides.T)
    whiten = (vectors / np.sqrt(values)) @ vectors.T
    rows[1] = (whiten @ rows[1].reshape(n, -1)).reshape(n, n, 3)
    offset[1] = whiten @ offset[1]
    return Operator(rows, offset, turn, float(np.sum(1.0 / std**2)))


def _not_followed(basis: SplineBasis, u: FloatArray, apart: FloatArray) -> FloatArray:
    """Part of a shape that the published basis cannot follow, at its points [m], shape (m, 3).

    Args:
        basis: the published one.
        u: material coordinates of the points [m], shape (m,).
        apart: differences of the points from the published spline [m], shape (m, 3).
    """
    times = -(-FINER_SPANS // basis.spans)
    times = min(times, (len(u) // POINTS_EACH - DEGREE) // basis.spans)
    if times < 2:
        return np.zeros_like(apart)
    finer = SplineBasis(times * basis.spans + DEGREE, basis.length)
    b = BasisTable.of(finer).matrix(u)
    normal = b.T @ b
    # Where nothing was seen the published spline holds.
    normal += RIDGE * float(np.trace(normal)) / len(normal) * np.eye(len(normal))
    shape = np.linalg.solve(normal, b.T @ apart)
    return np.asarray(b @ (_lost(basis, finer) @ shape))


@lru_cache(maxsize=16)
def _lost(basis: SplineBasis, finer: SplineBasis) -> FloatArray:
    """Matrix from a finer spline to what its projection onto a basis loses, shape (m, m)."""
    kept = finer.projection(basis) @ basis.projection(finer)
    return np.asarray(np.eye(len(kept)) - kept)
