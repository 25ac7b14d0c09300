# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The vision stage: image in, observed spline out.

A frame is first searched where the last shape predicts the DLO. Where that fails, or at the start,
the whole image is searched. A frame without a credible DLO raises a VisionError that says why: a
wrong shape would be worse than none.

Where the picture shows several courses, how evenly they bend and how long they are may decide; else
shapes that are expected do: the one that continues the last picture's and the predicted one.
Nothing else follows from them, so that a wrong prediction changes nothing.

Without a command the start is the end that lies further left on the board (smaller x; the lower one
where x agrees to a diameter). Once found, the ends keep their names as long as the DLO is tracked.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from dlo_ros.command import Motion
from dlo_ros.errors import VisionError
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.ends_beside_clamps import ends_beside
from dlo_ros.vision.expected_shape import (
    FRESH,
    check_prediction,
    expected_shape,
    expected_shapes,
    expected_width,
    from_start,
    resample_count,
)
from dlo_ros.vision.fit.course_evidence import chance_length, evidence
from dlo_ros.vision.fit.material_coordinates import find_ends
from dlo_ros.vision.fit.planar_clamps import EndPoses, clamps_in, ends_at
from dlo_ros.vision.fit.planar_credibility import (
    LEAST_SEEN,
    LENGTH_LIMITS,
    MOST_BESIDE,
    IncompleteError,
    check,
    check_change,
    check_gaps,
    unusable,
)
from dlo_ros.vision.fit.spline_fit import SplineFit, fit_spline
from dlo_ros.vision.planar_result import LastShape, VisionResult
from dlo_ros.vision.segmentation.camera_image import image_of
from dlo_ros.vision.segmentation.edge_profile import Located, locate
from dlo_ros.vision.segmentation.picture_strip import inside, resample, spacing_for
from dlo_ros.vision.segmentation.ridge_map import Image, map_ridges
from dlo_ros.vision.segmentation.user_hints import Hints, limited
from dlo_ros.vision.tracing.abandoned_strand import abandons_strand
from dlo_ros.vision.tracing.chain_ordering import AMBIGUITY, Path, PathSearch, alike
from dlo_ros.vision.tracing.course_choice import (
    TWO_COURSES,
    AmbiguousError,
    choose,
    on_two_strands,
)
from dlo_ros.vision.tracing.course_location import RoughDetection, locate_course
from dlo_ros.vision.tracing.free_ends import prolong
from dlo_ros.vision.tracing.metric_lengths import PlaneGrid
from dlo_ros.vision.tracing.reachable_region import reach, spread
from dlo_ros.vision.tracing.ridge_snapping import follow
from dlo_ros.vision.tracing.ridge_tracing import find_chains

LOG = logging.getLogger(__name__)

OTHERWISE_EVERY = 5
"""Images without a DLO between two that are searched for ropes of several colours, and for ends
beside their clamps."""
ALIKE = 0.12  # relative difference of a width from the expected one that is none
NEAR_CHAIN, NEAR = 0.75, 0.5
"""Distances [widths] of a free end from the end of a course of chains, and of a measured one, up to
which it is not looked for again. Chains end about half a width before the DLO."""
MOST_PROLONGED = 3  # times that a free end is looked for beyond where it was found
TRACKING_SEARCH = (2.0, 5.0)  # [widths] to each side, second attempt where the first fails
MOST_COURSES = 8  # equally plausible ones that are measured


