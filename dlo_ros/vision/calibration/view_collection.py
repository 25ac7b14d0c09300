# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Collection of views: finds the pattern in one picture after the other and keeps new views."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np

from dlo_ros.errors import InputError, VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.pattern_search import PatternView, board_size, find_pattern
from dlo_ros.vision.calibration.patterns import Charuco, Pattern
from dlo_ros.vision.calibration.view_coverage import LEAST_VIEWS, Coverage
from dlo_ros.vision.segmentation.ridge_map import Image

MOST_VIEWS = 60
SAME = 0.001  # of the image's diagonal: a picture that differs less is a copy
SIMILAR = 0.04  # in a film the pattern must move that far to make another view
SIZES_TRIED = 6


@dataclass(frozen=True)
class Skipped:
    """A picture without a view, and the reason."""

    name: str
    reason: str


class ViewCollector:
    """Collects the views of one camera.

    Args:
        pattern: the calibration pattern in the views.
    """

    def __init__(self, pattern: Pattern) -> None:
        self.pattern = pattern
        self.coverage = Coverage(pattern)
        self.skipped: list[Skipped] = []
        self._views: list[PatternView] = []
        self._shapes: list[FloatArray] = []
        self._size: tuple[int, int] | None = None
        self._first = ""
        self._other_sizes: Counter[tuple[int, int]] = Counter()
        self._tried = 0

    def offer(self, name: str, image: Image, moving: bool = False) -> bool:
        """Look for the pattern; returns whether the picture was taken as a view.

        Args:
            name: name of the picture.
            image: grey or BGR.
            moving: whether it is one of a film, of which only different ones are wanted.

        Raises:
            InputError: it is of another size than those before.
        """
        self._check_size(name, image)
        try:
            view = find_pattern(image, self.pattern, name, thorough=not moving)
        except VisionError as err:
            self.skipped.append(Skipped(name, str(err)))
            self._try_other_sizes(image)
            return False
        shape = _outline(view, self.pattern)
        twin = self._twin(shape, SIMILAR if moving else SAME)
        if twin is not None:
            self.skipped.append(Skipped(name, f"like {self._views[twin].name}"))
            return False
        self._views.append(view)
        self._shapes.append(shape)
        self.coverage.add(view)
        return True

    def views(self, least: int = LEAST_VIEWS) -> list[PatternView]:
        """The collected views; where there are very many, those that differ most.

        Args:
            least: number of views that are needed.

        Raises:
            InputError: no picture, or too few, show the pattern.
        """
        total = len(self._views) + len(self.skipped)
        if not self._views:
            raise InputError(f"{self.pattern.kind}: in none of {total} images{self._why()}")
        if len(self._views) < least:
            raise InputError(
                f"{len(self._views)} of {total} images show the pattern as a view of its own; at "
                f"least {least} are needed: take {least - len(self._views)} more, each "
                f"from another direction{self._why()}"
            )
        return [self._views[k] for k in self._most_different()]

    def _check_size(self, name: str, image: Image) -> None:
        size = (image.shape[1], image.shape[0])
        if self._size is None:
            self._size, self._first = size, name
        if size != self._size:
            raise InputError(
                f"{name}: is {size[0]} x {size[1]} px, {self._first} {self._size[0]} x "
                f"{self._size[1]}; all images must be of one size, from one camera"
            )

    def _try_other_sizes(self, image: Image) -> None:
        if self._views or self._tried >= SIZES_TRIED or isinstance(self.pattern, Charuco):
            return
        self._tried += 1
        size = board_size(image)
        if size is not None:
            self._other_sizes[size] += 1

    def _why(self) -> str:
        if not self.skipped:
            return ""
        if self._other_sizes:
            columns, rows = self._other_sizes.most_common(1)[0][0]
            return (
                f"; they show a chessboard of {columns} x {rows} inner corners (counted where four "
                "squares meet)"
            )
        reason, count = Counter(s.reason for s in self.skipped).most_common(1)[0]
        return f" ({count} times: {reason})"

    def _twin(self, shape: FloatArray, limit: float) -> int | None:
        if self._size is None:
            return None
        diagonal = float(np.hypot(*self._size))
        turned = [shape] if isinstance(self.pattern, Charuco) else [shape, np.roll(shape, 2, 0)]
        for k, other in enumerate(self._shapes):
            distance = min(float(np.linalg.norm(s - other, axis=1).mean()) for s in turned)
            if distance < limit * diagonal:
                return k
        return None

    def _most_different(self) -> list[int]:
        """Numbers of at most `MOST_VIEWS` views, each the farthest from those before, in order."""
        if len(self._views) <= MOST_VIEWS:
            return list(range(len(self._views)))
        shapes = np.array(self._shapes).reshape(len(self._shapes), -1)
        chosen = [int(np.argmax(np.linalg.norm(shapes - shapes.mean(axis=0), axis=1)))]
        distance = np.linalg.norm(shapes - shapes[chosen[0]], axis=1)
        while len(chosen) < MOST_VIEWS:
            chosen.append(int(np.argmax(distance)))
            distance = np.minimum(distance, np.linalg.norm(shapes - shapes[chosen[-1]], axis=1))
        left = set(range(len(self._views))) - set(chosen)
        enough = f"not needed beside {MOST_VIEWS} others"
        self.skipped += [Skipped(self._views[k].name, enough) for k in sorted(left)]
        return sorted(chosen)


def _outline(view: PatternView, pattern: Pattern) -> FloatArray:
    """Roughly where the pattern's outer corners are [px], shape (4, 2), seen or not."""
    transform, _ = cv2.findHomography(pattern.points[view.corners, :2], view.pixels)
    corners = pattern.points[[0, pattern.columns - 1, -1, -pattern.columns], :2]
    if transform is None:
        return np.repeat(view.pixels.mean(axis=0)[None], 4, axis=0)
    p = np.column_stack([corners, np.ones(4)]) @ np.asarray(transform).T
    return np.asarray(p[:, :2] / p[:, 2:])
