# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Coverage of views: places, tilts and distances of the pattern, and the missing ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.vision.calibration.camera_fit import Intrinsics, PatternPose, locate
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Pattern

LEAST_VIEWS = 6
GOOD_VIEWS = 12
CELLS = (8, 6)  # columns and rows into which the image is divided
COVERED = 0.75  # share of the cells that should be reached
REACH = 0.22  # of the image's sides: how near to its corners the pattern should come
TILTED = np.radians(20.0)
TILTED_VIEWS = 2
SCALE = 1.4  # of the largest over the smallest picture of the pattern

PLACES = ("top left", "top right", "bottom left", "bottom right")


class Coverage:
    """Collects views and names the missing ones.

    Args:
        pattern: the calibration pattern in the views.
    """

    def __init__(self, pattern: Pattern) -> None:
        self.pattern = pattern
        self.cells: NDArray[np.int64] = np.zeros(CELLS[::-1], dtype=np.int64)
        self.count = 0
        self._places = [0] * 4
        self._tilts: list[tuple[float, float]] = []
        self._scales: list[float] = []

    def add(self, view: PatternView, pose: PatternPose | None = None) -> None:
        """Add a view.

        Args:
            view: corners and their pixels.
            pose: pose of the pattern; without it a usual lens (60 degrees) is assumed, which
                suffices to recognise tilted views.
        """
        self.count += 1
        p = (view.pixels + 0.5) / [view.width, view.height]
        columns = np.clip((p[:, 0] * CELLS[0]).astype(int), 0, CELLS[0] - 1)
        rows = np.clip((p[:, 1] * CELLS[1]).astype(int), 0, CELLS[1] - 1)
        np.add.at(self.cells, (rows, columns), 1)
        for k in range(4):
            x = p[:, 0] if k % 2 == 0 else 1.0 - p[:, 0]
            y = p[:, 1] if k < 2 else 1.0 - p[:, 1]
            self._places[k] += bool(np.any((x < REACH) & (y < REACH)))
        if pose is None:
            try:
                pose = locate(view, self.pattern, usual_camera(view.width, view.height))
            except VisionError:
                return
        self._tilts.append(tilts(pose))
        # By the foreshortened pattern's distance, so that a tilt is no change of scale.
        self._scales.append(1.0 / float(np.linalg.norm(pose.translation)))

    @property
    def share(self) -> float:
        """Share of the image's cells that corners were seen in."""
        return float(np.mean(self.cells > 0))

    def hints(self) -> list[str]:
        """A sentence for each kind of view that is missing, the most important first."""
        return [sentence for _, sentence in self._gaps()]

    def missing(self) -> list[str]:
        """Missing views in a few words each, number of views aside."""
        return [words for words, _ in self._gaps() if words]

    def _gaps(self) -> Iterator[tuple[str, str]]:
        if self.count < GOOD_VIEWS:
            more = GOOD_VIEWS - self.count
            yield "", f"{self.count} views; {more} more make the result safer"
        places = [name for name, n in zip(PLACES, self._places, strict=True) if not n]
        if places:
            corners = "corner" if len(places) == 1 else "corners"
            words = f"{corners} {', '.join(places)}" if len(places) < 4 else "the image's corners"
            yield words, f"no view reaches the image's {_listed(places)} {corners}"
        elif self.share < COVERED:
            seen = f"{100.0 * self.share:.0f} %"
            yield "much of the image", f"the pattern was seen in {seen} of the image's area only"
        if sum(abs(t[0]) > TILTED for t in self._tilts) < TILTED_VIEWS:
            yield (
                "tilted up or down",
                "too few views with the pattern's top or bottom tilted towards the camera",
            )
        if sum(abs(t[1]) > TILTED for t in self._tilts) < TILTED_VIEWS:
            yield (
                "turned sideways",
                "too few views with the pattern's left or right side turned towards the camera",
            )
        if self._scales and max(self._scales) < SCALE * min(self._scales):
            yield (
                "nearer or farther",
                "all views are from the same distance; take some nearer and some farther",
            )


def usual_camera(width: int, height: int) -> Intrinsics:
    """A camera with a horizontal angle of view of 60 degrees and no distortion."""
    focal = 0.5 * width / np.tan(np.radians(30.0))
    matrix = np.array(
        [[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]]
    )
    return Intrinsics(matrix, (0.0,) * 5, "plumb_bob", width, height)


def tilts(pose: PatternPose) -> tuple[float, float]:
    """Angles [rad] of the pattern's normal against the optical axis, up or down and sideways."""
    x, y, z = pose.rotation[:, 2]
    return float(np.arctan2(y, z)), float(np.arctan2(x, z))


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
