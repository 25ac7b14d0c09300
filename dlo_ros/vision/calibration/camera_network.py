# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Calibrates cameras to one another and to the board, from pictures taken at the same instants.

One bundle adjustment: unknown are the pose of every further camera to the first one, and that of
the pattern at each instant; the intrinsics stay. The board's pose follows from the instant in which
the pattern lies on it, seen by all cameras together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError, VisionError
from dlo_ros.parameters import CameraPose, Vector
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.board_pose import board_pose, check_view_size
from dlo_ros.vision.calibration.camera_fit import Intrinsics, locate
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Pattern

ROBUST = 1.0  # [px] beyond which a corner counts less
STEPS = 30  # at most; from poses of single views a few suffice
POOR = 1.0  # [px] root mean square distance of the corners, beyond which something is wrong
NEAREST = 2e-3  # [m] two lenses are no nearer to each other than they are wide
TURNED = np.radians(45.0)  # cameras are not turned about their axes by more, to one another


@dataclass(frozen=True, eq=False)
class CalibratedCameras:
    """Poses of the board, seen from each camera.

    Args:
        poses: poses of the board frame in the optical frames, by the cameras' names.
        rms: root mean square distance of the corners from their computed places [px].
        instants: number of instants that were used.
        distances: distance of each further camera from the first one [m], by name, and its std.
    """

    poses: Mapping[str, CameraPose]
    rms: float
    instants: int
    distances: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class _Sight:
    """A camera's corners at an instant; `flat` are their places in the pattern [m]."""

    name: str
    camera: int
    instant: int
    flat: FloatArray
    pixels: FloatArray


def calibrate_cameras(
    instants: Sequence[Mapping[str, PatternView]],
    board: int,
    intrinsics: Mapping[str, Intrinsics],
    pattern: Pattern,
    pattern_at: Vector = (0.0, 0.0, 0.0),
    up: str = "top",
) -> CalibratedCameras:
    """The pose of the board in every camera.

    Args:
        instants: views of the same instant, by the cameras' names; in one of them all see it.
        board: index of the instant in which the pattern lies on the board.
        intrinsics: intrinsics of the cameras, by name; the others are related to the first one.
        pattern: the calibration pattern in the views.
        pattern_at: position of the pattern's centre in the board frame [m].
        up: the side of the first camera's image that is up on the board.

    Raises:
        InputError: a camera shares no instant with the first one, or the corners fit nothing.
    """
    names = list(intrinsics)
    first = names[0]
    if first not in instants[board]:
        raise InputError(
            f"the picture of the board from camera '{first}' does not show the pattern"
        )
    poses = [
        {name: _located(view, pattern, intrinsics[name]) for name, view in views.items()}
        for views in instants
    ]
    relative = [np.zeros(6)]
    for name in names[1:]:
        shared = [p for p in poses if first in p and name in p]
        if not shared:
            raise InputError(f"cameras '{first}' and '{name}' see the pattern in no common instant")
        relative.append(_relative(shared[0][first], shared[0][name], name))
    start: list[FloatArray] = []
    sights: list[_Sight] = []
    for views, found in zip(instants, poses, strict=True):
        if first not in found:
            continue
        rotation, translation = found[first]
        for name, view in views.items():
            camera = names.index(name)
            turn = _turn(relative[camera], rotation, found[name][0])
            flat = pattern.points[view.corners] @ turn
            sights.append(_Sight(view.name, camera, len(start), flat, view.pixels))
        start.append(np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), translation]))
    lenses = [intrinsics[name].camera() for name in names]
    further = 6 * (len(names) - 1)

    def residual(unknown: FloatArray) -> FloatArray:
        cameras = np.vstack([np.zeros((1, 6)), unknown[:further].reshape(-1, 6)])
        patterns = unknown[further:].reshape(-1, 6)
        result = []
        for sight in sights:
            points = _moved(patterns[sight.instant], sight.flat)
            points = _moved(cameras[sight.camera], points)
            lens = lenses[sight.camera]
            seen = lens.project((points - lens.translation) @ lens.rotation)
            result.append((np.nan_to_num(seen, nan=1e4) - sight.pixels).ravel())
        return np.concatenate(result)

    unknown = np.concatenate([*relative[1:], *start])
    solved = least_squares(
        residual, unknown, loss="soft_l1", f_scale=ROBUST, x_scale="jac", max_nfev=STEPS
    )
    left = residual(solved.x)
    rms = float(np.sqrt(2.0 * np.mean(left**2)))
    if rms > POOR:
        at = np.repeat([s.instant for s in sights], [s.pixels.size for s in sights])
        worst = int(np.argmax(np.bincount(at, left**2) / np.bincount(at)))
        named = " and ".join(sight.name for sight in sights if sight.instant == worst)
        raise InputError(
            f"the corners lie {rms:.1f} px beside their computed places, most in {named}; "
            "were the pictures of equal name taken at the same instant, and is each camera's "
            "calibration right?"
        )
    information = solved.jac.T @ solved.jac
    covariance = np.linalg.pinv(information) * float(np.mean(left**2))
    instant = sum(first in p for p in poses[:board])
    pose = board_pose(instants[board][first], pattern, intrinsics[first], pattern_at, up)
    alone = Rotation.from_quat(pose.pose.rotation).as_matrix()
    lying = solved.x[further + 6 * instant : further + 6 * instant + 6]
    rotation = Rotation.from_rotvec(lying[:3]).as_matrix() @ pose.found.rotation.T @ alone
    origin = lying[3:] - rotation @ np.array(pattern_at)
    result, distances = {}, {}
    for k, name in enumerate(names):
        own = np.zeros(6) if k == 0 else solved.x[6 * k - 6 : 6 * k]
        turn = Rotation.from_rotvec(own[:3]).as_matrix()
        result[name] = _pose(turn @ rotation, turn @ origin + own[3:])
        if k:
            distance = float(np.linalg.norm(own[3:]))
            if distance < NEAREST:
                raise InputError(
                    f"cameras '{first}' and '{name}' are found at one place, "
                    f"{1e3 * distance:.1f} mm apart; are their pictures one camera's?"
                )
            axis = own[3:] / max(distance, 1e-12)
            part = covariance[6 * k - 3 : 6 * k, 6 * k - 3 : 6 * k]
            distances[name] = distance, float(np.sqrt(max(axis @ part @ axis, 0.0)))
    return CalibratedCameras(result, rms, len(start), distances)


