# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Finds pixels that look like the middle of a DLO, without knowledge of its colour.

A DLO is locally a bar: over about its own width it looks the same *along* one direction, and
different from what lies on *both* sides of it. That holds for a dark, light or coloured rope on any
board; the edge of a shadow or of a sheet of paper differs on one side only, a round hole is not the
same along any direction, and a bracket is wider than the rope.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.ridge_filter import bars, second_differences

Image = NDArray[np.uint8]

ORIENTATIONS = 12
WORKING_WIDTH = 4.6  # [px] about the width that the DLO has in the image that is searched
SMOOTHING = 0.22  # of the width, standard deviation of the blur before comparing
MOST_PIXELS = 600_000  # a larger picture is reduced a little more, for speed
FLANK = 0.95  # distance of the compared pixels beside and along the DLO, in widths
LEAST_CONTRAST = 5.0  # [grey levels] below this nothing counts as a DLO
NOISE_FACTOR = 3.5


@dataclass(frozen=True)
class RidgeMap:
    """Strength with which each pixel of an image looks like the middle of a bar of a given width.

    Args:
        strength: contrast to the weaker side less the change along [grey levels], shape (h, w).
        orientation: index of the direction along the bar, angle = index * pi / ORIENTATIONS.
        colour: the smoothed image that was searched, shape (h, w, 3).
        scale: size of a pixel of the image in pixels of this map (at most 1).
        width: width of the bar in pixels of this map.
        threshold: strength below which nothing was kept [grey levels].
        origin: pixel (x, y) of the image where the map begins.
    """

    strength: NDArray[np.float32]
    orientation: NDArray[np.int8]
    colour: Image
    scale: float
    width: float
    threshold: float
    origin: tuple[int, int] = (0, 0)

    def to_image(self, points: FloatArray) -> FloatArray:
        """Pixels of the image for points (x, y) of this map."""
        return (points + 0.5) / self.scale - 0.5 + self.origin

    def from_image(self, points: FloatArray) -> FloatArray:
        """Points of this map for pixels of the image."""
        return (points - self.origin + 0.5) * self.scale - 0.5


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


def map_ridges(
    image: Image, width: float, allowed: Image | None = None, *, tones: bool = False
) -> RidgeMap:
    """Search an image for bars of one width.

    Args:
        image: BGR, shape (h, w, 3).
        width: width of the DLO in the image [px]; bars of about 0.6 to 1.6 times that are found.
        allowed: mask of where the DLO may be, not zero there, of any size; None for everywhere.
        tones: whether the DLO may change its colour along itself.

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
    top, bottom, left, right = _part(image, allowed, math.ceil(2.0 * width))
    origin, full = (left, top), (image.shape[0], image.shape[1])
    image = image[top:bottom, left:right]
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
    angles = np.arange(ORIENTATIONS) * math.pi / ORIENTATIONS
    across = np.column_stack([np.cos(angles), -np.sin(angles)])  # (row, column)
    across = np.rint(FLANK * local * across).astype(np.int64)
    padding = 2 * int(np.max(np.abs(across)))
    channels = cv2.split(smooth)
    border = (padding, padding, padding, padding, cv2.BORDER_REPLICATE)
    planes = [cv2.copyMakeBorder(channel, *border) for channel in channels]
    strength, orientation = bars(
        np.stack(planes, dtype=np.float32),
        padding,
        _searched(allowed, channels, math.ceil(FLANK * local), threshold, reduction, origin, full),
        across,
        float(threshold),
        tones,
    )
    return RidgeMap(strength, orientation, smooth, scale, local, threshold, origin)


def _part(image: Image, allowed: Image | None, margin: int) -> tuple[int, int, int, int]:
    """Top, bottom, left and right of the part of an image where the DLO may be."""
    height, width = image.shape[:2]
    if allowed is None:
        return 0, height, 0, width
    if not allowed.any():
        raise VisionError("nothing of the picture is left where the DLO may be")
    ranges: list[int] = []
    for axis, size in ((1, height), (0, width)):
        at = np.flatnonzero(allowed.any(axis=axis))
        cell = size / allowed.shape[1 - axis]
        low = max(0, math.floor(at[0] * cell) - margin)
        ranges += [low, min(size, math.ceil((at[-1] + 1) * cell) + margin)]
    return ranges[0], ranges[1], ranges[2], ranges[3]


def _searched(
    allowed: Image | None,
    channels: Sequence[Image],
    reach: int,
    threshold: float,
    reduction: int,
    origin: tuple[int, int],
    full: tuple[int, int],
) -> Image:
    """Mask of the pixels of the map that are searched, shape (h, w).

    No two pixels around another differ by more than the span of their values, so a plain board
    falls out at once.
    """
    window = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    blue, green, red = (
        cv2.subtract(cv2.dilate(channel, window), cv2.erode(channel, window))
        for channel in channels
    )
    # The length of the span as a vector is at most its largest component times the root of 3.
    largest = cv2.max(cv2.max(blue, green), red)
    result: Image = (largest >= math.ceil(threshold / math.sqrt(3.0))).astype(np.uint8)
    if allowed is not None:
        rows, columns = (
            ((np.arange(n) + 0.5) * reduction + start) * (cells / pixels)
            for n, start, cells, pixels in zip(
                channels[0].shape, origin[::-1], allowed.shape[:2], full, strict=True
            )
        )
        cells = (allowed != 0)[rows.astype(np.int64)]  # row by row is faster than both at once
        result &= cells[:, columns.astype(np.int64)].astype(np.uint8)
    return result


def _noise(smooth: Image, width: float) -> float:
    """Standard deviation, over all channels, of the fine texture and noise left after smoothing."""
    step = max(1, round(width / 2))
    distance = second_differences(smooth[:: max(1, smooth.shape[0] // 100)], step)
    return float(1.4826 * np.median(distance) / math.sqrt(6.0))
