# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Finds the DLO in the pictures of one camera that watches it in space.

The shape in the picture follows from nothing known before, but where the clamps are; several
courses may be plausible, and the other cameras decide between them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.edge_profile import Located, locate
from dlo_ros.vision.segmentation.picture_strip import (
    Mask,
    inside,
    resample,
    smooth_curve,
    spacing_for,
)
from dlo_ros.vision.segmentation.ridge_map import Image, map_ridges
from dlo_ros.vision.segmentation.user_hints import Hints, limited
from dlo_ros.vision.space.matching import SAMPLES, WAITING, align
from dlo_ros.vision.space.reprojection import ClampPose
from dlo_ros.vision.space.view import focal_length
from dlo_ros.vision.tracing.abandoned_strand import abandons_strand
from dlo_ros.vision.tracing.chain_junctions import cut_at_junctions
from dlo_ros.vision.tracing.chain_ordering import ClampPixel, LengthRule, Path, PathSearch, alike
from dlo_ros.vision.tracing.course_location import RoughDetection, locate_course
from dlo_ros.vision.tracing.free_ends import free_end, prolong
from dlo_ros.vision.tracing.metric_lengths import PlaneGrid
from dlo_ros.vision.tracing.ridge_snapping import follow
from dlo_ros.vision.tracing.ridge_tracing import find_chains

RULE = LengthRule(0.25, 1.3, np.inf, "px")
"""Shares of the length, in pixels at the distance of the clamps, that a course may have: a DLO that
runs towards the camera looks short."""
MOST_COURSES = 5  # that are looked at in one picture
SAME_CONTRAST = (0.6, 1.7)  # times that of the last picture
FARTHEST_PIXEL = 40.0  # [px] a point further from the rough shape costs no more
LEAST_INSIDE = 0.3  # share of the DLO that must be in the picture


class Measured:
    """The DLO in one picture.

    Args:
        located: middle of the DLO along a curve.
        u: material coordinate of each profile [m], shape (k,); None where it is not known yet.
        prolonged: length by which the curve was prolonged at free ends [px].
        free: whether start and end are free.
        abandons: whether the course turns off a strand that goes straight on.
    """

    def __init__(
        self,
        located: Located,
        u: FloatArray | None,
        prolonged: float,
        free: tuple[bool, bool],
        *,
        abandons: bool = False,
    ) -> None:
        self.located, self.u, self.abandons = located, u, abandons
        last = len(located.curve) - 1.0
        low = free_end(located, prolonged, from_start=True) if free[0] else 0.0
        high = free_end(located, prolonged, from_start=False) if free[1] else last
        index = np.arange(len(located.curve))
        self.low, self.high = max(low, 0.0), min(high, last)
        self.seen: Mask = located.seen & (index >= low) & (index <= high)
        if np.count_nonzero(self.seen) < 12:
            raise VisionError("hardly anything of the DLO is visible")
        self._free, self._prolonged = free, prolonged

    @property
    def loose(self) -> bool:
        """Whether it is unknown which end is the start."""
        return self._free == (True, True)

    def backwards(self) -> Measured:
        """The course from its end."""
        one = self.located
        turned = replace(
            one, curve=one.curve[::-1], normals=-one.normals[::-1], offset=-one.offset[::-1],
            seen=one.seen[::-1], likeness=one.likeness[::-1], blur=one.blur[::-1],
            doubt=one.doubt[::-1],
            excluded=None if one.excluded is None else one.excluded[::-1],
            apart=None if one.apart is None else one.apart[::-1],
        )  # fmt: skip
        u = None if self.u is None else self.u[::-1]
        return Measured(turned, u, self._prolonged, self._free[::-1], abandons=self.abandons)

    def at(self, u: FloatArray) -> Measured:
        """The course with material coordinates [m] of the profiles, shape (k,)."""
        return Measured(self.located, u, self._prolonged, self._free, abandons=self.abandons)

    @property
    def tips(self) -> tuple[FloatArray | None, FloatArray | None]:
        """Pixels of the free ends, where the DLO is seen up to them."""
        points, near = self.located.points, 2.0 * self.located.width / self.located.spacing
        seen = np.flatnonzero(self.seen)
        return (
            points[round(self.low)] if self._free[0] and seen[0] - self.low < near else None,
            points[round(self.high)] if self._free[1] and self.high - seen[-1] < near else None,
        )

    def course(self) -> FloatArray:
        """Pixels from one end to the other, bridged where nothing was seen, shape (m, 2)."""
        part = self.located.points[round(self.low) : round(self.high) + 1]
        return smooth_curve(part, self.located.width / self.located.spacing)


