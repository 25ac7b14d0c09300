# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Positions and directions of the DLO's ends in the picture, from the imposed motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import CONTROL_POINT, END, START, Motion
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.fit.spline_fit import ClampBoard
from dlo_ros.vision.segmentation.ridge_map import RidgeMap
from dlo_ros.vision.tracing.chain_ordering import ClampPixel

LEAST_DIRECTION = 0.2  # share of a direction that must lie in the board's plane
DIRECTION_STEP = 0.2  # [diameters] of the difference quotient that gives a direction in the picture

Places = tuple[FloatArray | None, FloatArray | None]
"""Places (x, z) of start and end [m], shape (2,) each; None where an end is free."""


@dataclass(frozen=True, eq=False)
class EndPoses:
    """The clamps of both ends at one instant; None where an end is free.

    Args:
        start, end: the clamps.
        doubted: places of clamps that are not where the command says: the ends are looked for as
            if they were free. None where the command is believed.
    """

    start: ClampBoard | None = None
    end: ClampBoard | None = None
    doubted: Places | None = None

    @property
    def places(self) -> Places:
        """Places of both ends as the command says."""
        if self.doubted is not None:
            return self.doubted
        start, end = self.start, self.end
        return None if start is None else start.position, None if end is None else end.position

    @property
    def held(self) -> list[FloatArray]:
        """Places (x, z) of the ends that are held, as the command says [m]."""
        return [place for place in self.places if place is not None]

    def in_doubt(self) -> EndPoses:
        """The same, not believed; free ends where none is held."""
        return EndPoses(doubted=self.places if self.held else None)


def ends_at(motion: Motion | None, stamp: int) -> EndPoses:
    """The ends that a motion imposes at a stamp [ns].

    `start` and `end` give position and direction; `control_point_1` and `control_point_n` the
    position, with their neighbour the direction too.
    """
    command = motion.at(stamp) if motion is not None else None
    if command is None:
        return EndPoses()
    positions, rotations = command.sample(stamp)
    known = {name: k for k, name in enumerate(command.names)}
    n = command.control_points
    return EndPoses(
        _end(known, positions, rotations, START, 1, 2),
        _end(known, positions, rotations, END, n, n - 1),
    )


def _end(
    known: dict[str, int],
    positions: FloatArray,
    rotations: FloatArray,
    name: str,
    outer: int,
    inner: int,
) -> ClampBoard | None:
    if name in known:
        k = known[name]
        direction = Rotation.from_quat(rotations[k]).apply([1.0, 0.0, 0.0])
        return ClampBoard(positions[k][[0, 2]], _unit(direction[[0, 2]]))
    k_outer = known.get(f"{CONTROL_POINT}{outer}")
    if k_outer is None:
        return None
    k_inner = known.get(f"{CONTROL_POINT}{inner}")
    if k_inner is None:
        return ClampBoard(positions[k_outer][[0, 2]], None)
    towards = positions[k_inner][[0, 2]] - positions[k_outer][[0, 2]]
    along = _unit(towards if inner > outer else -towards, least=1e-9)
    return ClampBoard(positions[k_outer][[0, 2]], along)


def _unit(vector: FloatArray, least: float = LEAST_DIRECTION) -> FloatArray | None:
    norm = float(np.hypot(vector[0], vector[1]))
    return np.asarray(vector / norm) if norm > least else None


def clamps_in(
    bars: RidgeMap, ends: EndPoses, camera: Camera, diameter: float
) -> tuple[ClampPixel | None, ClampPixel | None]:
    """The clamps of start and end in pixels of a bar map.

    Args:
        bars: the bar map.
        ends: the clamps in the board's plane.
        camera: camera of the picture.
        diameter: diameter of the DLO [m].
    """

    def local(clamp: ClampBoard | None) -> ClampPixel | None:
        pixel = None if clamp is None else to_pixel(clamp, camera, DIRECTION_STEP * diameter)
        if pixel is None:
            return None
        return ClampPixel(bars.from_image(pixel.position), pixel.direction)

    return local(ends.start), local(ends.end)


def to_pixel(clamp: ClampBoard, camera: Camera, step: float) -> ClampPixel | None:
    """A clamp in the picture; None where it lies behind the camera.

    Args:
        clamp: pose of the clamp in the board's plane.
        camera: camera of the picture.
        step: small length for the direction's difference quotient [m].
    """
    points = np.zeros((2, 3))
    points[:, [0, 2]] = clamp.position
    if clamp.direction is not None:
        points[1, [0, 2]] += step * clamp.direction
    pixels = camera.project(points)
    if not np.all(np.isfinite(pixels)):
        return None
    if clamp.direction is None:
        return ClampPixel(pixels[0], None)
    difference = pixels[1] - pixels[0]
    return ClampPixel(pixels[0], difference / max(float(np.hypot(*difference)), 1e-12))
