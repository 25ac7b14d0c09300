# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Draws centrelines into the picture they were found in."""

from __future__ import annotations

import cv2
import numpy as np

from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.segmentation.ridge_map import Image, as_bgr

Colour = tuple[int, int, int]

OBSERVED: Colour = (40, 220, 40)
PREDICTED: Colour = (230, 80, 230)
PALETTE: tuple[Colour, ...] = (
    (40, 220, 40),
    (230, 80, 230),
    (0, 190, 255),
    (255, 160, 40),
    (60, 60, 240),
    (220, 220, 0),
)
DASH = 12.0  # [line widths] length of a dash and its gap together
SHIFT = 4  # binary digits of the sub-pixel positions that are drawn


def draw_curve(
    image: Image,
    pixels: FloatArray,
    colour: Colour,
    seen: Mask | None = None,
    thickness: int | None = None,
) -> None:
    """Draw a curve in place; parts that were not seen are dashed, the start is a ring.

    Args:
        image: BGR.
        pixels: shape (m, 2); points that are not finite are left out.
        colour: BGR.
        seen: shape (m,).
        thickness: [px]; default after the picture's size.
    """
    if thickness is None:
        thickness = max(1, round(max(image.shape[:2]) / 700))
    finite = np.all(np.isfinite(pixels), axis=1) & np.all(np.abs(pixels) < 30000, axis=1)
    s = np.concatenate(
        [[0.0], np.cumsum(np.nan_to_num(np.hypot(*np.diff(pixels, axis=0).T), nan=0.0))]
    )
    dashed = (s % (DASH * thickness)) < 0.5 * DASH * thickness
    shown = finite if seen is None else finite & (seen | dashed)
    fixed = np.rint(np.where(finite[:, None], pixels, 0.0) * (1 << SHIFT)).astype(np.int32)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], shown.astype(int), [0]])))
    runs = [fixed[a:b] for a, b in edges.reshape(-1, 2) if b - a > 1]
    if runs:
        cv2.polylines(image, runs, False, colour, thickness, cv2.LINE_AA, SHIFT)
    if len(pixels) and finite[0]:
        x, y = int(fixed[0, 0]), int(fixed[0, 1])
        cv2.circle(image, (x, y), (4 * thickness) << SHIFT, colour, thickness, cv2.LINE_AA, SHIFT)


def spline_pixels(control_points: FloatArray, length: float, camera: Camera) -> FloatArray:
    """Pixels along a spline in the board frame, shape (300, 2).

    Args:
        control_points: shape (n, 3) or (n, 4), x y z first [m].
        length: L [m].
        camera: camera of the picture.
    """
    basis = SplineBasis(len(control_points), length)
    u = np.linspace(0.0, length, 300)
    return camera.project(basis.evaluate(control_points[:, :3], u))


def draw_overlay(
    image: Image,
    camera: Camera,
    length: float,
    result: VisionResult | None,
    predicted: FloatArray | None = None,
    message: str = "",
) -> Image:
    """The picture with the observed and, where known, the predicted spline.

    Args:
        image: BGR or mono.
        camera: camera of the picture.
        length: length of the DLO, L [m].
        result: observation; None where the DLO was not found.
        predicted: control points of the simulated DLO at that instant, shape (n, 3 or 4).
        message: one line of text that is written into the picture, such as the reason why nothing
            was found.

    Returns:
        A new BGR image.
    """
    canvas = as_bgr(image).copy()
    if predicted is not None:
        draw_curve(canvas, spline_pixels(predicted, length, camera), PREDICTED)
    if result is not None:
        control_points = result.observation.control_points
        pixels = spline_pixels(control_points, length, camera)
        at = np.linspace(0.0, 1.0, len(pixels))
        known = np.linspace(0.0, 1.0, len(result.pixels_seen))
        seen = np.interp(at, known, result.pixels_seen.astype(float)) > 0.5
        draw_curve(canvas, pixels, OBSERVED, np.asarray(seen, dtype=np.bool_))
    if message:
        write_message(canvas, message)
    return canvas


def write_message(image: Image, message: str) -> None:
    """Write a line into the upper left corner, in place."""
    size = max(0.4, max(image.shape[:2]) / 1600)
    thick = max(1, round(2 * size))
    where = (round(12 * size), round(32 * size))
    for colour, width in (((0, 0, 0), 3 * thick), ((255, 255, 255), thick)):
        cv2.putText(
            image, message, where, cv2.FONT_HERSHEY_SIMPLEX, size, colour, width, cv2.LINE_AA
        )
