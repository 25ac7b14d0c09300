# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Draws a rope in space as cameras anywhere see it, and the depth image of a sensor beside one.

The rope is sampled closely along its axis; each sample stamps its cross-section on the pixels
around it. Pixels keep the nearest stamp of each strand, and the strands are composed from far to
near, so that parts of the rope hide each other by depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.picture_settings import DepthSensor, Look
from dlo_ros.synthesis.render import Image, Renderer

SPACING = 0.5  # [px] of the samples along the rope
BLENDED = 0.5  # [px] on either side of the edge, over which it is partly covered
STRAND = 6.0  # [radii] of u, beyond which two samples belong to different strands
WHOLE = 1.0 - 1e-6  # share of a pixel from which on the rope covers it
EDGE = 0.5  # share of the pixels at an edge that have no depth at all
GRAZING = 0.05  # sine of the angle of rope and ray, below which the rope points at the camera
MILLIMETRES = 1000.0  # of a depth image's unit


class Layers(NamedTuple):
    """Visible samples of the rope, strand by strand, from far to near within a pixel.

    Args:
        pixel: flat index of each, shape (m,).
        rank: 0 for the furthest strand of a pixel, shape (m,).
        across: distance of the pixel from the axis in radii, -1 to 1 within, shape (m,).
        u: material coordinate [m], shape (m,).
        normal: unit vector across the axis in the image, x to the right, z up, shape (m, 2).
        depth: depth of the axis [m], shape (m,).
        cover: share of the pixel, shape (m,).
        behind: depth from the surface's middle to the axis along the ray, over the radius,
            shape (m,).
    """

    pixel: NDArray[np.int64]
    rank: NDArray[np.int64]
    across: FloatArray
    u: FloatArray
    normal: FloatArray
    depth: FloatArray
    cover: FloatArray
    behind: FloatArray


