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
from dlo_ros.vision.calibration.board_pose import RIVAL, board_pose, check_view_size
from dlo_ros.vision.calibration.camera_fit import Intrinsics, locate
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Charuco, Pattern
from dlo_ros.vision.camera.pinhole import Camera

ROBUST = 1.0  # [px] beyond which a corner counts less
STEPS = 30  # at most; from poses of single views a few suffice
POOR = 1.0  # [px] root mean square distance of the corners, beyond which something is wrong
NEAREST = 2e-3  # [m] two lenses are no nearer to each other than they are wide
TURNED = np.radians(45.0)  # by which cameras that are taken to stand alike may be turned
UNSEEN = 1e4  # [px] where a place is taken to be seen that is not


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


@dataclass(frozen=True, eq=False)
class _Shared:
    """An instant that the first camera and another one see: the pattern's rotation and translation
    in both, places of the corners that the other one sees [m], and their pixels there.
    """

    first: tuple[FloatArray, FloatArray]
    other: tuple[FloatArray, FloatArray]
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
    names, turns = list(intrinsics), _turns(pattern)
    first = names[0]
    if first not in instants[board]:
        raise InputError(
            f"the picture of the board from camera '{first}' does not show the pattern"
        )
    poses = [
        {name: _located(view, pattern, intrinsics[name]) for name, view in views.items()}
        for views in instants
    ]
    lenses = [intrinsics[name].camera() for name in names]
    relative = [np.zeros(6)]
    for name, lens in zip(names[1:], lenses[1:], strict=True):
        shared = [
            _Shared(found[first], found[name], pattern.points[views[name].corners],
                    views[name].pixels)
            for views, found in zip(instants, poses, strict=True)
            if first in found and name in found
        ]  # fmt: skip
        if not shared:
            raise InputError(f"cameras '{first}' and '{name}' see the pattern in no common instant")
        relative.append(_relative(shared, turns, lens, name))
    start: list[FloatArray] = []
    sights: list[_Sight] = []
    for views, found in zip(instants, poses, strict=True):
        if first not in found:
            continue
        rotation, translation = found[first]
        for name, view in views.items():
            camera = names.index(name)
            turn = _turn(relative[camera], rotation, found[name][0], turns)
            flat = pattern.points[view.corners] @ turn
            sights.append(_Sight(view.name, camera, len(start), flat, view.pixels))
        start.append(np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), translation]))
    further = 6 * (len(names) - 1)

    def residual(unknown: FloatArray) -> FloatArray:
        cameras = np.vstack([np.zeros((1, 6)), unknown[:further].reshape(-1, 6)])
        patterns = unknown[further:].reshape(-1, 6)
        result = []
        for sight in sights:
            points = _moved(patterns[sight.instant], sight.flat)
            points = _moved(cameras[sight.camera], points)
            result.append((_seen(lenses[sight.camera], points) - sight.pixels).ravel())
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


def _seen(lens: Camera, points: FloatArray) -> FloatArray:
    """Pixels of points in the camera's own frame, shape (m, 2); far away where it sees none."""
    seen = lens.project((points - lens.translation) @ lens.rotation)
    return np.nan_to_num(seen, nan=UNSEEN)


def _turns(pattern: Pattern) -> list[FloatArray]:
    """Rotations about the pattern's normal under which its corners look the same."""
    step = 4 if isinstance(pattern, Charuco) else 1 if pattern.columns == pattern.rows else 2
    return [Rotation.from_euler("z", 0.5 * np.pi * k).as_matrix() for k in range(0, 4, step)]


def _relative(
    shared: Sequence[_Shared], turns: Sequence[FloatArray], lens: Camera, name: str
) -> FloatArray:
    """Pose of the first camera in another one: rotation vector and translation.

    A pose of the pattern in one view may be its mirror image's, or turned by what the pattern does
    not tell. So each instant proposes a pose for every such turn, and that counts under which the
    corners of most instants lie where the other camera sees them. Where several do alike, as with a
    single instant, the cameras are taken to stand alike.

    Raises:
        InputError: these stand turned to one another.
    """
    proposed = []
    for view in shared:
        (one, at), (other, there) = view.first, view.other
        for turn in turns:
            rotation = other @ turn @ one.T
            proposed.append((rotation, there - rotation @ at))
    errors = np.array([_misfit(*pose, shared, turns, lens) for pose in proposed])
    likely = [proposed[k] for k in np.argsort(errors) if errors[k] <= RIVAL * errors.min()]
    # What counts is the turn about the optical axis, not how far the cameras look across.
    roll = [abs(np.arctan2(t[1, 0] - t[0, 1], t[0, 0] + t[1, 1])) for t, _ in likely]
    upright = likely[int(np.argmin(roll))][0]
    alike = [Rotation.from_matrix(t @ upright.T).magnitude() < TURNED for t, _ in likely]
    rotation, translation = likely[alike.index(True)]
    if min(roll) > TURNED and not all(alike):
        raise InputError(
            f"camera '{name}' stands turned to the first one, and the pictures do not tell how "
            "far; take more pictures with both, the pattern tilted otherwise in each, or use a "
            "ChArUco board"
        )
    return np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), translation])


def _misfit(
    rotation: FloatArray,
    translation: FloatArray,
    shared: Sequence[_Shared],
    turns: Sequence[FloatArray],
    lens: Camera,
) -> float:
    """Distance of corners from where a camera would see them [px], the median over instants.

    Args:
        rotation: rotation from the first camera's frame to this one's, shape (3, 3).
        translation: position of the first camera in this one's frame [m], shape (3,).
        shared: instants that both cameras see.
        turns: turns under which the pattern looks the same.
        lens: this camera.
    """
    found = []
    for view in shared:
        turned = [view.flat @ turn.T @ (rotation @ view.first[0]).T for turn in turns]
        at = rotation @ view.first[1] + translation
        error = _seen(lens, np.concatenate(turned) + at).reshape(len(turns), -1, 2) - view.pixels
        found.append(np.sqrt(np.min(np.mean(np.sum(error**2, axis=2), axis=1))))
    return float(np.median(found))


def _turn(
    relative: FloatArray, first: FloatArray, own: FloatArray, turns: Sequence[FloatArray]
) -> FloatArray:
    """The turn by which a view counts the pattern's corners otherwise than the first camera's."""
    expected = Rotation.from_rotvec(relative[:3]).as_matrix() @ first
    return turns[int(np.argmax([np.trace(expected.T @ own @ turn) for turn in turns]))]


def _pose(rotation: FloatArray, translation: FloatArray) -> CameraPose:
    quaternion = Rotation.from_matrix(rotation).as_quat()
    quaternion *= np.sign(quaternion[np.argmax(np.abs(quaternion))])
    x, y, z, w = (float(v) for v in quaternion)
    tx, ty, tz = (float(v) for v in translation)
    return CameraPose((tx, ty, tz), (x, y, z, w))
