# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The pose of the frame `board` from a pattern that lies on the board.

The board frame's axes run along the pattern's edges: z up, x to the right, y away from the camera.
A chessboard reads the same, or nearly so, after half a turn, and may lie on its side. So the edges
say nothing about which of the four directions is up: z is the one nearest to the image's top, or
to the side that is named as up. The origin is the pattern's centre, which no turn moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError, VisionError
from dlo_ros.parameters import CameraPose, Vector
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.camera_fit import Intrinsics, PatternPose, locate, without_outliers
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Pattern
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.ridge_map import Image

UP = {"top": (0.0, -1.0), "right": (1.0, 0.0), "bottom": (0.0, 1.0), "left": (-1.0, 0.0)}
"""Sides of the image, as directions in it (x right, y down)."""

# Board vectors (x right, y away, z up) in the pattern's frame (x right, y down, z away).
FROM_BOARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
OBLIQUE = np.radians(30.0)  # a board turned further in the image may be taken for one on its side
STEEP = np.radians(75.0)
ROUNDS = 3
RIVAL = 1.5
POOR = 1.0  # [px]
AXES = {"x": (0, (60, 60, 230)), "z": (2, (230, 120, 40))}
AXIS_LENGTH = 3.0  # squares


@dataclass(frozen=True, eq=False)
class BoardPose:
    """Pose of the board in the camera.

    Args:
        pose: pose of the board frame in the optical frame, as the parameter file has it.
        pattern_at: position of the pattern's centre in the board frame [m].
        found: the pattern's pose behind it.
        std_translation: standard deviation of the pattern's centre along the optical frame's
            axes [m], shape (3,), for a camera known exactly.
        std_rotation: standard deviations of the rotation about these axes [rad], shape (3,).
        hints: advice on what to be careful about.
    """

    pose: CameraPose
    pattern_at: Vector
    found: PatternPose
    std_translation: FloatArray
    std_rotation: FloatArray
    hints: tuple[str, ...]


def board_pose(
    view: PatternView,
    pattern: Pattern,
    intrinsics: Intrinsics,
    pattern_at: Vector = (0.0, 0.0, 0.0),
    up: str = "top",
) -> BoardPose:
    """The board's pose from one view of the pattern on it.

    Args:
        view: view of the pattern lying on the board.
        pattern: the calibration pattern in the view.
        intrinsics: the camera.
        pattern_at: position of the pattern's centre in the board frame [m].
        up: the side of the image, a key of `UP`, that is up on the board.

    Raises:
        InputError: the corners fit no pose, or the view's size is not the camera's.
    """
    check_view_size(view, intrinsics)
    try:
        found = locate(view, pattern, intrinsics)
        for _ in range(ROUNDS):
            view = without_outliers(view, found, 0.0)
            found = locate(view, pattern, intrinsics)
    except VisionError as err:
        raise InputError(f"{view.name}: {err}") from err
    top = np.array(UP[up])
    right = np.array([-top[1], top[0]])
    turns = [_quarter_turn(k) for k in range(4)]
    best = max(turns, key=lambda turn: float(right @ (found.rotation @ turn)[:2, 0]))
    rotation = found.rotation @ best @ FROM_BOARD
    translation = found.translation - rotation @ np.array(pattern_at)
    quaternion = Rotation.from_matrix(rotation).as_quat()
    quaternion *= np.sign(quaternion[np.argmax(np.abs(quaternion))])
    x, y, z, w = (float(v) for v in quaternion)
    tx, ty, tz = (float(v) for v in translation)
    std = np.sqrt(np.diag(found.covariance))
    return BoardPose(
        CameraPose((tx, ty, tz), (x, y, z, w)),
        pattern_at,
        found,
        std[3:],
        std[:3],
        tuple(_hints(found, rotation, top)),
    )


def draw_board(image: Image, camera: Camera, pattern: Pattern, pattern_at: Vector) -> Image:
    """The picture with the outline of the pattern and the board frame's x and z axes."""
    canvas = image.copy() if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    thickness = max(2, round(max(image.shape) / 500))
    for name, (column, colour) in AXES.items():
        tip = np.zeros(3)
        tip[column] = AXIS_LENGTH * pattern.square
        ends = camera.project(np.array([np.zeros(3), tip, 1.15 * tip]))
        if not np.all(np.abs(ends) < 1e5):
            continue
        start, end, text = (tuple(int(v) for v in np.rint(p)) for p in ends)
        cv2.arrowedLine(canvas, start, end, colour, thickness, cv2.LINE_AA, tipLength=0.15)
        font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.35 * thickness
        cv2.putText(canvas, name, text, font, size, colour, thickness, cv2.LINE_AA)
    centre = camera.project(np.array([pattern_at]))[0]
    if np.all(np.abs(centre) < 1e5):
        place = (int(centre[0]), int(centre[1]))
        cv2.circle(canvas, place, 3 * thickness, (80, 200, 80), thickness, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


def _quarter_turn(k: int) -> FloatArray:
    c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[k]
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _hints(found: PatternPose, rotation: FloatArray, top: FloatArray) -> list[str]:
    hints = []
    up = rotation[:2, 2]
    length = float(np.linalg.norm(up))
    if length > 0.0 and np.arccos(np.clip(float(up @ top) / length, -1.0, 1.0)) > OBLIQUE:
        hints.append(
            "the pattern's edges run obliquely through the image, so that up may be taken for "
            "sideways; lay them along the board's edges, or turn the camera upright"
        )
    if found.tilt > STEEP:
        hints.append("the pattern is seen at a very flat angle; its pose is uncertain")
    if found.rival < RIVAL:
        hints.append(
            "the board's tilt is ambiguous: its mirror image fits almost as well; use a larger "
            "pattern or come nearer"
        )
    if found.rms > POOR:
        hints.append(
            f"the corners lie {found.rms:.1f} px beside their computed places; the pattern is not "
            "flat, or the camera's calibration does not fit"
        )
    return hints


def check_view_size(view: PatternView, intrinsics: Intrinsics) -> None:
    """Refuse a view of another size than the camera was calibrated for.

    Raises:
        InputError: the sizes differ.
    """
    if (view.width, view.height) != (intrinsics.width, intrinsics.height):
        raise InputError(
            f"{view.name}: is {view.width} x {view.height} px; the camera was calibrated for "
            f"{intrinsics.width} x {intrinsics.height}"
        )