class SpatialRenderer:
    """Draws frames of one scene for one camera; the same seed gives the same pictures.

    Args:
        geometry: camera and pose.
        look: appearance of board and rope.
        diameter: diameter of the rope [m].
        behind: y of the board's surface [m]; the rope must stay before it.
        seed: seed of texture and noise.
    """

    def __init__(
        self, geometry: Geometry, look: Look, diameter: float, behind: float, seed: int
    ) -> None:
        self.geometry = geometry
        self.radius = 0.5 * diameter
        self._scene = Renderer(geometry, look, diameter, seed, behind=behind)
        self._rng = np.random.default_rng((seed, 1))
        rays = geometry.rays()
        # Depth along the optical axis of the board at each pixel.
        reach = (behind - geometry.eye[1]) / rays[..., 1]
        self._board_depth: FloatArray = reach * (rays @ geometry.rotation[2])

    def encode(self, picture: Image) -> bytes:
        """The picture as a JPEG file."""
        return self._scene.encode(picture)

    def frame(
        self, lines: list[FloatArray], u: FloatArray, behind: Sequence[FloatArray] = ()
    ) -> Image:
        """One picture.

        Args:
            lines: the axis in the board frame [m], each of shape (m, 3), at instants spread over
                the exposure.
            u: material coordinates of its points [m], shape (m,), growing.
            behind: axes of further ropes of the same look that stand still behind it, farthest
                first.

        Returns:
            BGR image, shape (H, W, 3).
        """
        ground = self._scene.board.astype(np.float64)
        for line in behind:
            ground = self._composed(ground, self.layers(line, u))
        layers = [self.layers(line, u) for line in lines]
        mean = np.mean([self._composed(ground, one) for one in layers], axis=0)
        return self._scene.finished(mean.astype(np.float32))

    def _composed(self, ground: FloatArray, layers: Layers) -> FloatArray:
        picture = ground.reshape(-1, 3).copy()
        light = self._scene.light.reshape(-1)
        for rank in range(int(layers.rank.max(initial=-1)) + 1):
            one = layers.rank == rank
            pixel, cover = layers.pixel[one], layers.cover[one][:, None]
            rope = self._scene.rope_colour(layers.across[one], layers.u[one], layers.normal[one])
            picture[pixel] += cover * (rope * light[pixel][:, None] - picture[pixel])
        return picture.reshape(self._scene.board.shape)

    def depth(self, line: FloatArray, u: FloatArray, sensor: DepthSensor) -> NDArray[np.uint16]:
        """The depth image of a sensor at the camera's place.

        Pixels that the rope covers in part, at its edges or where it is thin, give a depth between
        rope and board, or nothing; others fail more often the thinner the rope is seen.

        Args:
            line: the axis in the board frame [m], shape (m, 3).
            u: material coordinates of its points [m], shape (m,).
            sensor: noise and range of the depth sensor.

        Returns:
            Depth [mm], 0 where there is none, shape (H, W).
        """
        layers = self.layers(line, u)
        result = self._board_depth.reshape(-1).copy()
        rng, missing = self._rng, np.zeros(result.shape, dtype=np.bool_)
        for rank in range(int(layers.rank.max(initial=-1)) + 1):
            one = layers.rank == rank
            pixel, cover = layers.pixel[one], layers.cover[one]
            before = np.sqrt(np.maximum(1.0 - layers.across[one] ** 2, 0.0)) * layers.behind[one]
            surface = layers.depth[one] - before * self.radius
            whole = cover > WHOLE
            mixed = whole | (rng.random(len(pixel)) < sensor.mixed)
            share = np.where(mixed, cover, 0.0)
            result[pixel] += share * (surface - result[pixel])
            focal_length = self._focal_length_across(layers.normal[one])
            seen = focal_length * self.radius / layers.depth[one]
            lost = np.exp(-2.0 * seen / sensor.thin) if sensor.thin > 0.0 else np.zeros(len(pixel))
            lost = np.where(whole, lost, np.maximum(lost, EDGE))
            missing[pixel] = rng.random(len(pixel)) < lost
        missing |= rng.random(result.shape) < sensor.holes
        result += rng.normal(0.0, sensor.std, result.shape)
        result[missing | ~np.isfinite(result) | (result <= 0.0)] = 0.0
        shape = self._board_depth.shape
        return np.rint(np.clip(MILLIMETRES * result, 0, 65535)).astype(np.uint16).reshape(shape)

    def _focal_length_across(self, normal: FloatArray) -> FloatArray:
        """Focal length in the direction of unit vectors of the image [px], (m, 2) -> (m,)."""
        return np.asarray(np.hypot(*(np.array(self.geometry.camera.focal_length) * normal).T))

    def _behind(self, line: FloatArray) -> FloatArray:
        """Depth of an axis [m], shape (m, 3), behind the surface over the radius, see `Layers`.

        A ray that meets the axis leaves the surface a radius over the sine of their angle before.
        """
        seen = line @ self.geometry.rotation.T + np.array(self.geometry.pose.translation)
        along, distance = np.gradient(seen, axis=0), np.linalg.norm(seen, axis=1)
        across = np.linalg.norm(np.cross(seen, along), axis=1)
        sine = across / np.maximum(distance * np.linalg.norm(along, axis=1), 1e-300)
        return np.asarray(seen[:, 2] / distance / np.maximum(sine, GRAZING))

    def layers(self, line: FloatArray, u: FloatArray) -> Layers:
        """The visible samples of the rope, before the lens's blur; arguments as in `depth`."""
        camera = self.geometry.camera
        pixels = self.geometry.project(line)
        depth = line @ self.geometry.rotation[2] + self.geometry.pose.translation[2]
        step = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(step)])
        at = np.linspace(0.0, along[-1], max(int(along[-1] / SPACING), 2) + 1)
        centre = np.column_stack([np.interp(at, along, c) for c in pixels.T])
        depths, places = np.interp(at, along, depth), np.interp(at, along, u)
        tangent = np.gradient(centre, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        # The silhouette of a round rope is where a ray is a radius away from its axis.
        normal = np.column_stack([-tangent[:, 1], -tangent[:, 0]])
        size = self._focal_length_across(normal) * self.radius / depths
        reach = int(np.ceil(size.max() + BLENDED)) + 1
        offset = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
        column_row = np.rint(centre).astype(np.int64)[:, None] + offset  # (samples, k, 2)
        away = column_row - centre[:, None]
        beside = away[..., 1] * tangent[:, None, 0] - away[..., 0] * tangent[:, None, 1]
        ahead = np.einsum("skc,sc->sk", away, tangent)
        column, row = column_row[..., 0], column_row[..., 1]
        cover = np.clip(size[:, None] - np.abs(beside) + BLENDED, 0.0, 1.0)
        inside = (cover > 0.0) & (np.abs(ahead) <= SPACING)
        inside &= (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        inside &= depths[:, None] > self.radius
        sample, _ = np.nonzero(inside)
        flat = (row * camera.width + column)[inside]
        distance, gap = beside[inside], np.hypot(beside, ahead)[inside]
        order = np.lexsort((places[sample], flat))
        flat, sample, distance, cover = (a[order] for a in (flat, sample, distance, cover[inside]))
        new = np.ones(len(flat), dtype=np.bool_)
        new[1:] = (np.diff(flat) != 0) | (np.diff(places[sample]) > STRAND * self.radius)
        strand = np.cumsum(new) - 1
        # The first of samples that are all as far beside a pixel would lie ahead of it.
        best = np.lexsort((gap[order], strand))
        best = best[np.concatenate([[True], np.diff(strand[best]) != 0])] if len(best) else best
        flat, sample, distance, cover = (a[best] for a in (flat, sample, distance, cover))
        order = np.lexsort((-depths[sample], flat))
        flat, sample, distance, cover = (a[order] for a in (flat, sample, distance, cover))
        first = np.concatenate([[True], np.diff(flat) != 0]) if len(flat) else np.zeros(0, bool)
        start = np.maximum.accumulate(np.where(first, np.arange(len(flat)), 0))
        return Layers(
            flat, np.arange(len(flat)) - start, distance / size[sample], places[sample],
            normal[sample], depths[sample], np.asarray(cover, np.float64),
            np.interp(at, along, self._behind(line))[sample],
        )  # fmt: skip
