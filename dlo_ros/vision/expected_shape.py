# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Expected place, width and direction of a DLO before its picture is examined."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.errors import InputError, VisionError
from dlo_ros.spline import ORDER, FloatArray, SplineBasis
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.fit.planar_clamps import EndPoses
from dlo_ros.vision.planar_result import LastShape

FRESH = 500_000_000  # [ns] an older shape predicts nothing
EXPECTED_POINTS = 400  # of an expected shape: a point every few pixels of a DLO


def expected_shapes(
    stamp: int,
    seen_last: tuple[LastShape, FloatArray | None] | None,
    predicted: FloatArray | None,
    length: float,
    ends: EndPoses,
) -> list[FloatArray]:
    """Shapes that the DLO may have, from start to end, points (x, z) [m], each of shape (P, 2).

    Args:
        stamp: stamp of the image [ns].
        seen_last: the last shape that was seen, and its velocity where that is known [m/s].
        predicted: control points that are expected at the stamp, shape (n, 3) or (n, 4).
        length: length of the DLO, L [m].
        ends: the clamps at that stamp.
    """
    shapes = []
    if seen_last is not None and 0 <= stamp - seen_last[0].stamp <= FRESH:
        shapes.append(expected_shape(stamp, *seen_last, ends))
    if predicted is not None:
        u = np.linspace(0.0, length, EXPECTED_POINTS)
        shapes.append(SplineBasis(len(predicted), length).evaluate(predicted, u)[:, [0, 2]])
    return shapes


def expected_shape(
    stamp: int, last: LastShape, velocity: FloatArray | None, ends: EndPoses
) -> FloatArray:
    """The last shape, carried on by its velocity and the clamps.

    Args:
        stamp: stamp of the expected shape [ns].
        last: the last shape.
        velocity: velocity of the last shape's points [m/s]; None where it is not known.
        ends: the clamps at that stamp.

    Returns:
        Points (x, z) [m], shape (P, 2).
    """
    curve = last.curve
    dt = (stamp - last.stamp) * 1e-9
    if velocity is not None:
        curve = curve + dt * velocity
    share = np.linspace(0.0, 1.0, len(curve))[:, None]
    for end, at, weight in ((ends.start, 0, 1.0 - share), (ends.end, -1, share)):
        if end is not None:
            curve = curve + weight * (end.position - curve[at])
    return curve


def expected_width(camera: Camera, diameter: float, ends: EndPoses) -> float:
    """Width of the DLO in the image [px], at its clamps and in the middle of the image.

    Args:
        camera: intrinsics and the board's pose.
        diameter: diameter of the DLO [m].
        ends: the clamps, as far as they are known.

    Raises:
        VisionError: the camera does not look at the board's plane.
    """
    known = ends.held
    pixels = np.array([[0.5 * camera.width, 0.5 * camera.height]])
    if known:
        board = np.array([[p[0], 0.0, p[1]] for p in known])
        projected = camera.project(board)
        if np.all(np.isfinite(projected)):
            pixels = np.vstack([pixels, projected])
    scales = camera.metres_per_pixel(pixels)
    scales = scales[np.isfinite(scales) & (scales > 0.0)]
    if len(scales) == 0:
        raise VisionError(
            "the camera does not look at the board's plane; check camera.translation and "
            "camera.rotation"
        )
    return diameter / float(np.median(scales))


def from_start(
    course: FloatArray, camera: Camera, ends: EndPoses, before: LastShape | None, diameter: float
) -> FloatArray:
    """A course [px], turned round where both ends are free and its first point is the end.

    Args:
        course: pixels, shape (m, 2).
        camera: camera of the picture.
        ends: the clamps; those in doubt are near the ends.
        before: the shape before; None at a first detection.
        diameter: diameter of the DLO [m].
    """
    if ends.start is not None or ends.end is not None:
        return course
    known: Sequence[FloatArray | None] = ends.places
    if not ends.held and before is not None:
        known = list(before.curve[[0, -1]])
    outer = camera.to_board(course[[0, -1]])[:, [0, 2]]
    return course[::-1] if traced_backwards(outer, known, diameter) else course


def traced_backwards(
    outer: FloatArray, known: Sequence[FloatArray | None], diameter: float
) -> bool:
    """Whether a path runs from the end to the start.

    Args:
        outer: first and last point of the path, x, (y,) z [m], shape (2, d).
        known: about where start and end are [m], shape (d,); None: unknown. Where both are, the
            start is the end of the smaller x, or z where x agrees to a diameter.
        diameter: diameter of the DLO [m].
    """
    places = [(k, place) for k, place in enumerate(known) if place is not None]
    if not places:
        apart = outer[0] - outer[1]
        return bool(apart[0 if abs(apart[0]) > diameter else -1] > 0.0)
    kept, turned = (
        sum(float(np.linalg.norm(way[k] - place)) for k, place in places)
        for way in (outer, outer[::-1])
    )
    return turned < kept


def check_prediction(control_points: FloatArray) -> None:
    """Check that control points are those of a spline.

    Args:
        control_points: x, y, z [m] (and theta [rad]), shape (n, 3) or (n, 4).

    Raises:
        InputError: with what is wrong.
    """
    shape = control_points.shape
    if len(shape) != 2 or shape[0] < ORDER or shape[1] not in (3, 4):
        raise InputError(
            f"the predicted control points have shape {shape}; (n, 3) or (n, 4) with n of at least "
            f"{ORDER} is needed"
        )
    if not np.all(np.isfinite(control_points)):
        raise InputError("the predicted control points hold a number that is not finite")


def resample_count(points: FloatArray, count: int) -> FloatArray:
    """A number of equally spaced points along a polyline, shape (count, d)."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, s[-1], count)
    return np.column_stack([np.interp(at, s, column) for column in points.T])
