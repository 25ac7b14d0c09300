"""Finds pixels that look like the middle of a DLO, without being told its colour.

A DLO is locally a bar: over about its own width it looks the same *along* one direction, and
different from what lies on *both* sides of it. That holds for a dark, light or coloured rope on any
board; the edge of a shadow or of a sheet of paper differs on one side only, a round hole is not the
same along any direction, and a bracket is wider than the rope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray

Image = NDArray[np.uint8]

ORIENTATIONS = 12
WORKING_WIDTH = 4.6  # [px] about the width that the DLO has in the image that is searched
SMOOTHING = 0.22  # of the width, standard deviation of the blur before comparing
MOST_PIXELS = 600_000  # a larger picture is reduced a little more, for speed
FLANK = 0.95  # distance of the compared background from the middle, in widths
ALONG = 1.0  # distance of the compared pixels along the DLO, in widths
LEAST_CONTRAST = 5.0  # [grey levels] below this nothing counts as a DLO
NOISE_FACTOR = 3.5
PADDING = 8  # [px] the border is repeated by this much so that no comparison leaves the image


@dataclass(frozen=True)
class BarMap:
    """Where an image looks like the middle of a bar of a given width.

    Args:
        strength: contrast to the weaker side less the change along [grey levels], shape (h, w).
        orientation: index of the direction along the bar, angle = index * pi / ORIENTATIONS.
        colour: the smoothed image that was searched, shape (h, w, 3).
        scale: size of a pixel of the image in pixels of this map (at most 1).
        width: of the bar in pixels of this map.
        threshold: strength below which nothing was kept [grey levels].
    """

    strength: NDArray[np.float32]
    orientation: NDArray[np.int8]
    colour: Image
    scale: float
    width: float
    threshold: float

    def to_image(self, points: FloatArray) -> FloatArray:
        """Pixels of the image for points (x, y) of this map."""
        return (points + 0.5) / self.scale - 0.5

    def from_image(self, points: FloatArray) -> FloatArray:
        """Points of this map for pixels of the image."""
        return (points + 0.5) * self.scale - 0.5


def as_bgr(image: NDArray[np.uint8]) -> Image:
    """A three-channel view of a mono, BGR or BGRA image.

    Raises:
        VisionError: no image at all, or not 8 bits per channel.
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.size == 0:
        raise VisionError("the image is empty or not of 8 bits per channel")
    if image.ndim == 2:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    if image.ndim == 3 and image.shape[2] == 1:
        return np.asarray(cv2.cvtColor(image[:, :, 0], cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    if image.ndim == 3 and image.shape[2] in (3, 4):
        return image[:, :, :3]
    raise VisionError(f"the image has shape {image.shape}; (h, w) or (h, w, 3) is needed")


def bar_map(image: Image, width: float) -> BarMap:
    """Search an image for bars of one width.

    Args:
        image: BGR, shape (h, w, 3).
        width: of the DLO in the image [px]; found are bars of about 0.6 to 1.6 times that.

    Raises:
        VisionError: the DLO would be less than 1.5 px wide.
    """
    if not width >= 1.5:
        raise VisionError(
            f"the DLO would be {width:.1f} px wide; at least 1.5 px are needed (move the camera "
            "closer, or check length, diameter and the camera's pose)"
        )
    # Whole pixels are averaged: that is several times faster than a reduction by a fraction.
    reduction = max(1, int(width / WORKING_WIDTH))
    if image.shape[0] * image.shape[1] > MOST_PIXELS * reduction**2:
        reduction = max(1, round(width / WORKING_WIDTH))
    size = (image.shape[1] // reduction, image.shape[0] // reduction)
    if min(size) < 8:
        raise VisionError(f"the DLO would be {width:.0f} px wide, as large as the image")
    small = image
    if reduction > 1:
        whole = image[: size[1] * reduction, : size[0] * reduction]
        small = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    scale = 1.0 / reduction
    local = width * scale
    sigma = max(0.6, SMOOTHING * local)
    smooth = np.asarray(cv2.GaussianBlur(small, (0, 0), sigma), dtype=np.uint8)
    noise = _noise(smooth, local)
    threshold = max(LEAST_CONTRAST, NOISE_FACTOR * noise)
    padding = max(PADDING, math.ceil(1.2 * local))
    padded = cv2.copyMakeBorder(smooth, padding, padding, padding, padding, cv2.BORDER_REPLICATE)
    reach = math.ceil(FLANK * local)
    window = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    span = cv2.subtract(cv2.dilate(smooth, window), cv2.erode(smooth, window))
    angles = np.arange(ORIENTATIONS) * math.pi / ORIENTATIONS
    along = np.column_stack([np.sin(angles), np.cos(angles)]) * local  # (row, column)
    across = np.column_stack([np.cos(angles), -np.sin(angles)]) * local
    strength, orientation = _bars(
        padded,
        padding,
        np.asarray(span, dtype=np.uint8),
        np.rint(FLANK * across).astype(np.int64),
        np.rint(ALONG * along).astype(np.int64),
        float(threshold),
    )
    return BarMap(strength, orientation, smooth, scale, local, threshold)


def _noise(smooth: Image, width: float) -> float:
    """Standard deviation of the fine texture and noise that is left after smoothing."""
    step = max(1, round(width / 2))
    view = smooth[:, :, 1].astype(np.int16)
    second = 2 * view[:, step:-step:2] - view[:, : -2 * step : 2] - view[:, 2 * step :: 2]
    return float(1.4826 * np.median(np.abs(second)) / math.sqrt(6.0))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _bars(
    image: Image,
    padding: int,
    span: Image,
    across: NDArray[np.int64],
    along: NDArray[np.int64],
    threshold: float,
) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
    height = image.shape[0] - 2 * padding
    width = image.shape[1] - 2 * padding
    strength = np.zeros((height, width), dtype=np.float32)
    orientation = np.zeros((height, width), dtype=np.int8)
    least = threshold * threshold
    for row in range(height):
        y = row + padding
        for column in range(width):
            # No two pixels around differ by more than the span: a plain board ends here.
            d0 = np.int32(span[row, column, 0])
            d1 = np.int32(span[row, column, 1])
            d2 = np.int32(span[row, column, 2])
            if d0 * d0 + d1 * d1 + d2 * d2 < least:
                continue
            x = column + padding
            b = np.int32(image[y, x, 0])
            g = np.int32(image[y, x, 1])
            r = np.int32(image[y, x, 2])
            best = 0.0
            which = 0
            for k in range(across.shape[0]):
                dy, dx = across[k, 0], across[k, 1]
                d0 = np.int32(image[y + dy, x + dx, 0]) - b
                d1 = np.int32(image[y + dy, x + dx, 1]) - g
                d2 = np.int32(image[y + dy, x + dx, 2]) - r
                left = float(d0 * d0 + d1 * d1 + d2 * d2)
                if left < least:
                    continue
                d0 = np.int32(image[y - dy, x - dx, 0]) - b
                d1 = np.int32(image[y - dy, x - dx, 1]) - g
                d2 = np.int32(image[y - dy, x - dx, 2]) - r
                right = float(d0 * d0 + d1 * d1 + d2 * d2)
                if right < least:
                    continue
                value = math.sqrt(min(left, right))
                if value <= best:
                    continue
                dy, dx = along[k, 0], along[k, 1]
                d0 = np.int32(image[y + dy, x + dx, 0]) - b
                d1 = np.int32(image[y + dy, x + dx, 1]) - g
                d2 = np.int32(image[y + dy, x + dx, 2]) - r
                value -= 0.5 * math.sqrt(float(d0 * d0 + d1 * d1 + d2 * d2))
                d0 = np.int32(image[y - dy, x - dx, 0]) - b
                d1 = np.int32(image[y - dy, x - dx, 1]) - g
                d2 = np.int32(image[y - dy, x - dx, 2]) - r
                value -= 0.5 * math.sqrt(float(d0 * d0 + d1 * d1 + d2 * d2))
                if value > best:
                    best = value
                    which = k
            if best > threshold:
                strength[row, column] = best
                orientation[row, column] = which
    return strength, orientation
