# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rendered pictures of a rope of known shape, for the tests of the vision stage."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import cv2
import numpy as np
from scipy.spatial import cKDTree

from dlo_ros.command import Command, Motion
from dlo_ros.parameters import CameraPose, RodParameters, Settings
from dlo_ros.vision import Camera

LENGTH = 0.4


def curve_from_curvature(curvature, start=(0.0, 0.0), angle=0.0, length=LENGTH, count=2001):
    """Inextensible curve (x, z) with a curvature given over u / L, shape (count, 2)."""
    u = np.linspace(0.0, 1.0, count)
    k = curvature(u) if callable(curvature) else np.full(count, float(curvature))
    step = length / (count - 1)
    theta = angle + np.concatenate([[0.0], np.cumsum(0.5 * (k[1:] + k[:-1]))]) * step
    middle = 0.5 * (theta[1:] + theta[:-1])
    xz = np.zeros((count, 2))
    xz[1:, 0] = np.cumsum(np.cos(middle)) * step
    xz[1:, 1] = np.cumsum(np.sin(middle)) * step
    return xz + np.asarray(start)


def bow(sag=1.0, length=LENGTH):
    """A curve like that of a rope between two clamps."""
    return curve_from_curvature(
        lambda u: (9.0 * sag * np.sin(np.pi * u) + 5.0 * np.sin(3 * np.pi * u)) * 0.4 / length,
        start=(-0.15 * length / 0.4, 0.05 * length / 0.4),
        angle=-1.25,
        length=length,
    )


def loop():
    """A curve that crosses itself once at a steep angle."""
    return curve_from_curvature(
        lambda u: 8.5 * np.exp(-(((u - 0.5) / 0.22) ** 2)) * 4.4, start=(-0.13, -0.05), angle=0.4
    )


@dataclass
class Scene:
    """Everything about a picture but the curve."""

    width_px: float = 10.0
    size: tuple[int, int] = (960, 540)
    rope: tuple[int, int, int] = (40, 45, 50)
    board: tuple[int, int, int] = (205, 210, 208)
    diameter: float = 0.004
    distortion: tuple[float, ...] = (-0.12, 0.05, 0.0008, -0.0005, 0.0)
    tilt: float = 0.12
    blur: float = 0.7
    noise: float = 2.0
    holes: float = 0.0  # pitch of the holes [m], 0 for none
    hole_tone: tuple[int, int, int] = (45, 48, 52)
    hole_at: tuple[float, float] = (0.0011, 0.0011)  # one hole's place on the board [m]
    hole_radius: float = 0.7  # [widths]
    texture: float = 0.0
    shade: float = 0.0  # darker to one side, grey levels
    gradient: float = 0.0  # light across the picture, grey levels
    jpeg: int = 0
    seed: int = 0
    curve_centre: tuple[float, float] = (0.0, 0.0)
    second: tuple[int, int, int] | None = None  # other tone of a rope of two
    pitch: float = 0.0  # of its twist [widths]; 0: the tones lie side by side all along
    highlight: float = 0.0  # bright line along the rope, grey levels
    cast: float = 0.0  # shadow that the rope casts beside itself, share of the light
    painted: np.ndarray | None = None  # a board of one's own, (h, w, 3)
    extra: list = field(default_factory=list)

    def camera(self) -> Camera:
        distance = 0.8
        focal = self.width_px * distance / self.diameter
        half = 0.25 * np.pi + 0.5 * self.tilt
        pose = CameraPose(
            (0.0, 0.0, distance), (float(np.sin(half)), 0.0, 0.0, float(np.cos(half)))
        )
        w, h = self.size
        k = np.array([[focal, 0, w / 2 - 0.5], [0, focal * 1.01, h / 2 + 3.0], [0, 0, 1]])
        return Camera(k, self.distortion, w, h, pose)


def to_board(xz):
    return np.column_stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]])


