# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The vision stage in space: pictures of one instant in, observed spline out.

As in the plane, each picture is first searched where the last shape predicts the DLO, and as a
whole where that fails. Pictures that have two answers, and views that do not agree, raise a
VisionError that says why: a wrong shape would be worse than none.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dlo_ros.command import Motion
from dlo_ros.errors import InputError, VisionError
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.expected_shape import FRESH
from dlo_ros.vision.fit.spline_fit import KNOT_SPAN
from dlo_ros.vision.planar_observer import TRACKING_SEARCH
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.segmentation.camera_image import image_of
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.segmentation.user_hints import Hints
from dlo_ros.vision.space.depth import course_points, profile_depths
from dlo_ros.vision.space.matching import Course, Match, coordinates, match, scaled_in_depth
from dlo_ros.vision.space.picture_search import Measured, ViewSearch, along_curve
from dlo_ros.vision.space.publishing import end_stds, publish
from dlo_ros.vision.space.reprojection import Prior, fit_views
from dlo_ros.vision.space.spatial_clamps import Clamps, clamps_at, from_start
from dlo_ros.vision.space.spatial_credibility import (
    alike,
    by_chance,
    check,
    evidence,
    near,
    seen_by,
)  # fmt: skip
from dlo_ros.vision.space.spatial_result import SpaceFit, SpaceResult
from dlo_ros.vision.space.view import View, view_of
from dlo_ros.vision.tracing.course_choice import DECISIVE
from dlo_ros.vision.tracing.occlusion_bridges import check_bridges

LOG = logging.getLogger(__name__)

MOST_SPANS = 60  # of the fine spline
DENSE = 400  # points of a shape that predicts the next
UNKNOWN_SPEED = 0.2  # [m/s] std of the DLO's speed where it is not tracked yet
SPEED_SHARE = 0.3  # of the measured speed: how well it is known
SPEED_STD = 0.03  # [m/s] besides
FITTED = 6  # rough matches, the best ones, that are fitted

DEPTHS = (-1.0, 0.0, 2.0)
"""Times of its depth from the line through its ends, from which a shape is fitted once more: where
the depth follows from the length alone, several shapes have the same."""

TWO_SHAPES = "the pictures allow two shapes of the DLO"

Picture = TypeVar("Picture")


@dataclass(frozen=True, eq=False)
class Frame:
    """One camera's picture.

    Args:
        stamp: [ns].
        image: BGR or mono, uint8.
        depth: aligned with it [m], NaN or 0 where there is none, shape (h, w); None: no sensor.
    """

    stamp: int
    image: Image
    depth: NDArray[np.floating[Any]] | None = None


@dataclass(frozen=True, eq=False)
class _Last:
    stamp: int
    fit: SpaceFit
    velocity: FloatArray | None


