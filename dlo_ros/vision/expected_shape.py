# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Expected place, width and direction of a DLO before its picture is examined."""

from __future__ import annotations

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
    known = [place for place in ends.places if np.isfinite(place).all()]
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
        ends, before, diameter: see `traced_backwards`.
    """
    if ends.start is not None or ends.end is not None:
        return course
    outer = camera.to_board(course[[0, -1]])[:, [0, 2]]
    return course[::-1] if traced_backwards(outer, ends, before, diameter) else course


def traced_backwards(
    outer: FloatArray, ends: EndPoses, before: LastShape | None, diameter: float
) -> bool:
    """Whether a path between free ends runs from the end to the start.

    Args:
        outer: first and last point of the path on the board, x and z [m], shape (2, 2).
        ends: clamps, if any, in whose places the command is not believed, but near them.
        before: the shape before; None at a first detection, where the start is further left.
        diameter: diameter of the DLO [m], by which x must differ.
    """
    known = ends.places
    if np.isnan(known).all() and before is not None:
        known = before.curve[[0, -1]]
    if not np.isnan(known).all():
        kept, turned = (np.nansum(np.hypot(*(o - known).T)) for o in (outer, outer[::-1]))
        return bool(turned < kept)
    first, last = outer
    if abs(first[0] - last[0]) > diameter:
        return bool(first[0] > last[0])
    return bool(first[1] > last[1])


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
