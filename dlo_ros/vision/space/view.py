# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One camera's measured points of the DLO's centreline, as input of the fit in space."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.parameters import CameraPose
from dlo_ros.recordings.images import CameraInfo
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.edge_levels import LENGTH
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.picture_strip import Mask

BLOCK = 1.0  # [widths] of profiles whose mean is one point: neighbours share pixels
LEAST_OF_BLOCK = 0.5  # share of a block's profiles that must have been seen


@dataclass(frozen=True, eq=False)
class View:
    """Measured points of the centreline in one picture, along the DLO.

    Args:
        camera: camera of the picture.
        pixels: shape (m, 2).
        rays: the same, undistorted and normalised, shape (m, 2).
        tangents: unit vectors along the centreline among the rays, towards growing u, shape (m, 2).
        u: material coordinate at which each is looked for first [m], shape (m,).
        width: width of the DLO [px].
        dt: time of the picture after that of the shape which is fitted [s].
        tips: pixels of start and end where they are free and were seen.
        depth: depth of the DLO's surface, in its middle, along the optical axis [m], NaN where
            unknown, shape (m,).
        shared: standard deviation across that a point has in common with its neighbours, for as
            many of them as if each had it alone [px], shape (m,).
        apart: distance of the DLO's edges [px], NaN where it is unknown, shape (m,); None: nowhere.
    """

    camera: Camera
    pixels: FloatArray
    rays: FloatArray
    tangents: FloatArray
    u: FloatArray
    width: float
    dt: float = 0.0
    tips: tuple[FloatArray | None, FloatArray | None] = (None, None)
    depth: FloatArray | None = None
    shared: FloatArray | float = 0.0
    apart: FloatArray | None = None

    @property
    def focal_length(self) -> float:
        """Geometric mean of both [px]."""
        return focal_length(self.camera)

    def at(self, u: FloatArray) -> View:
        """These points with other material coordinates [m], shape (m,)."""
        return replace(self, u=u)


def cameras_of(
    infos: Mapping[str, CameraInfo], poses: Mapping[str, CameraPose]
) -> dict[str, Camera]:
    """Cameras of intrinsics and poses, in the order of the poses."""
    return {
        name: Camera.from_info(
            infos[name].k, infos[name].d, infos[name].distortion_model, infos[name].width,
            infos[name].height, pose,
        )
        for name, pose in poses.items()
    }  # fmt: skip


def focal_length(camera: Camera) -> float:
    """Geometric mean of a camera's focal lengths [px]."""
    return float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))


def view_of(
    camera: Camera,
    located: Located,
    u: FloatArray,
    dt: float,
    seen: Mask,
    tips: tuple[FloatArray | None, FloatArray | None],
    depth: FloatArray | None = None,
) -> View:
    """Means over blocks of the profiles that were seen.

    Args:
        camera: camera of the picture.
        located: the DLO's middle along a curve.
        u: material coordinate of each profile [m], shape (k,).
        dt: see `View`.
        seen: profiles that count, shape (k,).
        tips: see `View`.
        depth: depth of the surface at each profile [m], NaN where unknown, shape (k,).
    """
    index = np.arange(len(located.curve))
    size = max(1, round(BLOCK * located.width / located.spacing))
    block = index[seen] // size
    number = np.bincount(block, minlength=1)
    enough = number >= max(1.0, LEAST_OF_BLOCK * size)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(block, values[seen])[enough] / number[enough])

    curve = np.column_stack([mean(column) for column in located.curve.T])
    normals = np.column_stack([mean(column) for column in located.normals.T])
    pixels = curve + mean(located.offset)[:, None] * normals
    along = pixels + np.column_stack([normals[:, 1], -normals[:, 0]])
    rays = camera.rays(pixels)
    tangents = camera.rays(along) - rays
    good = np.all(np.isfinite(np.hstack([rays, tangents])), axis=1)
    tangents /= np.maximum(np.hypot(*tangents.T), 1e-300)[:, None]
    return View(
        camera, pixels[good], rays[good], tangents[good], mean(u)[good], located.width, dt, tips,
        None if depth is None else _medians(depth, seen, size)[np.flatnonzero(enough)][good],
        math.sqrt(LENGTH / BLOCK) * mean(located.shared_std)[good],
        None if located.apart is None else mean(located.apart)[good],
    )  # fmt: skip


def _medians(depth: FloatArray, seen: Mask, size: int) -> FloatArray:
    """Median of each block's depths, NaN where it has none."""
    blocks = -(-len(depth) // size)
    padded = np.full(blocks * size, np.inf)
    padded[: len(depth)] = np.where(seen & np.isfinite(depth), depth, np.inf)
    ordered = np.sort(padded.reshape(blocks, size), axis=1)
    number = np.isfinite(ordered).sum(axis=1)
    rows = np.arange(blocks)
    middle = 0.5 * (
        ordered[rows, np.maximum(number - 1, 0) // 2]
        + ordered[rows, np.minimum(number // 2, size - 1)]
    )
    return np.where(number > 0, middle, np.nan)