class SpaceObserver:
    """Finds one DLO of known length and diameter in the pictures of several cameras.

    Args:
        settings: a whole parameter file.
        cameras: intrinsics and the board's pose, by name; a single one needs depth.
        motion: the commands; it may grow between frames. None where there are none.

    Raises:
        InputError: hints that hold for one picture only are given for several cameras.
    """

    def __init__(
        self, settings: Settings, cameras: Mapping[str, Camera], motion: Motion | None = None
    ) -> None:
        vision = settings.vision
        if len(cameras) > 1 and (vision.mask or vision.empty_board or any(vision.region)):
            raise InputError(
                "vision.region, vision.mask and vision.empty_board hold for one camera; leave them "
                "out with vision.cameras"
            )
        rod = settings.rod
        self.settings, self.cameras, self.motion = settings, dict(cameras), motion
        self.basis = SplineBasis(rod.control_points, rod.length)
        spans = int(np.clip(round(rod.length / (KNOT_SPAN * rod.diameter)), 6, MOST_SPANS))
        self._fine = SplineBasis(spans + 3, rod.length)
        self._dense = np.linspace(0.0, rod.length, DENSE)
        self._values = self._fine.matrix(self._dense)
        self.hints = hints = Hints(vision)
        self._search = {
            name: ViewSearch(camera, hints, rod.length, rod.diameter)
            for name, camera in cameras.items()
        }
        self._last: _Last | None = None
        self._clamps: dict[int, Clamps] = {}
        self._pool = ThreadPoolExecutor(max(1, len(cameras)), thread_name_prefix="view")

    def reset(self) -> None:
        """Forget the last shape."""
        self._last = None
        for search in self._search.values():
            search.reset()

    def observe(self, frames: Mapping[str, Frame]) -> SpaceResult:
        """Find the DLO in pictures of about one instant.

        The shape is that at the stamp of the first camera's picture.

        Args:
            frames: pictures by the cameras' names.

        Raises:
            VisionError: no credible DLO; the message says why.
        """
        missing = [name for name in self.cameras if name not in frames]
        if missing:
            raise VisionError(f"no picture of camera {', '.join(missing)}")

        def picture(name: str, view: ViewSearch) -> Image:
            return image_of(view.camera, frames[name].image, frames[name].depth)

        images = {name: self._of(name, picture) for name in self.cameras}
        stamp = frames[next(iter(self.cameras))].stamp
        self._clamps = {s: clamps_at(self.motion, s) for s in {f.stamp for f in frames.values()}}
        clamps = self._clamps[stamp]
        last = self._last
        if last is not None and not 0 < stamp - last.stamp <= FRESH:
            last = None
        if last is not None:
            for search in TRACKING_SEARCH:
                try:
                    return self._track(stamp, frames, images, clamps, last, search)
                except (VisionError, np.linalg.LinAlgError) as err:
                    LOG.debug("not tracked within %g widths: %s", search, err)
        self.reset()
        try:
            return self._acquire(stamp, frames, images, clamps, last)
        except np.linalg.LinAlgError as err:
            raise VisionError(f"the fit has no solution ({err})") from err

    def _of(self, name: str, work: Callable[[str, ViewSearch], Picture]) -> Picture:
        """Something done with one camera; its name stands before what is wrong."""
        try:
            return work(name, self._search[name])
        except (VisionError, np.linalg.LinAlgError) as err:
            if len(self.cameras) == 1:
                raise VisionError(str(err)) from err
            raise VisionError(f"{name}: {err}") from err

    def _each(self, work: Callable[[str, ViewSearch], Picture]) -> dict[str, Picture]:
        """Something done with every camera, side by side."""
        running = {name: self._pool.submit(self._of, name, work) for name in self.cameras}
        return {name: future.result() for name, future in running.items()}

    def _track(
        self,
        stamp: int,
        frames: Mapping[str, Frame],
        images: Mapping[str, Image],
        clamps: Clamps,
        last: _Last,
        search: float,
    ) -> SpaceResult:
        u, b, free = self._dense, self._values, (clamps[0] is None, clamps[1] is None)
        share = (u / u[-1])[:, None]

        def look(name: str, view: ViewSearch) -> Measured:
            then = frames[name].stamp
            points = last.fit.points
            if last.velocity is not None:
                points = points + (then - last.stamp) * 1e-9 * last.velocity
            curve = b @ points
            for clamp, at, weight in zip(
                self._clamps[then], (0, -1), (1.0 - share, share), strict=True
            ):
                if clamp is not None:
                    curve = curve + weight * (clamp.position - curve[at])
            return view.track(images[name], curve, u, free, search)

        found = self._each(look)
        start = last.fit.points
        if last.velocity is not None:
            start = start + (stamp - last.stamp) * 1e-9 * last.velocity
        views, fit = self._fit(frames, found, clamps, start, last)
        result = self._result(stamp, frames, images, found, views, fit, clamps, True)
        self._remember(stamp, fit, found, last)
        return result

    def _acquire(
        self,
        stamp: int,
        frames: Mapping[str, Frame],
        images: Mapping[str, Image],
        clamps: Clamps,
        before: _Last | None,
    ) -> SpaceResult:
        found = self._each(lambda name, view: view.find(images[name], clamps))
        results: list[tuple[float, SpaceResult, dict[str, Measured]]] = []
        reason, rivals = VisionError("the views do not show one DLO"), []
        rod = self.settings.rod

        def attempt(start: FloatArray, chosen: Mapping[str, Measured]) -> None:
            for _ in range(2):  # the second time from where the first has come to
                curve = self._fine.evaluate(start, self._dense)
                measured = {n: along_curve(m, self.cameras[n], curve, self._dense)
                            for n, m in chosen.items()}  # fmt: skip
                views, fit = self._fit(frames, measured, clamps, start, None)
                start = fit.points
            likely = evidence(views, fit, rod)
            rivals.append((likely, fit))
            result = self._result(stamp, frames, images, measured, views, fit, clamps, False)
            # Where strands meet, a DLO goes on along the strand that continues its own.
            if any(one.abandons for one in chosen.values()):
                raise VisionError("what looks like the DLO turns off a strand that goes on")
            rivals[-1] = likely + DECISIVE, fit
            results.append((likely, result, measured))

        for shape, chosen in self._rough(found, frames)[:FITTED]:
            try:
                attempt(self._oriented(shape, clamps, before), chosen)
            except VisionError as err:
                reason = err
        if not results:
            raise reason
        _, result, measured = max(results, key=lambda one: one[0])
        for scale in DEPTHS:
            with suppress(VisionError, np.linalg.LinAlgError):
                axis = next(iter(self.cameras.values())).rotation[2]
                attempt(scaled_in_depth(result.fit.points, axis, scale), measured)
        likely, result, measured = max(results, key=lambda one: one[0])
        several = any(len(courses) > 1 for courses in found.values())
        if (several and by_chance(result.fit, rod)) or any(
            other > likely and not alike(fit, result.fit, rod.diameter) for other, fit in rivals
        ):
            raise VisionError(TWO_SHAPES)
        self._remember(stamp, result.fit, measured, None)
        return result

    def _rough(
        self, found: Mapping[str, Sequence[Measured]], frames: Mapping[str, Frame]
    ) -> list[tuple[FloatArray, dict[str, Measured]]]:
        """Rough shapes in space [m] with the courses that they come from, the best one first.

        Raises:
            VisionError: no courses of the views fit one another, or not the likeliest of a view.
        """
        names, length = list(found), self._fine.length
        options = [
            [
                m
                for one in found[name]
                for m in ((one, one.backwards()) if k and one.loose else (one,))
            ]
            for k, name in enumerate(names)
        ]
        rough: list[tuple[float, FloatArray, dict[str, Measured]]] = []
        nearest, partnered = "", list[Measured]()
        for chosen in product(*options):
            if len(names) == 1:
                rough_shape = self._from_depth(names[0], chosen[0], frames)
            else:
                cameras = self.cameras.values()
                rough_shape = match(
                    [Course(c, c.rays(m.course())) for c, m in zip(cameras, chosen, strict=True)]
                )
            score, fault = rough_shape.compared(length)
            if not fault:
                rough.append((score, rough_shape.points, dict(zip(names, chosen, strict=True))))
            nearest = fault or nearest
            partnered.extend(chosen if rough_shape.near else ())
        if not rough:
            raise VisionError(f"the views do not show one DLO ({nearest})")
        # Where strands lie on one another a search may miss a course: that a less likely one of
        # another picture has a partner is no proof against the likeliest, either way round.
        for option, courses in zip(options, found.values(), strict=True):
            if not any(m in partnered for m in option[: len(option) // len(courses)]):
                raise VisionError(TWO_SHAPES)
        rough.sort(key=lambda one: one[0])
        return [(points, chosen) for _, points, chosen in rough]

    def _from_depth(self, name: str, measured: Measured, frames: Mapping[str, Frame]) -> Match:
        """The course of the only camera, where its depth image shows it."""
        image, camera = frames[name].depth, self.cameras[name]
        if image is None:
            raise VisionError("one camera without depth determines no shape in space")
        radius = 0.5 * self.settings.rod.diameter
        points = course_points(image, camera, measured.course(), measured.located.width, radius)
        return Match(points, 0.0)

    def _oriented(self, points: FloatArray, clamps: Clamps, before: _Last | None) -> FloatArray:
        """Control points of a rough shape from the DLO's start to its end."""
        known = [None if c is None else c.position for c in clamps]
        if clamps == (None, None) and before is not None:
            known = [before.fit.points[0], before.fit.points[-1]]
        points = from_start(points, known[0], known[1], self.settings.rod.diameter)
        return self._fine.fit(coordinates(points, self._fine.length), points)

    def _fit(
        self,
        frames: Mapping[str, Frame],
        measured: Mapping[str, Measured],
        clamps: Clamps,
        start: FloatArray,
        last: _Last | None,
    ) -> tuple[list[View], SpaceFit]:
        first = frames[next(iter(self.cameras))].stamp
        views = []
        for name, one in measured.items():
            assert one.u is not None
            frame, rod = frames[name], self.settings.rod
            depth = None
            if frame.depth is not None:
                depth = profile_depths(frame.depth, one.located, 0.5 * rod.diameter)
            dt = (frame.stamp - first) * 1e-9
            camera = self.cameras[name]
            views.append(view_of(camera, one.located, one.u, dt, one.seen, one.tips, depth))
        velocity = None if last is None else last.velocity
        speed = UNKNOWN_SPEED
        if velocity is not None:
            speed = SPEED_STD + SPEED_SHARE * float(np.sqrt(np.mean(np.sum(velocity**2, axis=1))))
        roughness = None if last is None else last.fit.roughness
        prior = Prior(self.settings.rod.diameter, clamps, velocity, speed, roughness)
        return views, fit_views(views, self._fine, start, prior)

    def _result(
        self,
        stamp: int,
        frames: Mapping[str, Frame],
        images: Mapping[str, Image],
        measured: Mapping[str, Measured],
        views: Sequence[View],
        fit: SpaceFit,
        clamps: Clamps,
        tracked: bool,
    ) -> SpaceResult:
        """The published result, once it is found to be credible."""
        diameter = self.settings.rod.diameter
        check(views, fit, clamps, diameter)
        seen, several = seen_by(views, fit, self._fine.length)
        ends = end_stds(views, clamps, diameter)
        observation = publish(stamp, fit, self.basis, seen, ends, diameter)
        curve = self._values @ fit.points
        shown: dict[str, VisionResult] = {}
        for k, (name, one) in enumerate(measured.items()):
            camera, located = self.cameras[name], one.located
            pixels = camera.project(curve)
            own = near(self._dense, fit.u[k][fit.weights[k] > 0.0], self._fine.length)
            check_bridges(images[name], pixels, own, located.width)
            inner = np.abs(fit.residuals[k]) < located.width
            residual = float(np.sqrt(np.mean(fit.residuals[k][inner] ** 2)))
            shown[name] = VisionResult(
                observation, residual * diameter / located.width, residual, float(np.mean(own)),
                self._fine.length * (1.0 + fit.stretch), pixels, own, located.width,
                located.contrast, tracked,
            )  # fmt: skip
        stamps = [frame.stamp for frame in frames.values()]
        offset = (max(stamps) - min(stamps)) * 1e-9
        return SpaceResult(observation, fit, shown, offset, float(np.mean(several)), seen)

    def _remember(
        self, stamp: int, fit: SpaceFit, measured: Mapping[str, Measured], last: _Last | None
    ) -> None:
        velocity = None
        if last is not None:
            velocity = (fit.points - last.fit.points) / ((stamp - last.stamp) * 1e-9)
        self._last = _Last(stamp, fit, velocity)
        for name, one in measured.items():
            self._search[name].remember(one.located)