class ViewSearch:
    """Looks for the DLO in one camera's pictures.

    Args:
        camera: camera of the pictures.
        hints: hints of the user on the DLO's colour.
        length, diameter: length and diameter of the DLO [m].
    """

    def __init__(self, camera: Camera, hints: Hints, length: float, diameter: float) -> None:
        self.camera, self._hints = camera, hints
        self._length, self._diameter = length, diameter
        self._last: Located | None = None

    def reset(self) -> None:
        """Forget the last picture."""
        self._last = None

    def remember(self, located: Located) -> None:
        """Store the width and colour of a credible picture for the next one."""
        self._last = located

    def width(self, clamps: tuple[ClampPose | None, ClampPose | None]) -> float:
        """About how wide the DLO is in the picture [px].

        Raises:
            VisionError: what is watched lies behind the camera.
        """
        held = [c.position for c in clamps if c is not None] or [np.zeros(3)]
        depth = float(np.mean([self.camera.rotation[2] @ p for p in held]))
        depth += float(self.camera.translation[2])
        if not depth > 0.0:
            raise VisionError("the camera looks away from the board; check its pose")
        return self._diameter * focal_length(self.camera) / depth

    def find(
        self, image: Image, clamps: tuple[ClampPose | None, ClampPose | None]
    ) -> list[Measured]:
        """The courses in a picture of which nothing is known, the likeliest first.

        Raises:
            VisionError: there is none, or too many.
        """
        width = self.width(clamps)
        allowed = self._hints.searched(image, width)
        bars = map_ridges(image, width, allowed)
        plane = PlaneGrid.of_pixels(bars)
        local = []
        for clamp in clamps:
            pixel = None if clamp is None else self._pixel(clamp)
            local.append(
                None
                if pixel is None
                else ClampPixel(bars.from_image(pixel.position), pixel.direction)
            )
        length = self._length / self._diameter * bars.width
        chains = cut_at_junctions(find_chains(bars), bars.width)
        search = PathSearch(chains, bars, length, plane, local[0], local[1], RULE)
        result = []
        free = (local[0] is None, local[1] is None)
        for path in search.candidates(MOST_COURSES):
            found = self._measure(image, bars.to_image(path.points), path, width, free)
            strands = [bars.to_image(c.points) for c in chains if alike(c, path)]
            part = slice(round(found.low), round(found.high) + 1)
            course, seen = found.located.points[part], found.seen[part]
            found.abandons = abandons_strand(course, seen, strands, found.located.width, free)
            result.append(found)
        return result

    def _pixel(self, clamp: ClampPose) -> ClampPixel | None:
        """A clamp in the picture; None where that does not show it."""
        step = 0.2 * self._diameter
        towards = np.zeros(3) if clamp.direction is None else step * clamp.direction
        pixels = self.camera.project(np.array([clamp.position, clamp.position + towards]))
        size = np.array([self.camera.width, self.camera.height])
        if not np.all(np.isfinite(pixels)) or np.any((pixels[0] < 0.0) | (pixels[0] > size - 1)):
            return None
        difference = pixels[1] - pixels[0]
        norm = float(np.hypot(*difference))
        # One that points at the camera has no direction in the picture.
        clear = norm > 0.3 * step * self.width((clamp, None)) / self._diameter
        return ClampPixel(pixels[0], difference / norm if clear else None)

    def _measure(
        self, image: Image, points: FloatArray, path: Path, width: float, free: tuple[bool, bool]
    ) -> Measured:
        spacing = spacing_for(width)
        curve, extra = prolong(points, width, spacing, *free)
        rough = RoughDetection(path.colour, path.contrast, width, False, False)
        located = locate_course(image, curve, width, rough)
        located = limited(located, self._hints.allowed(image, width))
        return Measured(located, None, extra, free)

    def track(
        self,
        image: Image,
        curve: FloatArray,
        u: FloatArray,
        free: tuple[bool, bool],
        search: float,
    ) -> Measured:
        """The DLO around where it is expected.

        Args:
            image: BGR.
            curve: expected curve of the DLO in the board frame [m], shape (m, 3).
            u: material coordinates there [m], shape (m,).
            free: whether start and end are free.
            search: width of the search to each side [widths].

        Raises:
            VisionError: it is not there.
        """
        last = self._last
        if last is None:
            raise VisionError("nothing is known of the last picture")
        pixels = self.camera.project(curve)
        if not np.all(np.isfinite(pixels)) or np.mean(inside(image, pixels)) < LEAST_INSIDE:
            raise VisionError("the DLO has left the picture")
        width, spacing = last.width, spacing_for(last.width)
        line, extra = prolong(pixels, width, spacing, *free)
        colour = None if last.tones else last.colour
        moved = follow(image, line, width, search * width, colour, last.contrast)
        at = resample(moved, spacing)
        located = locate(image, at, width, colour, known_width=last.known_width, tones=last.tones)
        low, high = SAME_CONTRAST
        if not low * last.contrast < located.contrast < high * last.contrast:
            raise VisionError("what lies near the last shape has another contrast")
        located = limited(located, self._hints.allowed(image, width))
        return Measured(located, self._along(pixels, u, moved, at, extra, free), extra, free)

    def _along(
        self,
        pixels: FloatArray,
        u: FloatArray,
        moved: FloatArray,
        at: FloatArray,
        extra: float,
        free: tuple[bool, bool],
    ) -> FloatArray:
        """Material coordinate of each profile, by its share of the course's length."""
        s = _arc(pixels)
        before, behind = extra * free[0], extra * free[1]
        along = _arc(moved)
        known = np.linspace(-before, float(s[-1]) + behind, len(moved))
        here = np.interp(_arc(at) * (along[-1] / max(_arc(at)[-1], 1e-9)), along, known)
        inner: FloatArray = np.interp(here, s, u)
        pixel = float(u[-1] - u[0]) / max(float(s[-1]), 1e-9)
        inner = inner + pixel * (np.minimum(here, 0.0) + np.maximum(here - s[-1], 0.0))
        return inner


