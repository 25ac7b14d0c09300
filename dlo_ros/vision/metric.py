"""True lengths of curves in a bar map: the board's plane, sampled on a coarse grid."""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera import Camera
from dlo_ros.vision.segmentation import BarMap

CELL = 24.0  # [px of the bar map] distortion and perspective are straight over that


class PlaneGrid:
    """Takes points of a bar map to the board's plane, by bilinear interpolation.

    Good to a few parts in a thousand of lengths, which suffices to choose between courses, and many
    times faster than undoing the lens for every bridge that is tried.
    """

    def __init__(self, camera: Camera, bars: BarMap) -> None:
        height, width = bars.strength.shape
        self._columns = max(2, int(np.ceil(width / CELL)) + 1)
        self._rows = max(2, int(np.ceil(height / CELL)) + 1)
        x, y = np.meshgrid(np.arange(self._columns) * CELL, np.arange(self._rows) * CELL)
        pixels = bars.to_image(np.column_stack([x.ravel(), y.ravel()]))
        plane = camera.to_board(pixels)[:, [0, 2]]
        # Beyond the horizon everything is far away.
        plane = np.where(np.isfinite(plane), plane, 1e6)
        self._plane = plane.reshape(self._rows, self._columns, 2)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Points (x, z) [m] of points of the bar map, shape (m, 2)."""
        q = points / CELL
        column = np.clip(q[:, 0].astype(np.int64), 0, self._columns - 2)
        row = np.clip(q[:, 1].astype(np.int64), 0, self._rows - 2)
        s = (q[:, 0] - column)[:, None]
        t = (q[:, 1] - row)[:, None]
        p = self._plane
        upper = (1 - s) * p[row, column] + s * p[row, column + 1]
        lower = (1 - s) * p[row + 1, column] + s * p[row + 1, column + 1]
        return np.asarray((1 - t) * upper + t * lower)
