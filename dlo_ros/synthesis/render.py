# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Draws what a camera would see of a rope in front of a pre-drilled polystyrene board.

The rope's axis lies in the board frame's plane y = 0, the board's surface one radius behind it.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.picture_settings import Colour, Look
from dlo_ros.synthesis.render_kernels import Float32Array, trace

Image = NDArray[np.uint8]

INFINITE = 1e6
LIGHT = np.array([-0.45, 0.5, 0.74])  # towards the light: left, up, out of the board
SHADOW_SHIFT = np.array([0.45, -0.5])  # of the rope's shadow on the board, in radii
SHADOW_REACH = 2.6  # half width of the soft shadow, in radii
NOISE_TILE = 256  # [px] by which the stored noise exceeds the image, so that it can be shifted


def _bgr(colour: Colour) -> NDArray[np.float32]:
    return np.array(colour[::-1], dtype=np.float32)


def _pixel_size(plane: NDArray[np.floating[Any]]) -> float:
    """Size of a pixel in the middle of an image (root of its area) [m].

    Args:
        plane: x and z of a plane at each pixel [m], shape (H, W, 2).
    """
    row, column = plane.shape[0] // 2, plane.shape[1] // 2
    here = plane[row, column]
    right, below = plane[row, column + 1] - here, plane[row + 1, column] - here
    return float(np.sqrt(np.abs(right[0] * below[1] - right[1] * below[0])))