class Observer:
    """Finds one DLO of known length and diameter in a camera's images.

    Args:
        settings: a whole parameter file.
        camera: intrinsics and the board's pose.
        motion: the commands; it may grow between frames. None where there are none.

    Raises:
        InputError: an image that the parameters name cannot be read, or the camera lies in the
            board's plane.
    """

    def __init__(self, settings: Settings, camera: Camera, motion: Motion | None = None) -> None:
        camera.check_before_board()
        self.settings = settings
        self.camera = camera
        self.motion = motion
        self.basis = SplineBasis(settings.rod.control_points, settings.rod.length)
        self._last: LastShape | None = None
        self._velocity: FloatArray | None = None
        self._seen_last: tuple[LastShape, FloatArray | None] | None = None
        self._misses = 0
        self._found: tuple[SplineFit, Located] | None = None
        self._settled = True
        self._beside = False
        self._hints = Hints(settings.vision)

    @property
    def mask(self) -> Image | None:
        """Mask of where the DLO may be in the next images, not zero there, shape (h, w); None:
        anywhere.
        """
        return self._hints.mask

    @mask.setter
    def mask(self, mask: Image | None) -> None:
        self._hints.mask = mask

    def reset(self) -> None:
        """Forget the last shape."""
        self._lose()
        self._seen_last, self._beside = None, False

    def _lose(self) -> None:
        """Track no longer; what was seen last may still choose between plausible courses."""
        self._last = None
        self._velocity = None

    def observe(
        self, stamp: int, image: Image, predicted: FloatArray | None = None
    ) -> VisionResult:
        """Find the DLO in an image.

        Args:
            stamp: stamp of the image [ns].
            image: BGR or mono, uint8, shape (h, w, 3) or (h, w).
            predicted: control points that are expected at the stamp, x, y, z [m] (and theta), of
                any number n from 4, shape (n, 3) or (n, 4). They choose between courses that the
                picture shows to be equally plausible, and do nothing else.

        Raises:
            VisionError: no credible DLO; the message says why.
            InputError: a mask has another size than the image, or the prediction is malformed.
        """
        if predicted is not None:
            check_prediction(predicted)
        result = self._look(stamp, image_of(self.camera, image), predicted)
        assert self._last is not None
        self._misses = 0
        self._seen_last = self._last, self._velocity
        return result

    def _look(self, stamp: int, image: Image, predicted: FloatArray | None) -> VisionResult:
        """Look between the clamps, or else for ends that are seen beside them, and remember it."""
        commanded = ends_at(self.motion, stamp)
        doubted = commanded.in_doubt()
        ends, other = (doubted, commanded) if self._beside else (commanded, doubted)
        found, failure = None, VisionError("")
        try:
            found = self._find(stamp, image, ends, predicted)
        except VisionError as err:
            failure = err
        missed = found is None and self._misses % OTHERWISE_EVERY == 1
        if doubted.doubted is not None and (missed or ends_beside(image, found, ends)):
            kept = self._last, self._velocity, self._misses
            with suppress(VisionError):
                instead = self._find(stamp, image, other, predicted)
                if not ends_beside(image, instead, other):
                    self._beside = not self._beside
                    return instead
            self._last, self._velocity, self._misses = kept
        if found is None:
            raise failure
        return found

    def _find(
        self, stamp: int, image: Image, ends: EndPoses, predicted: FloatArray | None
    ) -> VisionResult:
        """Track, or else search the whole image."""
        last = self._last
        if last is not None and not 0 <= stamp - last.stamp <= FRESH:
            last = self._last = None
            self._velocity = None
        if last is not None:
            for search in TRACKING_SEARCH:
                try:
                    return self._track(stamp, image, ends, last, search)
                except (VisionError, np.linalg.LinAlgError) as err:
                    LOG.debug("not tracked within %g widths: %s", search, err)
        self._lose()
        try:
            shapes = expected_shapes(stamp, self._seen_last, predicted, self.basis.length, ends)
            pixels = [self._project(shape) for shape in shapes]
            expected = [shape for shape in pixels if np.all(np.isfinite(shape))]
            return self._acquire(stamp, image, ends, last, expected)
        except np.linalg.LinAlgError as err:
            self._lose()
            raise VisionError(f"the fit has no solution ({err})") from err
        except VisionError as err:
            self._lose()  # what was found on the way is not credible
            fault = unusable(image, expected_width(self.camera, self.settings.rod.diameter, ends))
            if fault:
                raise VisionError(f"{fault} ({err})") from err
            raise

    def _project(self, plane: FloatArray) -> FloatArray:
        """Pixels, shape (m, 2), of points (x, z) of the board [m]."""
        return self.camera.project(
            np.column_stack([plane[:, 0], np.zeros(len(plane)), plane[:, 1]])
        )

    def _acquire(
        self,
        stamp: int,
        image: Image,
        ends: EndPoses,
        before: LastShape | None,
        expected: Sequence[FloatArray],
    ) -> VisionResult:
        """Search the whole image; a shape that was just lost determines which end is the start."""
        width = expected_width(self.camera, self.settings.rod.diameter, ends)
        rod = self.settings.rod
        farthest = rod.length * (1.0 if ends.doubted is None else 1.0 + 2.0 * MOST_BESIDE)
        allowed = reach(self.camera, ends.held, farthest, rod.diameter)
        hinted = self._hints.searched(image, width)
        if hinted is not None:
            allowed = hinted if allowed is None else hinted & spread(allowed, hinted)
        try:
            return self._search(stamp, image, ends, before, width, allowed, expected, tones=False)
        except AmbiguousError:
            raise  # two answers are no miss: a search that sees less would but choose one
        except VisionError as err:
            self._misses += 1
            if self._misses % OTHERWISE_EVERY != 1:
                raise
            try:  # a rope of twisted or braided colours
                return self._search(
                    stamp, image, ends, before, width, allowed, expected, tones=True
                )
            except (VisionError, np.linalg.LinAlgError):
                raise err from None

    def _search(
        self,
        stamp: int,
        image: Image,
        ends: EndPoses,
        before: LastShape | None,
        width: float,
        allowed: Image | None,
        expected: Sequence[FloatArray],
        *,
        tones: bool,
    ) -> VisionResult:
        """Find and measure the DLO in the part of the image where it may be."""
        bars = map_ridges(image, width, allowed, tones=tones)
        chains = find_chains(bars)
        start, end = clamps_in(bars, ends, self.camera, self.settings.rod.diameter)
        plane = PlaneGrid.of_board(self.camera, bars)
        search = PathSearch(chains, bars, self.basis.length, plane, start, end)
        free = (ends.start is None, ends.end is None)
        measured: list[tuple[float, SplineFit, VisionResult, LastShape | None]] = []
        refused, rival, rod = None, -np.inf, self.settings.rod
        paths = search.candidates(MOST_COURSES)
        for path in paths:
            self._lose()
            points = bars.to_image(path.points)
            try:
                result = self._follow(stamp, image, ends, before, points, path, width, tones)
                seen = result.pixels_seen
                if on_two_strands(points, path.seen, result.pixels, seen, result.width):
                    raise VisionError("the edges beside the course of the DLO are another's")
                strands = [bars.to_image(c.points) for c in chains if alike(c, path)]
                if abandons_strand(result.pixels, seen, strands, result.width, free):
                    raise VisionError("what looks like the DLO turns off a strand that goes on")
            except (VisionError, np.linalg.LinAlgError) as err:
                if isinstance(err, IncompleteError) and self._found is not None:
                    rival = max(rival, evidence(self._found[0], rod))
                refused = refused or err
                continue
            assert self._found is not None
            measured.append((path.cost, self._found[0], result, self._last))
        near = paths[0].cost + AMBIGUITY  # a dearer course may outdo those, not stand in for them
        if refused is not None and not any(cost < near for cost, *_ in measured):
            several = len(paths) > 1 and paths[1].cost < near
            raise AmbiguousError(str(refused)) if several else refused
        courses = [result.pixels for _, _, result, _ in measured]
        seen_parts = [result.pixels_seen for _, _, result, _ in measured]
        likelihoods = [evidence(fit, rod) for _, fit, _, _ in measured]
        chosen = choose(
            courses, likelihoods, expected, width, rival, either_way=all(free), seen=seen_parts
        )
        _, fit, result, self._last = measured[chosen]
        limits = LENGTH_LIMITS[2 - sum(free)]
        if len(paths) > 1 and chance_length(fit.seen_length, limits, rod.length, rod.length_std):
            raise AmbiguousError(TWO_COURSES)
        return result

    def _follow(
        self, stamp: int, image: Image, ends: EndPoses, before: LastShape | None,
        points: FloatArray, path: Path, width: float, tones: bool,
    ) -> VisionResult:  # fmt: skip
        """Measure the DLO along a course, and refuse one that the picture does not bear out."""
        rod, camera = self.settings.rod, self.camera
        points = from_start(points, camera, ends, before, rod.diameter)
        rough = RoughDetection(path.colour, path.contrast, width, tones, tones)
        held = ends.start is not None and ends.end is not None
        result = self._measure(stamp, image, ends, points, width, rough, final=held)
        if held:
            return result
        # A free end is looked for beyond the last chain, and again from where it was found until
        # that is near. Near a chain once is enough, if nothing leaves the end in doubt.
        alike = abs(result.width - width) < ALIKE * width  # else it may be the DLO with its shadow
        near = NEAR_CHAIN if alike and self._settled else 0.0
        for _ in range(MOST_PROLONGED):
            known = from_start(result.pixels, camera, ends, before, rod.diameter)
            moved = np.hypot(*(known[[0, -1]] - points[[0, -1]]).T)
            if np.max(moved) < near * result.width:
                break
            first, near, points = self._last, NEAR, known
            assert first is not None
            rough = RoughDetection(first.colour, first.contrast, width, first.known_width, tones)
            result = self._measure(stamp, image, ends, points, result.width, rough, final=False)
        assert self._found is not None
        check(*self._found, ends, camera, rod.length, rod.diameter)
        check_gaps(image, result.pixels, result.pixels_seen, result.width, result.contrast)
        return result

    def _measure(
        self, stamp: int, image: Image, ends: EndPoses, points: FloatArray, width: float,
        rough: RoughDetection, *, final: bool,
    ) -> VisionResult:  # fmt: skip
        """Locate the DLO along a rough course and fit it."""
        spacing = spacing_for(width)
        curve, before = prolong(points, width, spacing, ends.start is None, ends.end is None)
        located = locate_course(image, curve, width, rough)
        located = limited(located, self._hints.allowed(image, width))
        return self._finish(stamp, image, located, ends, before, None, final)

    def _track(
        self, stamp: int, image: Image, ends: EndPoses, last: LastShape, search: float
    ) -> VisionResult:
        """Search around where the last shape and the imposed motion predict the DLO."""
        points = self._project(expected_shape(stamp, last, self._velocity, ends))
        if not np.all(np.isfinite(points)) or np.mean(inside(image, points)) < LEAST_SEEN:
            raise VisionError("the DLO has left the picture")
        spacing = spacing_for(last.width)
        curve, before = prolong(points, last.width, spacing, ends.start is None, ends.end is None)
        colour = None if last.tones else last.colour
        moved = follow(image, curve, last.width, search * last.width, colour, last.contrast)
        located = locate(
            image,
            resample(moved, spacing),
            last.width,
            colour,
            known_width=last.known_width,
            tones=last.tones,
        )
        if not 0.6 * last.contrast < located.contrast < 1.7 * last.contrast:
            raise VisionError("what lies near the last shape has another contrast")
        located = limited(located, self._hints.allowed(image, last.width))
        return self._finish(stamp, image, located, ends, before, last, True)

    def _finish(
        self, stamp: int, image: Image, located: Located, ends: EndPoses, prolonged: float,
        last: LastShape | None, final: bool,
    ) -> VisionResult:  # fmt: skip
        """Ends, spline and, where it is the final one, checks."""
        rod = self.settings.rod
        free = (ends.start is None, ends.end is None)
        found = find_ends(image, located, self.camera, rod.length, rod.length_std, prolonged, free)
        fit = fit_spline(located, self.camera, self.basis, stamp, ends.start, ends.end, found)
        self._found, self._settled = (fit, located), found.settled
        if final:
            check(fit, located, ends, self.camera, rod.length, rod.diameter)
        if last is not None:
            check_change(fit.seen_length, last.seen_length)
        pixels = self._project(fit.curve)
        result = VisionResult.of(fit, located, pixels, tracked=last is not None)
        if final:
            check_gaps(image, pixels, result.pixels_seen, result.width, result.contrast)
        self._remember(stamp, fit, located, ends)
        return result

    def _remember(self, stamp: int, fit: SplineFit, located: Located, ends: EndPoses) -> None:
        curve = resample_count(fit.curve, 400)
        self._velocity = None if self._last is None else self._last.velocity_to(curve, stamp)
        self._last = LastShape.of(stamp, curve, fit.seen_length, located, ends)
