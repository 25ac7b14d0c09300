# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Finding a calibration pattern in an image, its corners to a few hundredths of a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.charuco import search_charuco
from dlo_ros.vision.calibration.corner_refinement import neighbours, refined, steps
from dlo_ros.vision.calibration.patterns import Charuco, Pattern
from dlo_ros.vision.segmentation.ridge_map import Image

SEARCH_SIZES = (1280, 2560)  # [px] larger side of the picture in which it is searched
ENOUGH_CORNERS = 0.8  # share of the corners with which a search is content
THOROUGH = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
LEAST_CORNERS = 8  # fewer do not determine six numbers of a pose and an error
LEAST_SPACING = 6.0  # [px] between corners
CONTINUES = 0.7  # share of the places beyond an edge that look like further corners


@dataclass(frozen=True, eq=False)
class PatternView:
    """One picture of the pattern.

    Args:
        name: name of the file, or the bag and the time.
        width, height: size of the picture [px].
        corners: numbers of the pattern's corners that were found, shape (n,).
        pixels: pixels of the corners, shape (n, 2).
        edge_width: number of pixels over which black turns into white; a sharp picture has 1 to 3.
    """

    name: str
    width: int
    height: int
    corners: NDArray[np.int64]
    pixels: FloatArray
    edge_width: float


def find_pattern(
    image: Image, pattern: Pattern, name: str = "", thorough: bool = True
) -> PatternView:
    """Find the pattern in a picture.

    Args:
        image: grey or BGR, shape (h, w) or (h, w, 3).
        pattern: a chessboard must be seen whole, a ChArUco board may be seen in part.
        name: name of the view.
        thorough: whether to try hard, which takes most time where there is nothing.

    Raises:
        VisionError: it is not there, too small, or of another size; the message says which.
    """
    colour = image.ndim == 3
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if colour else image, dtype=np.uint8)
    corners, pixels = _search(gray, pattern, thorough)
    spacing = _spacing(pattern, corners, pixels)
    if spacing < LEAST_SPACING:
        raise VisionError(f"the pattern is too small: {spacing:.1f} px between its corners")
    pixels = refined(gray, pattern, corners, pixels)
    good = np.all(np.isfinite(pixels), axis=1)
    if good.sum() < LEAST_CORNERS or _is_line(pattern.points[corners[good]]):
        raise VisionError(f"only {good.sum()} corners of the pattern are seen")
    corners, pixels = corners[good], pixels[good]
    if not isinstance(pattern, Charuco):
        _refuse_part(gray, pattern, pixels)
    height, width = gray.shape
    sharpness = _edge_width(gray, pattern, corners, pixels)
    return PatternView(name, width, height, corners, pixels, sharpness)


def board_size(image: Image) -> tuple[int, int] | None:
    """Inner corners of whatever chessboard an image shows, larger number first; None for none."""
    colour = image.ndim == 3
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if colour else image, dtype=np.uint8)
    small, _ = _scaled(gray, SEARCH_SIZES[0])
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    try:
        found, _, meta = cv2.findChessboardCornersSBWithMeta(small, (3, 3), flags)
    except cv2.error:
        return None
    if not found or meta is None or min(meta.shape[:2]) < 3:
        return None
    rows, columns = sorted(meta.shape[:2])
    return int(columns), int(rows)


def _search(gray: Image, pattern: Pattern, thorough: bool) -> tuple[NDArray[np.int64], FloatArray]:
    """Numbers and rough pixels of the corners; a small picture is searched first, it is faster."""
    reason = VisionError(f"no {pattern.kind} found")
    corners, pixels = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    for small, scale in _scales(gray):
        try:
            if isinstance(pattern, Charuco):
                numbers, places = search_charuco(small, pattern)
            else:
                numbers, places = _chessboard(small, pattern, thorough)
        except VisionError as err:
            reason = err
            continue
        if len(numbers) > len(corners):
            corners, pixels = numbers, (places + 0.5) * scale - 0.5
        if len(corners) > ENOUGH_CORNERS * len(pattern.points):
            break
    if not len(corners):
        raise reason
    return corners, pixels


def _scales(gray: Image) -> Iterator[tuple[Image, float]]:
    """Pictures to search in, each with the factor from its pixels to those of the original."""
    largest = max(gray.shape)
    for size in SEARCH_SIZES:
        yield _scaled(gray, size)
        if size >= largest:
            return


def _scaled(gray: Image, size: int) -> tuple[Image, float]:
    scale = max(gray.shape) / size
    if scale <= 1.0:
        return gray, 1.0
    shape = (round(gray.shape[1] / scale), round(gray.shape[0] / scale))
    small = cv2.resize(gray, shape, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), gray.shape[1] / shape[0]


