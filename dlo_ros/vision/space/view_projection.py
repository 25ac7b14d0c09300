# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fine spline projected into a view, beside the points that were measured there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.spline_table import BasisTable
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.space.view import View

NEAREST = 0.05  # [m] before a camera, where no DLO is
GRAZING = 0.05  # share of a DLO's direction across a ray, below which it runs along the ray
BEYOND = 2.0  # [px] past the DLO's end a point is none of it
DRIFTS = 4
"""Coefficients of what is not known of the velocity: a cubic (Bernstein) of the share of u."""


class Projection(NamedTuple):
    """A view's points beside the projected spline.

    Args:
        basis: values of the basis functions at each point's u, shape (m, k).
        drift_basis: those of the velocity's drift, shape (m, 4).
        depth: depth of the spline [m], shape (m,).
        across, along: position of the spline from each point, across and along the measured
            centreline [px], shape (m,).
        across_rows, depth_rows: derivatives of `across` [px/m] and `depth` by the spline's point in
            the board frame, shape (m, 3).
        speed: derivative of `along` by u, its sign turned [px/m], shape (m,).
        behind: depth from the surface to the axis along the point's ray, over the radius: 1 where
            the DLO lies across the optical axis and on it, shape (m,).
    """

    basis: FloatArray
    drift_basis: FloatArray
    depth: FloatArray
    across: FloatArray
    along: FloatArray
    across_rows: FloatArray
    depth_rows: FloatArray
    speed: FloatArray
    behind: FloatArray

    def on(self, u: FloatArray, length: float) -> Mask:
        """Mask of the points that lie beside the DLO, not beyond its ends, at their u [m]."""
        before = (u <= 0.0) & (self.along < -BEYOND)
        behind = (u >= length) & (self.along > BEYOND)
        return np.asarray(~(before | behind))


def project(
    view: View,
    u: FloatArray,
    table: BasisTable,
    points: FloatArray,
    drift: FloatArray,
    *,
    sliding: bool = True,
) -> Projection:
    """Project the spline into a view at its points' material coordinates.

    Args:
        view: view whose points were measured.
        u: material coordinates [m] between 0 and L, shape (m,).
        table: basis of the spline.
        points: control points at the view's time [m], shape (k, 3).
        drift: shift of the view's spline that varies with u [m], shape (4, 3).
        sliding: whether the spline slides past the points, so that their u change with it, else
            they are those of the points.

    Raises:
        VisionError: the spline lies behind the camera.
    """
    camera = view.camera
    result = Projection(
        *_project(
            u, table.basis.length, table.values, table.slope, points, drift, camera.rotation,
            camera.translation, view.focal_length, view.rays, view.tangents, sliding,
        )
    )  # fmt: skip
    if not np.all(result.depth > NEAREST):
        raise VisionError("what the cameras see does not meet in front of them")
    return result


@njit()
def _project(
    u: FloatArray,
    length: float,
    values: FloatArray,
    slopes: FloatArray,
    points: FloatArray,
    drift: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    focal: float,
    rays: FloatArray,
    tangents: FloatArray,
    sliding: bool,
) -> tuple[
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
]:
    """The fields of `Projection`; basis functions are interpolated in their table."""
    count, k = len(u), values.shape[1]
    basis, drift_basis = np.empty((count, k)), np.empty((count, DRIFTS))
    depth, across, along = np.empty(count), np.empty(count), np.empty(count)
    across_rows, depth_rows, speed = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    behind = np.empty(count)
    place, slope, along_row = np.empty(3), np.empty(3), np.empty(3)
    for i in range(count):
        at = u[i] * ((len(values) - 1) / length)
        row = min(max(int(at), 0), len(values) - 2)
        share = at - row
        place[:] = 0.0
        slope[:] = 0.0
        for j in range(k):
            value = (1.0 - share) * values[row, j] + share * values[row + 1, j]
            change = (1.0 - share) * slopes[row, j] + share * slopes[row + 1, j]
            basis[i, j] = value
            for c in range(3):
                place[c] += value * points[j, c]
                slope[c] += change * points[j, c]
        s = u[i] / length
        drift_basis[i, 0] = (1.0 - s) ** 3
        drift_basis[i, 1] = 3.0 * s * (1.0 - s) ** 2
        drift_basis[i, 2] = 3.0 * s**2 * (1.0 - s)
        drift_basis[i, 3] = s**3
        for j in range(DRIFTS):
            for c in range(3):
                place[c] += drift_basis[i, j] * drift[j, c]
        x, y, z = translation[0], translation[1], translation[2]
        for c in range(3):
            x += rotation[0, c] * place[c]
            y += rotation[1, c] * place[c]
            z += rotation[2, c] * place[c]
        depth[i] = z
        tx, ty = tangents[i, 0], tangents[i, 1]
        qx, qy = x / z, y / z
        dx, dy = qx - rays[i, 0], qy - rays[i, 1]
        across[i] = focal * (dy * tx - dx * ty)
        along[i] = -focal * (dx * tx + dy * ty)
        speed[i] = aside = climb = right = down = 0.0
        for c in range(3):
            forward = rotation[2, c]
            row_x, row_y = rotation[0, c] - qx * forward, rotation[1, c] - qy * forward
            across_rows[i, c] = focal / z * (tx * row_y - ty * row_x)
            along_row[c] = focal / z * (tx * row_x + ty * row_y)
            depth_rows[i, c] = forward
            speed[i] += along_row[c] * slope[c]
            aside += across_rows[i, c] * slope[c]
            climb += forward * slope[c]
            right += rotation[0, c] * slope[c]
            down += rotation[1, c] * slope[c]
        # A ray of length |(qx, qy, 1)| for a unit of depth meets a cylinder's surface a radius over
        # the sine of its angle with the axis before it comes nearest to the axis.
        size = np.sqrt(right**2 + down**2 + climb**2)
        normal = np.sqrt(
            (qy * climb - down) ** 2 + (right - qx * climb) ** 2 + (qx * down - qy * right) ** 2
        )
        behind[i] = size / max(normal, GRAZING * size, 1e-300)
        # A move of the spline along the centreline brings another part of it beside the point,
        # and that part lies further across where both are not parallel.
        if sliding and abs(aside) < abs(speed[i]):
            for c in range(3):
                across_rows[i, c] -= aside / speed[i] * along_row[c]
                depth_rows[i, c] -= climb / speed[i] * along_row[c]
    return basis, drift_basis, depth, across, along, across_rows, depth_rows, speed, behind
