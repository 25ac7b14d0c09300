# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A calibrated camera that watches the board: pixels to points of the plane y = 0 and back.

Pixel coordinates are those of OpenCV and of ROS: the centre of the first pixel is (0, 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.parameters import CameraPose
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.lens_distortion import distort, undistort

# Number of coefficients that sensor_msgs/CameraInfo carries for each model.
MODELS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 4, 5, 8, 12, 14)}
STEP_X, STEP_Y = np.array([1.0, 0.0]), np.array([0.0, 1.0])
NEAREST = 1e-6  # [m] a camera nearer to the board's plane lies in it
STEEPEST = 20.0  # tangent of the largest angle to the optical axis at which a lens is looked at
STEPS = 2000  # up to there
ROUND_TRIP = 0.05  # [px] above this a pixel lies where the distortion cannot be undone


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera with lens distortion and the pose of the board in front of it.

    Args:
        matrix: K, shape (3, 3) [px].
        distortion: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]; empty for none.
        width, height: size of the image [px].
        pose: pose of the board in the camera's optical frame.
        model: `plumb_bob` or `rational_polynomial`; empty where there is no distortion.

    Raises:
        InputError: K is zero or not finite, the model is unknown, or sizes do not fit.
    """

    matrix: FloatArray
    distortion: tuple[float, ...]
    width: int
    height: int
    pose: CameraPose = field(default_factory=CameraPose)
    model: str = "plumb_bob"

    def __post_init__(self) -> None:
        k = np.asarray(self.matrix, dtype=np.float64)
        if k.size != 9:
            raise InputError(f"camera_info has a K of {k.size} numbers; 9 are needed")
        k = k.reshape(3, 3)
        object.__setattr__(self, "matrix", k)
        object.__setattr__(self, "distortion", tuple(float(d) for d in self.distortion))
        if not np.all(np.isfinite(k)):
            raise InputError("camera_info has a K with NaN or infinite numbers; calibrate anew")
        if k[0, 0] <= 0.0 or k[1, 1] <= 0.0 or abs(k[2, 2] - 1.0) > 1e-6:
            raise InputError(
                f"camera_info has focal lengths {k[0, 0]:g} and {k[1, 1]:g} px; they must be "
                "positive (the camera is not calibrated)"
            )
        if self.model not in MODELS and (self.model or any(self.distortion)):
            raise InputError(
                f"camera_info has the distortion model '{self.model[:40]}'; known are "
                + " and ".join(MODELS)
            )
        allowed = MODELS.get(self.model, MODELS["rational_polynomial"])
        if len(self.distortion) not in allowed:
            raise InputError(
                f"camera_info has {len(self.distortion)} distortion coefficients; "
                f"{self.model} has {' or '.join(str(a) for a in allowed[1:])}"
            )
        if any(self.distortion[12:]):
            raise InputError(
                "camera_info has a tilted sensor (the last two distortion coefficients), which is "
                "not supported; calibrate without it"
            )
        if not np.all(np.isfinite(self.distortion)):
            raise InputError("camera_info has NaN or infinite distortion coefficients")
        if self.width < 1 or self.height < 1:
            raise InputError(
                f"camera_info says the image is {self.width} x {self.height} px; "
                "both must be positive"
            )

    @classmethod
    def from_info(
        cls,
        k: ArrayLike,
        d: Sequence[float],
        model: str,
        width: int,
        height: int,
        pose: CameraPose,
    ) -> Camera:
        """Build from the fields of a sensor_msgs/CameraInfo."""
        matrix = np.array(k, dtype=np.float64)
        return cls(matrix, tuple(float(x) for x in d), int(width), int(height), pose, str(model))

    @cached_property
    def rotation(self) -> FloatArray:
        """Rotation that takes board vectors into the optical frame, shape (3, 3)."""
        return np.asarray(Rotation.from_quat(self.pose.rotation).as_matrix(), dtype=np.float64)

    @cached_property
    def translation(self) -> FloatArray:
        """Origin of the board in the optical frame [m], shape (3,)."""
        return np.asarray(self.pose.translation, dtype=np.float64)

    @cached_property
    def _coefficients(self) -> FloatArray:
        result = np.zeros(12)
        result[: len(self.distortion[:12])] = self.distortion[:12]
        return result

    @property
    def _is_pinhole(self) -> bool:
        return not np.any(self._coefficients)

    @cached_property
    def _widest(self) -> float:
        """Radius of ideal image points up to which the distorted radius grows with it.

        A polynomial that was fitted to the picture turns back somewhere outside of it.
        """
        radius = np.linspace(0.0, STEEPEST, STEPS)
        radial = self._coefficients.copy()
        radial[[2, 3, 8, 9, 10, 11]] = 0.0
        distorted = distort(np.column_stack([radius, np.zeros(STEPS)]), radial)[:, 0]
        back = np.flatnonzero(~(np.diff(distorted) > 0.0))
        return float(radius[back[0]]) if len(back) else np.inf

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels of points in the board frame.

        Far outside of the picture, where the lens model would lead back into it, a pixel's
        distance from the centre goes on growing as the point's does.

        Args:
            points: [m], shape (m, 3).

        Returns:
            Pixels, shape (m, 2); NaN for points behind the camera.
        """
        p = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        depth = np.where(p[:, 2] > 1e-9, p[:, 2], np.nan)
        q = p[:, :2] / depth[:, None]
        if not self._is_pinhole:
            beyond = np.maximum(np.hypot(q[:, 0], q[:, 1]) / self._widest, 1.0)[:, None]
            q = beyond * distort(np.ascontiguousarray(q / beyond), self._coefficients)
        k = self.matrix
        return np.column_stack(
            [k[0, 0] * q[:, 0] + k[0, 1] * q[:, 1] + k[0, 2], k[1, 1] * q[:, 1] + k[1, 2]]
        )

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Undistorted normalised image points of pixels, shape (m, 2); NaN where impossible."""
        pixels = np.asarray(pixels, dtype=np.float64)
        k = self.matrix
        y = (pixels[:, 1] - k[1, 2]) / k[1, 1]
        x = (pixels[:, 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
        q = np.column_stack([x, y])
        if self._is_pinhole:
            return q
        tolerance = ROUND_TRIP / max(k[0, 0], k[1, 1])
        ideal = np.asarray(undistort(q, self._coefficients, float(tolerance)))
        # A place beyond the lens model's turn has a second, wrong ray.
        ideal[np.hypot(ideal[:, 0], ideal[:, 1]) > self._widest] = np.nan
        return ideal

    def check_before_board(self) -> None:
        """Refuse a camera that lies in the board's plane, which it sees as a line.

        Raises:
            InputError: it does.
        """
        if abs(float(self.rotation[:, 1] @ self.translation)) < NEAREST:
            raise InputError(
                "camera.translation puts the camera into the board's plane; check the camera's pose"
            )

    def to_board(self, pixels: FloatArray) -> FloatArray:
        """Points of the board's plane y = 0 that pixels show.

        Args:
            pixels: shape (m, 2).

        Returns:
            Points in the board frame [m], shape (m, 3); NaN where the ray misses the plane.
        """
        q = self.rays(pixels)
        directions = np.column_stack([q, np.ones(len(q))]) @ self.rotation  # in the board frame
        origin = -self.rotation.T @ self.translation
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origin[1] / directions[:, 1]
        distance = np.where(distance > 0.0, distance, np.nan)
        points = origin + distance[:, None] * directions
        points[:, 1] = np.where(np.isfinite(distance), 0.0, np.nan)
        return points

    def metres_per_pixel(self, pixels: FloatArray) -> FloatArray:
        """Size of a pixel in the board's plane (root of its area) [m], shape (m,)."""
        pixels = np.asarray(pixels, dtype=np.float64)
        steps = np.vstack([pixels, pixels + STEP_X, pixels + STEP_Y])
        here, right, below = self.to_board(steps).reshape(3, -1, 3)
        a, b = right - here, below - here
        return np.sqrt(np.abs(a[:, 0] * b[:, 2] - a[:, 2] * b[:, 0]))
