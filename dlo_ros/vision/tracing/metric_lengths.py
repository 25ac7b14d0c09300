# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""True lengths of curves in a bar map: the board's plane, sampled on a coarse grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.ridge_map import RidgeMap

CELL = 24.0  # [px of the bar map] distortion and perspective are straight over that


@dataclass(frozen=True, eq=False)
class PlaneGrid:
    """Takes points of a bar map to a plane where lengths are true, by bilinear interpolation.

    Good to a few parts in a thousand of lengths, which suffices to choose between courses, and many
    times faster than undoing the lens for every bridge that is tried.

    Args:
        nodes: plane coordinates at every CELL px, shape (rows, columns, 2).
    """

    nodes: FloatArray

    @classmethod
    def of_board(cls, camera: Camera, bars: RidgeMap) -> PlaneGrid:
        """The board's plane, x and z [m]."""
        x, y = _lattice(bars)
        plane = camera.to_board(bars.to_image(np.column_stack([x.ravel(), y.ravel()])))[:, [0, 2]]
        # Beyond the horizon everything is far away.
        plane = np.where(np.isfinite(plane), plane, 1e6)
        return cls(np.ascontiguousarray(plane.reshape(*x.shape, 2)))

    @classmethod
    def of_pixels(cls, bars: RidgeMap) -> PlaneGrid:
        """The bar map itself [px], where no camera is known."""
        return cls(np.ascontiguousarray(np.stack(_lattice(bars), axis=-1)))

    def length(self, points: FloatArray, step: int = 1) -> float:
        """True length of a curve given by points of the bar map, shape (m, 2)."""
        some = points if len(points) < 3 * step else np.vstack([points[::step], points[-1:]])
        return float(polyline_length(self.nodes, np.ascontiguousarray(some)))


def _lattice(bars: RidgeMap) -> tuple[FloatArray, FloatArray]:
    height, width = bars.strength.shape
    columns = max(2, int(np.ceil(width / CELL)) + 1)
    rows = max(2, int(np.ceil(height / CELL)) + 1)
    x, y = np.meshgrid(np.arange(columns) * CELL, np.arange(rows) * CELL)
    return x, y


@linked(from_python=True)
def polyline_length(nodes: FloatArray, points: FloatArray) -> float:
    """Length in the plane of a polyline in the bar map."""
    rows, columns = nodes.shape[0], nodes.shape[1]
    total = 0.0
    before_x, before_z = 0.0, 0.0
    for k in range(len(points)):
        qx, qy = points[k, 0] / CELL, points[k, 1] / CELL
        column = min(max(int(qx), 0), columns - 2)
        row = min(max(int(qy), 0), rows - 2)
        s, t = qx - column, qy - row
        a, b = (1 - s) * (1 - t), s * (1 - t)
        c, d = (1 - s) * t, s * t
        p, q = nodes[row, column], nodes[row, column + 1]
        u, v = nodes[row + 1, column], nodes[row + 1, column + 1]
        x = a * p[0] + b * q[0] + c * u[0] + d * v[0]
        z = a * p[1] + b * q[1] + c * u[1] + d * v[1]
        if k > 0:
            total += np.sqrt((x - before_x) ** 2 + (z - before_z) ** 2)
        before_x, before_z = x, z
    return total
