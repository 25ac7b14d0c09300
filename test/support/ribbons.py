# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of a flat band on the board, projected by OpenCV alone: truth that shares no code.

A band has the DLO's width and lies in the plane y = 0 of the board.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import Command, Motion
from dlo_ros.parameters import CameraPose, Settings
from dlo_ros.vision.camera.pinhole import Camera

FINER = 4  # times as many pixels along each side are painted, and averaged
FACING = Rotation.from_quat([0.5**0.5, 0.0, 0.0, 0.5**0.5])  # the board in a camera before it
BAND, BOARD = (40.0, 60.0, 30.0), (190.0, 195.0, 200.0)


def even(curve, count=1200):
    """A curve (x, z) [m] with points of equal distance, shape (count, 2), and its length."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    at = np.linspace(0.0, s[-1], count)
    return np.column_stack([np.interp(at, s, column) for column in curve.T]), float(s[-1])


def looking(roll=0.0, yaw=0.0, pitch=0.0, translation=(0.0, 0.0, 1.3)):
    """A camera's pose: turned about its axis, then to the side and up or down [deg]."""
    turn = Rotation.from_euler("zyx", [roll, yaw, pitch], degrees=True) * FACING
    return CameraPose(tuple(translation), tuple(turn.as_quat()))


def picture(curve, diameter, camera, seed=0):
    """A picture of a band along a curve (x, z) [m], BGR, shape (height, width, 3)."""
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    aside = 0.5 * diameter * np.column_stack([-tangent[:, 1], tangent[:, 0]])
    left, right = (_projected(side, camera) for side in (curve + aside, curve - aside))
    shape = (camera.height * FINER, camera.width * FINER)
    covered = np.zeros(shape, dtype=np.uint8)
    for k in range(len(curve) - 1):
        corners = np.array([left[k], left[k + 1], right[k + 1], right[k]])
        corners = np.rint(((corners + 0.5) * FINER - 0.5) * 16.0).astype(np.int32)
        cv2.fillConvexPoly(covered, corners, 255, cv2.LINE_8, 4)
    size = (camera.width, camera.height)
    share = cv2.resize(covered, size, interpolation=cv2.INTER_AREA).astype(np.float64) / 255.0
    share = cv2.GaussianBlur(share, (0, 0), 0.6)[..., None]
    noise = np.random.default_rng(seed).normal(0.0, 2.0, (*share.shape[:2], 3))
    image = np.array(BOARD) + share * (np.array(BAND) - np.array(BOARD)) + noise
    return np.clip(image, 0, 255).astype(np.uint8)


def holding(curve, ends):
    """Grips at the ends of a curve (x, z) [m] that are named, `start` and `end`."""
    motion = Motion()
    at = {"start": (0, curve[4] - curve[0]), "end": (-1, curve[-1] - curve[-5])}
    if not ends:
        return motion
    positions = [[curve[at[name][0], 0], 0.0, curve[at[name][0], 1]] for name in ends]
    directions = [[at[name][1][0], 0.0, at[name][1][1]] for name in ends]
    rotations = [
        Rotation.align_vectors([d, [0, 1, 0]], [[1, 0, 0], [0, 1, 0]])[0].as_quat()
        for d in directions
    ]
    motion.add(
        Command(
            stamp=0,
            names=tuple(ends),
            times=np.zeros(1),
            positions=np.array(positions)[None],
            rotations=np.array(rotations)[None],
            velocities=np.full((1, len(ends), 3), np.nan),
            control_points=10,
            frame_id="board",
        )
    )
    return motion


def settings_of(length, diameter, **values):
    """Settings of a DLO of that length and diameter [m]."""
    rod = {"rod.length": length, "rod.diameter": diameter, "rod.control_points": 14}
    return Settings.from_mapping({**rod, "rod.young_modulus": 1e6, "rod.density": 1e3, **values})


def misplaced(points, curve, length):
    """Distance of measured points from those of the same u on a curve (x, z) [m], shape (m, 2)."""
    s = np.linspace(0.0, length, len(curve))
    true = np.column_stack([np.interp(points.u, s, column) for column in curve.T])
    return points.positions[:, [0, 2]] - true


def _projected(plane, camera: Camera):
    inside = Rotation.from_quat(camera.pose.rotation).apply(
        np.column_stack([plane[:, 0], np.zeros(len(plane)), plane[:, 1]])
    ) + np.array(camera.pose.translation)
    coefficients = np.array(camera.distortion)
    pixels, _ = cv2.projectPoints(inside, np.zeros(3), np.zeros(3), camera.matrix, coefficients)
    return pixels.reshape(-1, 2)
