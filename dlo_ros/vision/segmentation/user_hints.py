# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The user's knowledge of where the DLO is in the picture: a region, its colour, masks, the board.

All of it is optional. It narrows what is searched, and what lies outside of it counts as not seen.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import InputError, VisionError
from dlo_ros.parameters import VisionParameters
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.ridge_map import Image

LEAST_DIFFERENCE = 12.0  # [grey levels] from the empty board
NOISE_FACTOR = 6.0  # times the usual difference: what differs by more lies on the board
SAMPLE = 7  # every so many pixels are looked at for the usual difference
GROWN = 0.3  # [widths] by which masks are grown: the DLO's edges are blurred


class Hints:
    """Makes masks of the user's hints.

    Args:
        parameters: the block `vision` of the parameter file.

    Raises:
        InputError: an image that is named there cannot be read.
    """

    def __init__(self, parameters: VisionParameters) -> None:
        self._low = np.array(parameters.colour_low)
        self._high = np.array(parameters.colour_high)
        self._region = parameters.region
        self._fixed = _mask_in(parameters.mask)
        self._board = _read(parameters.empty_board, "vision.empty_board", cv2.IMREAD_COLOR)
        self._has_colour = bool(np.any(self._low > 0.0) or np.any(self._high < [180, 255, 255]))
        self.mask: Image | None = None

    def check_size(self, width: int, height: int) -> None:
        """Refuse image files of another size than the camera's images, width by height [px].

        Raises:
            InputError: names the parameter and both sizes.
        """
        for given, name in ((self._fixed, "vision.mask"), (self._board, "vision.empty_board")):
            if given is not None:
                _checked(given, (width, height), name)

    def allowed(self, image: Image, width: float) -> Image | None:
        """Mask of where the DLO may be in an image, not zero there, shape (h, w); None for
        everywhere.

        Args:
            image: BGR, shape (h, w, 3).
            width: width of the DLO [px].

        Raises:
            InputError: a mask or the empty board has another size than the image.
        """
        size = (image.shape[1], image.shape[0])
        masks: list[Image] = []
        for given, name in ((self._fixed, "vision.mask"), (self.mask, "the mask")):
            if given is not None:
                masks.append((_checked(given, size, name) > 0).astype(np.uint8))
        if self._has_colour:
            masks.append(self._coloured(image))
        if self._board is not None:
            masks.append(_differing(image, _checked(self._board, size, "vision.empty_board")))
        if masks:
            mask = masks[0]
            for other in masks[1:]:
                mask = mask & other
            reach = max(1, round(GROWN * width))
            window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
            masks = [np.asarray(cv2.dilate(mask, window), dtype=np.uint8)]
        x, y, wide, high = self._region
        if wide > 0.0 and high > 0.0:
            part = np.zeros(image.shape[:2], dtype=np.uint8)
            part[round(y) : round(y + high), round(x) : round(x + wide)] = 1
            masks = [masks[0] & part] if masks else [part]
        return masks[0] if masks else None

    def searched(self, image: Image, width: float) -> Image | None:
        """Pixels in which the DLO is looked for: those of `allowed`, of which there must be some.

        Raises:
            InputError: a mask or the empty board has another size than the image.
            VisionError: nothing is left; with the names of the hints.
        """
        allowed = self.allowed(image, width)
        if allowed is None or allowed.any():
            return allowed
        given = {
            "vision.region": min(self._region[2:]) > 0.0,
            "vision.mask": self._fixed is not None,
            "the mask": self.mask is not None,
            "vision.colour_low, vision.colour_high": self._has_colour,
            "vision.empty_board": self._board is not None,
        }
        names = " and ".join(name for name, there in given.items() if there)
        raise VisionError(f"{names}: nothing of the picture is left where the DLO may be")

    def _coloured(self, image: Image) -> Image:
        """Pixels within the colour range; a range of hues may pass over red (low > high)."""
        hsv = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2HSV))
        if self._low[0] <= self._high[0]:
            inside = cv2.inRange(hsv, self._low, self._high)
        else:
            inside = cv2.inRange(hsv, self._low, np.array([180.0, *self._high[1:]]))
            inside |= cv2.inRange(hsv, np.array([0.0, *self._low[1:]]), self._high)
        return np.asarray(inside > 0, dtype=np.uint8)


def limited(located: Located, allowed: Image | None) -> Located:
    """The DLO as located, unseen where it cannot be."""
    if allowed is None:
        return located
    height, width = allowed.shape
    x, y = np.rint(located.points.T).astype(np.int64)
    good = (allowed[y.clip(0, height - 1), x.clip(0, width - 1)] != 0) & (
        (x >= 0) & (y >= 0) & (x < width) & (y < height)
    )
    likeness = np.where(good, located.likeness, 0.0)
    return replace(located, seen=located.seen & good, likeness=likeness, excluded=~good)


def _mask_in(name: str) -> Image | None:
    """Mask of an image file, 1 where it is not black; labels of 16 bits may be small numbers."""
    picture = _read(name, "vision.mask", cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if picture is not None and not picture.any():
        raise InputError(
            f"vision.mask is '{name}', which is black all over; it must be white, or not zero, "
            "where the DLO may be"
        )
    return None if picture is None else np.asarray(picture > 0, dtype=np.uint8)


def _read(name: str, parameter: str, flags: int) -> NDArray[Any] | None:
    if not name:
        return None
    path = Path(name).expanduser()
    picture = cv2.imread(str(path), flags) if path.is_file() else None
    if picture is None:
        raise InputError(f"{parameter} is '{name}'; it must be an image file that can be read")
    return np.asarray(picture)


def _checked(picture: Image, size: tuple[int, int], name: str) -> Image:
    if picture.shape[1::-1] != size:
        raise InputError(
            f"{name} is {picture.shape[1]} x {picture.shape[0]} px, the image "
            f"{size[0]} x {size[1]}; both must have the same size"
        )
    return picture


def _differing(image: Image, board: Image) -> Image:
    """Mask of where an image differs from the empty board, light that changed as a whole left
    aside.
    """
    some = (slice(None, None, SAMPLE), slice(None, None, SAMPLE))
    gain = np.median((image[some] + 1.0) / (board[some] + 1.0), axis=(0, 1))
    expected = np.clip(board * gain, 0, 255).astype(np.uint8)
    difference = np.asarray(cv2.absdiff(image, expected)).max(axis=2)
    difference = np.asarray(cv2.blur(difference, (3, 3)), dtype=np.uint8)
    usual = 1.4826 * float(np.median(difference[some]))
    return np.asarray(difference > max(LEAST_DIFFERENCE, NOISE_FACTOR * usual), dtype=np.uint8)