class Renderer:
    """Draws frames of one scene; the same seed gives the same pictures.

    Args:
        geometry: camera and pose.
        look: appearance of board and rope.
        diameter: diameter of the rope [m].
        seed: seed of texture and noise.
        behind: y of the board's surface [m]; None: one radius behind the plane y = 0.
    """

    def __init__(
        self,
        geometry: Geometry,
        look: Look,
        diameter: float,
        seed: int,
        behind: float | None = None,
    ) -> None:
        self.geometry = geometry
        self.look = look
        self.radius = 0.5 * diameter
        self._rng = np.random.default_rng(seed)
        rays = geometry.rays()
        self._plane: Float32Array = geometry.on_plane(rays, 0.0).astype(np.float32)
        surface = geometry.on_plane(rays, self.radius if behind is None else behind)
        self._pixel = _pixel_size(self._plane if behind is None else surface)
        self.light = self._lighting()
        self.board = self._board(surface) * self.light[..., None]
        self._background = np.clip(self._blurred(self.board), 0, 255).astype(np.uint8)
        camera = geometry.camera
        shape = (camera.height + NOISE_TILE, camera.width + NOISE_TILE, 3)
        noise = self._rng.standard_normal(shape, dtype=np.float32) * np.float32(camera.noise)
        self._noise = np.clip(np.rint(noise), -127, 127).astype(np.int8)
        self._fibres = self._rng.standard_normal((64, 1024), dtype=np.float32)

    def frame(self, lines: list[FloatArray], u: FloatArray, held: FloatArray) -> Image:
        """One picture.

        Args:
            lines: the axis in the board frame [m], each of shape (m, 3), at instants spread over
                the exposure; one instant gives a picture without motion blur.
            u: material coordinates of its points [m], shape (m,), growing from 0 to L.
            held: material coordinates [m] where a pin holds the rope, shape (k,).

        Returns:
            BGR image, shape (H, W, 3).
        """
        picture = self._background.copy()
        projected = [self.geometry.project(line) for line in lines]
        region = self._region(np.vstack(projected))
        if region is not None:
            layers = [
                self._with_rope(line[:, [0, 2]], pixels, u, held, region)
                for line, pixels in zip(lines, projected, strict=True)
            ]
            mean = layers[0] if len(layers) == 1 else np.mean(layers, axis=0)
            picture[region] = np.clip(self._blurred(mean), 0, 255).astype(np.uint8)
        return self._noisy(picture)

    def finished(self, picture: Float32Array) -> Image:
        """A sharp picture (H, W, 3) with the lens's blur and the sensor's noise."""
        return self._noisy(np.clip(self._blurred(picture), 0, 255).astype(np.uint8))

    def spacing(self, length: float) -> FloatArray:
        """Material coordinates [m] that sample a rope of a length [m] closely enough to draw it."""
        return np.linspace(0.0, length, max(int(0.5 * length / self._pixel), 50) + 1)

    def encode(self, picture: Image) -> bytes:
        """The picture as a JPEG file."""
        quality = [cv2.IMWRITE_JPEG_QUALITY, self.geometry.camera.jpeg_quality]
        _, data = cv2.imencode(".jpg", picture, quality)
        return bytes(data)

    def _blurred(self, picture: Float32Array) -> Float32Array:
        sigma = self.geometry.camera.blur
        if sigma == 0.0:
            return picture
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma), dtype=np.float32)

    def _noisy(self, picture: Image) -> Image:
        top, left = self._rng.integers(0, NOISE_TILE, 2)
        height, width = picture.shape[:2]
        noise = self._noise[top : top + height, left : left + width]
        return np.asarray(cv2.add(picture, noise, dtype=cv2.CV_8U), dtype=np.uint8)

    def _lighting(self) -> Float32Array:
        """Factor on brightness: a lamp somewhere, and darker corners."""
        camera = self.geometry.camera
        x = np.linspace(-1.0, 1.0, camera.width, dtype=np.float32)[None, :]
        y = np.linspace(-1.0, 1.0, camera.height, dtype=np.float32)[:, None]
        cx, cy = self._rng.uniform(-0.5, 0.5, 2)
        squared = (x - np.float32(cx)) ** 2 + (y - np.float32(cy)) ** 2
        fall = squared / squared.max()
        return np.asarray(1.0 - self.look.unevenness * fall, dtype=np.float32)

    def _board(self, plane: FloatArray) -> Float32Array:
        """Extruded polystyrene with its grid of holes at x, z of each pixel, shape (H, W, 3)."""
        look = self.look
        shape = plane.shape[:2]
        # Extrusion leaves faint streaks along x beside an irregular grain.
        small = (shape[0] // 2 + 1, shape[1] // 2 + 1)
        coarse = cv2.GaussianBlur(self._rng.standard_normal(small, dtype=np.float32), (0, 0), 2.0)
        grain = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC) * np.float32(5.0)
        rows = self._rng.standard_normal(4096).astype(np.float32)
        streaks = np.interp(plane[..., 1] / 1.5e-3, np.arange(-2048, 2048), rows)
        tone = look.grain * (0.8 * grain + 0.6 * streaks)
        board = _bgr(look.board_colour) + tone.astype(np.float32)[..., None]
        if look.hole_diameter > 0.0:
            pitch, radius = look.hole_pitch, 0.5 * look.hole_diameter
            offset = plane - pitch * np.rint(plane / pitch)
            distance = np.hypot(offset[..., 0], offset[..., 1])
            cover = np.clip((radius - distance) / self._pixel + 0.5, 0.0, 1.0)
            # The wall that faces the light is lit, the opposite one lies in shadow.
            lit = (offset @ np.array([0.67, -0.74])) / radius
            depth = np.clip(0.42 + 0.16 * lit, 0.2, 0.7)
            board *= (1.0 - cover * (1.0 - depth)).astype(np.float32)[..., None]
        return np.asarray(board, dtype=np.float32)

    def _region(self, pixels: FloatArray) -> tuple[slice, slice] | None:
        """Rows and columns around the rope, None where it is out of sight."""
        camera = self.geometry.camera
        margin = int(4.0 * SHADOW_REACH * self.radius / self._pixel + 4.0 * camera.blur) + 8
        low = np.floor(pixels.min(axis=0)).astype(int) - margin
        high = np.ceil(pixels.max(axis=0)).astype(int) + margin
        columns = slice(max(low[0], 0), min(high[0], camera.width))
        rows = slice(max(low[1], 0), min(high[1], camera.height))
        if columns.start >= columns.stop or rows.start >= rows.stop:
            return None
        return rows, columns

    def _with_rope(
        self,
        line: FloatArray,
        pixels: FloatArray,
        u: FloatArray,
        held: FloatArray,
        region: tuple[slice, slice],
    ) -> Float32Array:
        """The board's region with the rope, its shadow and the pins, before the lens's blur."""
        picture = self.board[region].copy()
        plane = np.ascontiguousarray(self._plane[region])
        shape = picture.shape[:2]
        across = np.full(shape, INFINITE, dtype=np.float32)
        along = np.full(shape, -INFINITE, dtype=np.float32)
        segment = np.zeros(shape, dtype=np.int32)
        reach = (SHADOW_REACH + 1.0) * self.radius
        corner = np.array([region[1].start, region[0].start])
        margin = 1.25 * reach / self._pixel + 2.0
        trace(
            line, pixels, u, self.geometry.eye, plane, corner, reach, margin,
            self.radius, across, along, segment,
        )  # fmt: skip
        near = np.nonzero(across < INFINITE)
        s = across[near].astype(np.float64) / self.radius
        v = along[near].astype(np.float64)
        tangent = np.diff(line, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])[segment[near]]
        light = self.light[region][near][:, None]
        beyond = np.maximum(-v, v - u[-1]) / self._pixel
        end = np.clip(0.5 - beyond, 0.0, 1.0)
        cover = np.clip((1.0 - np.abs(s)) * (self.radius / self._pixel) + 0.5, 0.0, 1.0) * end
        distance = np.hypot(s - normal @ SHADOW_SHIFT, np.maximum(beyond, 0.0) / 4.0)
        shade = 1.0 - self.look.shadow * np.clip(1.0 - distance / SHADOW_REACH, 0.0, 1.0) ** 1.5
        board = picture[near] * shade[:, None]
        rope = self.rope_colour(s, v, normal) * light
        picture[near] = board + cover[:, None] * (rope - board)
        self._draw_pins(picture, plane, corner, line, pixels, u, held, self.light[region])
        return picture

    def rope_colour(self, s: FloatArray, v: FloatArray, normal: FloatArray) -> FloatArray:
        """Colour of a twisted rope at s radii across and v [m] along its axis, shape (m, 3)."""
        look = self.look
        angle = np.arcsin(np.clip(s, -1.0, 1.0))
        towards = np.cos(angle) * LIGHT[2] + np.sin(angle) * (normal @ LIGHT[:2])
        shade = 0.42 + 0.62 * np.maximum(towards, 0.0)
        if look.strand_pitch > 0.0:
            turn = 2.0 * np.pi * v / (look.strand_pitch * 2.0 * self.radius)
            groove = 0.5 + 0.5 * np.cos(3.0 * (turn - angle))
            shade = shade * (1.0 - look.strand_contrast * groove**3)
            row = ((turn - angle) * 32.0 / np.pi).astype(np.int64) % 64
            column = (v / (0.15 * self.radius)).astype(np.int64) % 1024
            shade = shade * (1.0 + 0.06 * self._fibres[row, column])
        shine = np.maximum(towards, 0.0) ** 12 * 16.0
        return np.asarray(_bgr(look.rope_colour) * shade[:, None] + shine[:, None])

    def _draw_pins(
        self,
        picture: Float32Array,
        plane: Float32Array,
        corner: NDArray[np.int64],
        line: FloatArray,
        pixels: FloatArray,
        u: FloatArray,
        held: FloatArray,
        light: Float32Array,
    ) -> None:
        """Heads of the pins that hold the rope, in place."""
        radius = self.look.pin_diameter * self.radius
        if radius == 0.0:
            return
        half = int(2.0 * radius / self._pixel) + 4
        for place in held:
            centre = np.array([np.interp(place, u, line[:, c]) for c in range(2)])
            column, row = (
                round(float(np.interp(place, u, pixels[:, c]))) - int(corner[c]) for c in range(2)
            )
            patch = (
                slice(max(row - half, 0), max(row + half, 0)),
                slice(max(column - half, 0), max(column + half, 0)),
            )
            d = plane[patch] - centre
            distance = np.hypot(d[..., 0], d[..., 1])
            cover = np.clip((radius - distance) / self._pixel + 0.5, 0.0, 1.0)[..., None]
            shade = (0.85 + 0.3 * (d @ LIGHT[:2]) / radius) * light[patch]
            picture[patch] += cover * (
                _bgr(self.look.pin_colour) * shade[..., None] - picture[patch]
            )