def along_curve(measured: Measured, camera: Camera, curve: FloatArray, u: FloatArray) -> Measured:
    """A course with the material coordinates of a curve in space that it shows.

    Args:
        measured: the DLO as measured in the camera's picture; its direction is found where it is
            not known.
        camera: camera of the picture.
        curve: [m], shape (m, 3).
        u: material coordinates of the curve's points [m], shape (m,), growing.

    Raises:
        VisionError: the curve lies behind the camera.
    """
    pixels = camera.project(curve)
    if not np.all(np.isfinite(pixels)):
        raise VisionError("what the cameras see does not meet in front of them")
    best = None
    for one in (measured, measured.backwards()) if measured.loose else (measured,):
        chosen = np.unique(np.linspace(round(one.low), round(one.high), SAMPLES).astype(np.int64))
        points = one.located.points[chosen]
        some = np.linspace(0, len(u) - 1, SAMPLES).astype(np.int64)
        square = np.sum((points[:, None] - pixels[some][None]) ** 2, axis=2)
        i, j, cost = align(np.minimum(square, FARTHEST_PIXEL**2), WAITING)
        if best is None or cost < best[0]:
            best = cost, one, chosen[i], u[some][j]
    assert best is not None
    _, one, index, at = best
    number = np.bincount(index)
    known = np.flatnonzero(number)
    mean = np.bincount(index, at)[known] / number[known]
    return one.at(np.interp(np.arange(len(one.located.curve)), known, mean))


def _arc(points: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