def paint_rope(canvas, camera, xz, scene, colour):
    """Draw one strand after the other in place: later parts lie above earlier ones."""
    pixels = camera.project(to_board(xz))
    width = scene.width_px
    u = np.linspace(0.0, 1.0, len(xz))
    pieces = 12
    bounds = np.linspace(0, len(xz) - 1, pieces + 1).astype(int)
    for piece, (a, b) in enumerate(pairwise(bounds)):
        p = pixels[a : b + 1]
        dense_u = np.linspace(0, 1, max(50, int(8 * np.sum(np.hypot(*np.diff(p, axis=0).T)))))
        at = np.linspace(0, 1, len(p))
        dense = np.column_stack([np.interp(dense_u, at, p[:, 0]), np.interp(dense_u, at, p[:, 1])])
        low = np.maximum(np.floor(dense.min(axis=0) - width).astype(int), 0)
        high = np.minimum(np.ceil(dense.max(axis=0) + width).astype(int) + 1, scene.size)
        if np.any(high <= low):
            continue
        gx, gy = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        mask = np.zeros(gx.shape, np.uint8)
        shifted = np.int32(np.round((dense - low) * 8))
        cv2.polylines(mask, [shifted], False, 255, int(width * 1.6) + 6, shift=3)
        yy, xx = np.nonzero(mask)
        if len(xx) == 0:
            continue
        q = np.column_stack([gx[yy, xx], gy[yy, xx]]).astype(float)
        distance, nearest = cKDTree(dense).query(q)
        tangent = np.gradient(dense, axis=0)[nearest]
        tangent /= np.hypot(*tangent.T)[:, None]
        offset = q - dense[nearest]
        side = tangent[:, 0] * offset[:, 1] - tangent[:, 1] * offset[:, 0]
        axial = np.sum(tangent * offset, axis=1)
        scale = camera.metres_per_pixel(dense[:: max(1, len(dense) // 30)])
        local = scene.diameter / np.interp(nearest, np.linspace(0, len(dense), len(scale)), scale)
        cover = np.clip(0.5 * local - np.abs(side) + 0.5, 0.0, 1.0)
        if piece in (0, pieces - 1):
            cover *= np.clip(1.0 - np.abs(axial), 0.0, 1.0)
        cover = np.where(distance > np.hypot(0.5 * local, 0.6) + 1.0, 0.0, cover)
        s = (u[a] + (u[b] - u[a]) * nearest / len(dense)) * LENGTH / scene.diameter
        tone = scene.texture * np.sin(2 * np.pi * (1.3 * s + side / local))
        tone += scene.shade * side / local
        if scene.highlight:
            tone += scene.highlight * np.exp(-(((side / local + 0.15) / 0.12) ** 2))
        value = np.asarray(colour, float) + tone[:, None]
        if scene.second is not None and tuple(colour) == tuple(scene.rope):
            wave = np.sin(2 * np.pi * (s / scene.pitch + 0.3 * side / local)) if scene.pitch else 1
            part = np.clip(0.5 + 4.0 * (wave if scene.pitch else side / local), 0.0, 1.0)[:, None]
            value += part * (np.asarray(scene.second, float) - np.asarray(colour, float))
        at_pixel = (gy[yy, xx], gx[yy, xx])
        canvas[at_pixel] += cover[:, None] * (value - canvas[at_pixel])


def ground(scene, camera):
    w, h = scene.size
    canvas = np.ones((h, w, 3)) * np.asarray(scene.board, float)
    if scene.painted is not None:
        canvas = scene.painted.astype(float)
    if scene.gradient:
        canvas += scene.gradient * (np.linspace(-0.5, 0.5, w)[None, :, None])
    if scene.holes:
        n = int(0.4 / scene.holes)
        x, z = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
        centres = camera.project(
            to_board(np.column_stack([x.ravel(), z.ravel()]) * scene.holes + scene.hole_at)
        )
        radius = scene.hole_radius * scene.width_px
        big = canvas.astype(np.float32)
        for c in centres:
            if -radius < c[0] < w + radius and -radius < c[1] < h + radius:
                centre = (round(c[0] * 16), round(c[1] * 16))
                cv2.circle(big, centre, int(radius * 16), scene.hole_tone, -1, cv2.LINE_AA, 4)
        canvas = big.astype(float)
    return canvas


def render(xz, scene):
    """The picture of a curve, uint8 BGR."""
    camera = scene.camera()
    rng = np.random.default_rng(scene.seed)
    canvas = ground(scene, camera)
    for action in scene.extra:
        if action[0] == "patch":  # on the board, in pixels
            _, x0, y0, x1, y1, colour = action
            canvas[y0:y1, x0:x1] = colour
        elif action[0] == "below":
            paint_rope(canvas, camera, action[1], scene, action[2])
    if xz is not None and scene.cast:
        light = np.ones_like(canvas)
        plain = replace(scene, texture=0.0, shade=0.0, second=None, highlight=0.0)
        paint_rope(light, camera, xz, plain, (1.0 - scene.cast,) * 3)
        light = cv2.GaussianBlur(light, (0, 0), 0.25 * scene.width_px)
        away = round(0.5 * scene.width_px)
        canvas *= np.roll(light, (away, away), (0, 1))
    if xz is not None:
        paint_rope(canvas, camera, xz, scene, scene.rope)
    for action in scene.extra:
        if action[0] == "box":  # an occluder in pixels
            _, x0, y0, x1, y1, colour = action
            canvas[y0:y1, x0:x1] = colour
        elif action[0] == "above":
            paint_rope(canvas, camera, action[1], scene, action[2])
        elif action[0] == "shadow":
            canvas[:, action[1] :] *= action[2]
    if scene.blur:
        canvas = cv2.GaussianBlur(canvas, (0, 0), scene.blur)
    canvas = canvas + rng.normal(0.0, scene.noise, canvas.shape)
    image = np.clip(np.rint(canvas), 0, 255).astype(np.uint8)
    if scene.jpeg:
        image = cv2.imdecode(cv2.imencode(".jpg", image, [1, scene.jpeg])[1], cv2.IMREAD_COLOR)
    return image


def settings(scene, control_points=12, length=LENGTH):
    rod = RodParameters(length, scene.diameter, 1e6, 2000.0, control_points=control_points)
    return Settings(rod, camera=scene.camera().pose)


def clamps(xz, control_points=12, names=("start", "end")):
    """The motion that holds both ends of a curve."""
    tangents = [xz[1] - xz[0], xz[-1] - xz[-2]]
    where = {"start": 0, "end": 1}
    positions, rotations = [], []
    for name in names:
        k = where[name]
        p = xz[0] if k == 0 else xz[-1]
        angle = -np.arctan2(tangents[k][1], tangents[k][0])  # about y: x turns towards -z
        positions.append([p[0], 0.0, p[1]])
        rotations.append([0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)])
    motion = Motion()
    motion.add(
        Command(
            0,
            tuple(names),
            np.array([0.0]),
            np.array([positions]),
            np.array([rotations]),
            np.full((1, len(names), 3), np.nan),
            control_points,
        )
    )
    return motion


def across_errors(points, xz):
    """Distance of points (x, z) across the true curve, signed, and the true u / L of each."""
    tree = cKDTree(xz)
    _, nearest = tree.query(points)
    tangent = np.gradient(xz, axis=0)[nearest]
    tangent /= np.hypot(*tangent.T)[:, None]
    offset = points - xz[nearest]
    side = tangent[:, 0] * offset[:, 1] - tangent[:, 1] * offset[:, 0]
    return side, nearest / (len(xz) - 1)