def _located(
    view: PatternView, pattern: Pattern, intrinsics: Intrinsics
) -> tuple[FloatArray, FloatArray]:
    """Rotation and translation of the pattern in a camera."""
    check_view_size(view, intrinsics)
    try:
        found = locate(view, pattern, intrinsics)
    except VisionError as err:
        raise InputError(f"{view.name}: {err}") from err
    return found.rotation, found.translation


def _moved(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Points after a rotation (vector) and a translation, shape (m, 3)."""
    return np.asarray(Rotation.from_rotvec(pose[:3]).apply(points) + pose[3:])


def _quarter(k: int) -> FloatArray:
    return np.asarray(Rotation.from_euler("z", 0.5 * np.pi * k).as_matrix())


def _relative(
    one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray], name: str
) -> FloatArray:
    """Pose of the first camera in another one: rotation vector and translation.

    A chessboard looks alike turned by a half: the cameras are taken to stand alike.
    """
    turns = [other[0] @ _quarter(k) @ one[0].T for k in range(4)]
    # What counts is the turn about the optical axis, not how far the cameras look across.
    roll = [abs(np.arctan2(t[1, 0] - t[0, 1], t[0, 0] + t[1, 1])) for t in turns]
    best = turns[int(np.argmin(roll))]
    if min(roll) > TURNED:
        raise InputError(f"camera '{name}' stands turned to the first one; turn it upright")
    return np.concatenate([Rotation.from_matrix(best).as_rotvec(), other[1] - best @ one[1]])


def _turn(relative: FloatArray, first: FloatArray, own: FloatArray) -> FloatArray:
    """The quarter turn by which a view counts the pattern's corners otherwise than the first's."""
    expected = Rotation.from_rotvec(relative[:3]).as_matrix() @ first
    fits = [float(np.trace(expected.T @ own @ _quarter(k))) for k in range(4)]
    return _quarter(int(np.argmax(fits)))


def _pose(rotation: FloatArray, translation: FloatArray) -> CameraPose:
    quaternion = Rotation.from_matrix(rotation).as_quat()
    quaternion *= np.sign(quaternion[np.argmax(np.abs(quaternion))])
    x, y, z, w = (float(v) for v in quaternion)
    tx, ty, tz = (float(v) for v in translation)
    return CameraPose((tx, ty, tz), (x, y, z, w))