def _chessboard(
    gray: Image, pattern: Pattern, thorough: bool
) -> tuple[NDArray[np.int64], FloatArray]:
    """All corners row by row, in the handedness of the pattern's frame."""
    grid = (pattern.columns, pattern.rows)
    for flags in (cv2.CALIB_CB_NORMALIZE_IMAGE, THOROUGH)[: 2 if thorough else 1]:
        found, pixels = cv2.findChessboardCornersSB(gray, grid, flags=flags)
        if found:
            break
    if not found:
        raise VisionError(f"no {pattern.kind} found")
    corners = np.asarray(pixels, dtype=np.float64).reshape(pattern.rows, pattern.columns, 2)
    along, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    if along[0] * down[1] - along[1] * down[0] < 0.0:
        corners = corners[::-1]
    return np.arange(len(pattern.points)), np.asarray(corners.reshape(-1, 2))


def _spacing(pattern: Pattern, corners: NDArray[np.int64], pixels: FloatArray) -> float:
    known = steps(pattern, corners, pixels)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else 0.0


def _is_line(points: FloatArray) -> bool:
    centred = points[:, :2] - points[:, :2].mean(axis=0)
    values = np.linalg.svd(centred, compute_uv=False)
    return bool(values[1] < 0.05 * values[0])


def _refuse_part(gray: Image, pattern: Pattern, pixels: FloatArray) -> None:
    """Refuse corners that are a part of a larger chessboard: its centre lies elsewhere.

    Raises:
        VisionError: the grid goes on.
    """
    if len(pixels) != pattern.columns * pattern.rows:
        return
    grid = pixels.reshape(pattern.rows, pattern.columns, 2)
    turned = grid.transpose(1, 0, 2)
    for side in (grid, grid[::-1], turned, turned[::-1]):
        beyond = 3.0 * side[0] - 3.0 * side[1] + side[2]
        across = side[0] - side[1]
        along = np.gradient(side[0], axis=0)
        if _looks_like_corners(gray, beyond, along, across) > CONTINUES:
            other = board_size(gray)
            size = f", it has {other[0]} x {other[1]} inner corners" if other else ""
            raise VisionError(
                f"the chessboard goes on beyond {pattern.columns} x {pattern.rows}{size}"
            )


def _looks_like_corners(
    gray: Image, at: FloatArray, along: FloatArray, across: FloatArray
) -> float:
    """Share of the places around which two black and two white squares meet."""
    diagonal = [0.3 * (a * along + b * across) for a, b in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
    values = np.array([_sampled(gray, at + d) for d in diagonal])
    if not np.all(np.isfinite(values)):
        return 0.0
    contrast = max(float(np.ptp(values)), 20.0)
    even, odd = values[:2], values[2:]
    same = (np.ptp(even, axis=0) < 0.35 * contrast) & (np.ptp(odd, axis=0) < 0.35 * contrast)
    apart = np.abs(even.mean(axis=0) - odd.mean(axis=0)) > 0.5 * contrast
    return float(np.mean(same & apart))


def _edge_width(
    gray: Image, pattern: Pattern, corners: NDArray[np.int64], pixels: FloatArray
) -> float:
    """Contrast over steepest slope, across the edges between neighbouring corners [px].

    The median over the edges of each direction; the larger of the two, since motion blurs one.
    """
    grid, _ = neighbours(pattern, corners, pixels)
    reach = 0.4
    if isinstance(pattern, Charuco):
        reach = 0.45 * (1.0 - pattern.marker / pattern.square)
    x0, y0 = np.floor(pixels.min(axis=0)).astype(int)
    x1, y1 = np.ceil(pixels.max(axis=0)).astype(int) + 1
    dark, bright = np.percentile(gray[max(y0, 0) : y1, max(x0, 0) : x1], [10, 90])
    widths = []
    for g in (grid, grid.transpose(1, 0, 2)):
        middle = 0.5 * (g[:, 1:] + g[:, :-1])
        along = g[:, 1:] - g[:, :-1]
        across = np.gradient(g, axis=0)
        across = 0.5 * (across[:, 1:] + across[:, :-1])
        parts = [v.reshape(-1, 2) for v in (middle, along, across)]
        keep = np.all([np.all(np.isfinite(v), axis=1) for v in parts], axis=0)
        if not keep.any():
            continue
        middle, along, across = (v[keep] for v in parts)
        length = np.linalg.norm(across, axis=1) * reach
        normal = np.column_stack([-along[:, 1], along[:, 0]])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        count = int(np.clip(np.median(length) * 4.0, 8, 200))
        s = np.linspace(-1.0, 1.0, count + 1) * np.median(length)
        places = middle[:, None] + s[:, None] * normal[:, None]
        profile = _sampled(gray, places.reshape(-1, 2)).reshape(len(middle), -1)
        slope = np.nanmax(np.abs(np.gradient(profile, s, axis=1)), axis=1)
        widths.append(float(np.median((bright - dark) / np.maximum(slope, 1e-3))))
    return max(widths, default=np.inf)


def _sampled(gray: Image, places: FloatArray) -> FloatArray:
    """Grey levels at places [px], shape (n, 2) to (n,), NaN outside the picture."""
    x, y = (np.ascontiguousarray(c, dtype=np.float32).reshape(1, -1) for c in places.T)
    value = cv2.remap(
        gray.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    height, width = gray.shape
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    return np.where(inside, value, np.nan).ravel().astype(np.float64)
