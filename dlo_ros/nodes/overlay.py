"""The image with the fitted and the predicted curve drawn in (no ROS here)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.recordings.images import Image
from dlo_ros.spline import FloatArray

OBSERVED = (90, 220, 60)
PREDICTED = (0, 128, 255)
DASH = 6
"""Length of a dash, in points of the curve, where the DLO was not seen."""


def draw(
    image: Image,
    observed: FloatArray,
    seen: NDArray[np.bool_],
    predicted: FloatArray | None = None,
) -> Image:
    """A copy of the image with curves in it.

    Args:
        image: BGR or grey, shape (h, w, 3) or (h, w).
        observed: fitted centreline [px], shape (m, 2).
        seen: which of its points were seen; elsewhere it is drawn dashed, shape (m,).
        predicted: predicted centreline [px], shape (k, 2).

    Returns:
        BGR, shape (h, w, 3).
    """
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    width = max(1, round(min(picture.shape[:2]) / 400))
    if predicted is not None:
        _polyline(picture, predicted, np.ones(len(predicted), dtype=bool), PREDICTED, width)
    dashed = (np.arange(len(observed)) // DASH) % 2 == 0
    _polyline(picture, observed, seen | dashed, OBSERVED, width)
    if len(observed) and np.all(np.isfinite(observed[0])):
        cv2.circle(picture, _pixel(observed[0]), 4 * width, OBSERVED, width, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)


def _polyline(
    picture: Image,
    curve: FloatArray,
    shown: NDArray[np.bool_],
    colour: tuple[int, int, int],
    width: int,
) -> None:
    limit = 4.0 * max(picture.shape[:2])
    usable = shown & np.all(np.isfinite(curve), axis=1) & np.all(np.abs(curve) < limit, axis=1)
    for i in range(len(curve) - 1):
        if usable[i] and usable[i + 1]:
            cv2.line(picture, _pixel(curve[i]), _pixel(curve[i + 1]), colour, width, cv2.LINE_AA)


def _pixel(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
