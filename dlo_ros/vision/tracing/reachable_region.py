# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The part of the picture that a DLO of known length can reach from its grips."""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.ridge_map import Image

CELL = 32  # [px] of the grid on which this is found
STRETCH = 1.15  # of the length, for what camera, length and clamps are wrong by
MARGIN = 6.0  # [diameters] besides


def reach(camera: Camera, held: list[FloatArray], length: float, diameter: float) -> Image | None:
    """Cells of the picture that a DLO can reach.

    The way from one clamp over any of its points to the other is no longer than the DLO.

    Args:
        camera: camera of the picture.
        held: positions (x, z) of the held ends [m], one or two.
        length, diameter: length and diameter of the DLO [m].

    Returns:
        Not zero where it can be, one value for CELL x CELL pixels; None for everywhere.
    """
    if not held:
        return None
    columns, rows = -(-camera.width // CELL), -(-camera.height // CELL)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * CELL, (np.arange(rows) + 0.5) * CELL)
    board = camera.to_board(np.column_stack([x.ravel(), y.ravel()]))[:, [0, 2]]
    ends = [held[0], held[-1]]
    way = sum(np.hypot(*(board - end).T) for end in ends)
    longest = (2.0 if len(held) == 1 else 1.0) * STRETCH * length + 2.0 * MARGIN * diameter
    mask = np.asarray(way < longest).reshape(rows, columns)
    # A cell is as large as its corners: the neighbours of what is reached count as well.
    grown = np.pad(mask, 1)
    mask = (
        grown[1:-1, 1:-1] | grown[:-2, 1:-1] | grown[2:, 1:-1] | grown[1:-1, :-2] | grown[1:-1, 2:]
    )
    return np.asarray(mask, dtype=np.uint8)


def spread(cells: Image, like: Image) -> Image:
    """The values of cells that cover a picture, for each of its pixels.

    Args:
        cells: cells that `reach` returned.
        like: any array of the picture's height and width.
    """
    rows, columns = (np.arange(n) // CELL for n in like.shape[:2])
    return np.asarray(cells[np.ix_(rows, columns)])
