# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Projection of points of the board frame to a simulated image, by OpenCV's camera model.

It is written independently of the package's own camera, so that one can be tested against the
other.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.parameters import CameraPose
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.picture_settings import SimulatedCamera


@dataclass(frozen=True)
class Geometry:
    """A simulated camera in front of the board.

    Args:
        camera: intrinsics.
        pose: pose of the board in the camera's optical frame.
    """

    camera: SimulatedCamera
    pose: CameraPose

    @property
    def rotation(self) -> FloatArray:
        """From the board frame into the optical frame, shape (3, 3)."""
        return np.asarray(Rotation.from_quat(self.pose.rotation).as_matrix())

    @property
    def eye(self) -> FloatArray:
        """The camera's centre in the board frame [m], shape (3,)."""
        return np.asarray(-self.rotation.T @ np.array(self.pose.translation))

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels of points in the board frame [m], (m, 3) -> (m, 2); distortion included."""
        turned, _ = cv2.Rodrigues(self.rotation)
        pixels, _ = cv2.projectPoints(
            np.ascontiguousarray(points, dtype=np.float64),
            turned,
            np.array(self.pose.translation),
            self.camera.matrix,
            np.array(self.camera.distortion),
        )
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)

    def rays(self) -> FloatArray:
        """Directions in the board frame through every pixel, shape (H, W, 3)."""
        camera = self.camera
        # The inverse of the distortion is smooth: found on a grid, interpolated in between.
        rows = np.linspace(0.0, camera.height - 1.0, camera.height // 8 + 5)
        columns = np.linspace(0.0, camera.width - 1.0, camera.width // 8 + 5)
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        ideal = self._ideal(pixels).reshape(len(rows), len(columns), 2)
        result = np.ones((camera.height, camera.width, 3))
        for c in range(2):
            spline = RectBivariateSpline(rows, columns, ideal[..., c])
            result[..., c] = spline(np.arange(camera.height), np.arange(camera.width))
        return np.asarray(result @ self.rotation)

    def _ideal(self, pixels: FloatArray) -> FloatArray:
        """Undistorted normalised image points of pixels, shape (m, 2).

        Raises:
            InputError: the distortion cannot be undone within the image.
        """
        k, d = self.camera.matrix, np.array(self.camera.distortion)
        zero = np.zeros(3)
        ideal = cv2.undistortPoints(pixels[:, None, :], k, d).reshape(-1, 2)
        for _ in range(60):
            points = np.column_stack([ideal, np.ones(len(ideal))])
            again, _ = cv2.projectPoints(points, zero, zero, k, d)
            error = again.reshape(-1, 2) - pixels
            if not np.max(np.abs(error)) > 1e-7:
                break
            ideal = ideal - error / k[[0, 1], [0, 1]]
        if not np.max(np.abs(error)) < 1e-4:
            raise InputError(
                f"camera: distortion {list(self.camera.distortion)} folds the image; "
                "give smaller coefficients"
            )
        return np.asarray(ideal, dtype=np.float64)

    def on_plane(self, rays: FloatArray, y: float) -> FloatArray:
        """The x and z [m] where rays meet the plane of a given y, shape (H, W, 2)."""
        distance = (y - self.eye[1]) / rays[..., 1]
        return np.asarray(self.eye[[0, 2]] + distance[..., None] * rays[..., [0, 2]])
