# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Corners of a ChArUco board: markers say which corner is which, so that a part of it suffices."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.patterns import Charuco, marker_dictionary
from dlo_ros.vision.segmentation.ridge_map import Image

LEAST_MARKERS = 3
REACH = 2.2  # squares: markers so near carry a corner
NEAR = 1.5  # squares: markers that share a corner are nearer
FITTING = 0.4  # of a square: a marker further from its place belongs to another board
TRUSTED = 0.8  # share of the pairs of markers that must fit


def search_charuco(gray: Image, board: Charuco) -> tuple[NDArray[np.int64], FloatArray]:
    """Find the corners between markers that were read.

    Args:
        gray: shape (h, w).
        board: the board that is searched for.

    Returns:
        Numbers of the corners, shape (n,), and roughly where they are [px], shape (n, 2).

    Raises:
        VisionError: no markers, or those of a board of another size or layout; the message says
            which.
    """
    places, numbers = _markers(gray, board.dictionary)
    if len(numbers) < LEAST_MARKERS:
        raise VisionError(f"no {board.kind} found ({len(numbers)} markers)")
    # One layout shifted by a square fits most markers of the other.
    fit = _fit(board, places, numbers)
    other = replace(board, old_layout=not board.old_layout)
    if fit < TRUSTED or _fit(other, places, numbers) > fit:
        raise VisionError(_mismatch(board, places, numbers))
    known = {int(n): p for n, p in zip(numbers, places, strict=True) if n < len(board.markers)}
    corners, positions = [], []
    reach = REACH * board.square
    centres = board.markers.mean(axis=1)
    for k, point in enumerate(board.points[:, :2]):
        # Markers around it, over which the lens distorts little; one at least shares a square
        # with the corner.
        distance = {n: float(np.abs(centres[n] - point).max()) for n in known}
        near = [n for n in known if distance[n] < reach]
        if not near or min(distance[n] for n in near) > 0.75 * board.square:
            continue
        flat = np.concatenate([board.markers[n] for n in near])
        seen = np.concatenate([known[n] for n in near])
        transform = _homography(flat, seen)
        if transform is not None:
            corners.append(k)
            positions.append(_apply(transform, point[None])[0])
    if not corners:
        raise VisionError(f"no {board.kind} found (markers without corners between them)")
    return np.array(corners, dtype=np.int64), np.array(positions)


def _markers(gray: Image, dictionary: str) -> tuple[FloatArray, NDArray[np.int64]]:
    """Corners [px], shape (m, 4, 2), and numbers of the markers in a picture."""
    book = marker_dictionary(dictionary)
    aruco: Any = cv2.aruco
    if hasattr(aruco, "ArucoDetector"):
        settings = aruco.DetectorParameters()
        settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        places, numbers, _ = aruco.ArucoDetector(book, settings).detectMarkers(gray)
    else:  # OpenCV 4.6
        settings = aruco.DetectorParameters_create()
        settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        places, numbers, _ = aruco.detectMarkers(gray, book, parameters=settings)
    if numbers is None or not len(numbers):
        return np.zeros((0, 4, 2)), np.zeros(0, dtype=np.int64)
    return np.asarray(places, dtype=np.float64).reshape(-1, 4, 2), np.asarray(numbers).ravel()


def _fit(board: Charuco, places: FloatArray, numbers: NDArray[np.int64]) -> float:
    """Share of neighbouring markers that lie to each other as the board has them.

    Neighbours only, each pair with a homography of its own, since a lens bends a whole board by
    more than the difference of two layouts.
    """
    inside = numbers < len(board.markers)
    if inside.sum() < LEAST_MARKERS:
        return 0.0
    flat, seen = board.markers[numbers[inside]], places[inside]
    centres, middles = flat.mean(axis=1), seen.mean(axis=1)
    good = total = 0
    for k in range(len(flat)):
        transform = _homography(flat[k], seen[k])
        near = np.abs(centres - centres[k]).max(axis=1) < NEAR * board.square
        near[k] = False
        if transform is None or not near.any():
            continue
        size = np.linalg.norm(np.diff(seen[k], axis=0), axis=1).mean() * board.square / board.marker
        error = np.linalg.norm(_apply(transform, centres[near]) - middles[near], axis=1)
        good += int(np.sum(error < FITTING * size))
        total += int(near.sum())
    return good / total * float(inside.mean()) if total else 0.0


def _mismatch(board: Charuco, places: FloatArray, numbers: NDArray[np.int64]) -> str:
    """Reason why the markers do not fit, and the size that would."""
    words = f"its markers are not those of a {board.kind}"
    limit = 2 * (max(board.columns, board.rows) + 3)
    best, name = TRUSTED, ""
    for columns in range(2, limit):
        for rows in range(2, limit):
            for old in (False, True):
                other = replace(board, columns=columns, rows=rows, old_layout=old)
                # The last row at least is seen in part.
                last = len(other.markers) - (columns + 3) // 2
                if last <= numbers.max() < len(other.markers):
                    fit = _fit(other, places, numbers)
                    if fit > best:
                        best, name = fit, other.text
    return f"{words}; they fit --pattern {name}" if name else words


def _homography(flat: FloatArray, seen: FloatArray) -> FloatArray | None:
    transform, _ = cv2.findHomography(flat, seen)
    return None if transform is None else np.asarray(transform, dtype=np.float64)


def _apply(transform: FloatArray, points: FloatArray) -> FloatArray:
    p = np.column_stack([points, np.ones(len(points))]) @ np.asarray(transform).T
    return np.asarray(p[:, :2] / p[:, 2:])
