# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fitting a camera to views of a pattern, with a given number of distortion coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dlo_ros.errors import InputError, VisionError
from dlo_ros.parameters import CameraPose
from dlo_ros.spline import FloatArray
from dlo_ros.vision.calibration.pattern_search import PatternView
from dlo_ros.vision.calibration.patterns import Pattern
from dlo_ros.vision.camera.pinhole import Camera

STEPS = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-9)
LEAST_SHARE = 0.7  # a view that would lose more corners is kept, and judged, as a whole
LEAST_OUTLIER = 0.3  # [px]
SINGULAR = 1e-14  # smallest eigenvalue of the scaled information that rounding leaves
BORDER = 24  # places along each border of the image where the distortion must be invertible

_FIX_RADIAL = (cv2.CALIB_FIX_K1, cv2.CALIB_FIX_K2, cv2.CALIB_FIX_K3)


@dataclass(frozen=True)
class Lens:
    """The free coefficients of OpenCV's distortion model.

    Args:
        name: name of the lens model, as it is printed.
        model: distortion model of sensor_msgs/CameraInfo.
        radial: number of free coefficients among k1 k2 k3.
        tangential: whether p1 and p2.
    """

    name: str
    model: str
    radial: int
    tangential: bool

    @property
    def coefficients(self) -> int:
        """Number of free coefficients."""
        return self.radial + 2 * self.tangential + 3 * (self.model == "rational_polynomial")

    @property
    def stored(self) -> int:
        """Number of coefficients that camera_info.yaml lists."""
        return 8 if self.model == "rational_polynomial" else 5

    @property
    def flags(self) -> int:
        """Flags of OpenCV's calibrateCamera."""
        value = sum(_FIX_RADIAL[self.radial :])
        value += 0 if self.tangential else cv2.CALIB_ZERO_TANGENT_DIST
        return value + (cv2.CALIB_RATIONAL_MODEL if self.model == "rational_polynomial" else 0)


LENSES: tuple[Lens, ...] = (
    Lens("no distortion", "plumb_bob", 0, False),
    Lens("k1", "plumb_bob", 1, False),
    Lens("k1 k2", "plumb_bob", 2, False),
    Lens("k1 k2 p1 p2", "plumb_bob", 2, True),
    Lens("k1 k2 p1 p2 k3", "plumb_bob", 3, True),
    Lens("k1 k2 p1 p2 k3 k4 k5 k6", "rational_polynomial", 3, True),
)
"""From few coefficients to many."""

SIMPLE, FULL = LENSES[2], LENSES[4]
"""Enough for a first guess, and all of plumb_bob."""


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """Camera matrix and distortion of images of one size.

    Args:
        matrix: K, shape (3, 3) [px].
        distortion: k1 k2 p1 p2 k3 [k4 k5 k6 [s1 s2 s3 s4]].
        model: plumb_bob or rational_polynomial.
        width, height: size of the image [px].
    """

    matrix: FloatArray
    distortion: tuple[float, ...]
    model: str
    width: int
    height: int

    def camera(self, pose: CameraPose | None = None) -> Camera:
        """The camera in front of a board.

        Raises:
            InputError: the numbers are those of no camera.
        """
        pose = CameraPose() if pose is None else pose
        return Camera(self.matrix, self.distortion, self.width, self.height, pose, self.model)

    @property
    def invertible(self) -> bool:
        """Whether each place along the image's border has a ray, so that all can be undistorted."""
        x = np.linspace(0.0, self.width - 1.0, BORDER)
        y = np.linspace(0.0, self.height - 1.0, BORDER)
        border = np.concatenate(
            [np.column_stack([x, np.full(BORDER, v)]) for v in (0.0, self.height - 1.0)]
            + [np.column_stack([np.full(BORDER, v), y]) for v in (0.0, self.width - 1.0)]
        )
        try:
            return bool(np.all(np.isfinite(self.camera().rays(border))))
        except InputError:
            return False


@dataclass(frozen=True, eq=False)
class PatternPose:
    """Pose of the pattern in the optical frame, with its residuals.

    Args:
        rotation: rotation matrix from the pattern's frame to the optical frame, shape (3, 3).
        translation: the pattern's centre [m], shape (3,).
        residuals: measured minus computed pixels [px], shape (n, 2).
        covariance: covariance of the rotation vector (optical frame) [rad] and the translation [m],
            shape (6, 6), with the std of corners that the residuals have.
        rival: RMS of the other, mirrored solution over that of this one; close to 1 the tilt is
            ambiguous.
    """

    rotation: FloatArray
    translation: FloatArray
    residuals: FloatArray
    covariance: FloatArray
    rival: float

    @property
    def rms(self) -> float:
        """Root mean square distance of corners from their computed places [px]."""
        return rms(self.residuals)

    @property
    def tilt(self) -> float:
        """Angle between the pattern's normal and the camera's optical axis [rad]."""
        return float(np.arccos(np.clip(self.rotation[2, 2], -1.0, 1.0)))


def rms(residuals: FloatArray) -> float:
    """Root mean square length of residuals, shape (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


@dataclass(frozen=True, eq=False)
class CameraFit:
    """A camera fitted to views.

    Args:
        intrinsics: the camera.
        std: standard deviations of fx, fy, cx, cy [px], shape (4,).
        lens: the distortion coefficients that were free.
    """

    intrinsics: Intrinsics
    std: FloatArray
    lens: Lens


def fit_camera(
    views: Sequence[PatternView], pattern: Pattern, lens: Lens, guess: Intrinsics | None = None
) -> CameraFit:
    """Fit a camera to views of the pattern (Zhang's method, then least squares over everything).

    Args:
        views: all of one size.
        pattern: the calibration pattern in the views.
        lens: the distortion coefficients that are free.
        guess: intrinsics at the start of the iteration; default: from homographies.

    Raises:
        VisionError: the views do not determine a camera.
    """
    flat = [pattern.points[v.corners].astype(np.float32) for v in views]
    seen = [v.pixels.astype(np.float32) for v in views]
    width, height = views[0].width, views[0].height
    flags, matrix, distortion = lens.flags, np.eye(3), np.zeros(lens.stored)
    if guess is not None:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        matrix = guess.matrix.copy()
        known = np.asarray(guess.distortion)[: lens.stored]
        free = _free(lens)
        distortion[: len(known)] = np.where(free[: len(known)], known, 0.0)
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            flat, seen, (width, height), matrix, distortion, flags=flags, criteria=STEPS
        )
    except cv2.error as err:
        raise VisionError("the views determine no camera") from err
    coefficients = np.asarray(distortion, dtype=np.float64).ravel()[: lens.stored]
    matrix = np.asarray(matrix, dtype=np.float64)
    focal = matrix[[0, 1], [0, 1]]
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(coefficients))) or focal.min() <= 0:
        raise VisionError("the views determine no camera")
    found = Intrinsics(matrix, tuple(coefficients.tolist()), lens.model, width, height)
    poses = list(zip(turns, shifts, strict=True))
    return CameraFit(found, _standard_deviations(views, pattern, found, poses, lens), lens)


def fit_lenses(
    views: Sequence[PatternView], pattern: Pattern, guess: Intrinsics, last: Lens = LENSES[-1]
) -> tuple[CameraFit | None, ...]:
    """Fit the camera with each of `LENSES` up to the last; None where the views leave it open.

    Each starts from the one before it, so that the guess, which may rest on other views, is
    forgotten: the many coefficients of the last ones do not move far from where they start. Where
    a simpler lens has led too far away for that, it starts from homographies.
    """
    fits: list[CameraFit | None] = []
    for lens in LENSES[: LENSES.index(last) + 1]:
        fit = _fit_or_none(views, pattern, lens, guess) or _fit_or_none(views, pattern, lens, None)
        fits.append(fit)
        guess = guess if fit is None else fit.intrinsics
    return tuple(fits)


def _fit_or_none(
    views: Sequence[PatternView], pattern: Pattern, lens: Lens, guess: Intrinsics | None
) -> CameraFit | None:
    """The camera with a lens, from a guess or from homographies; None where nothing is found."""
    try:
        return fit_camera(views, pattern, lens, guess)
    except VisionError:
        return None


def locate(view: PatternView, pattern: Pattern, intrinsics: Intrinsics) -> PatternPose:
    """The pattern's pose in one view of a known camera.

    Raises:
        VisionError: its corners fit no pose.
    """
    flat = pattern.points[view.corners]
    matrix, distortion = intrinsics.matrix, np.array(intrinsics.distortion)
    seen = np.ascontiguousarray(view.pixels[:, None])
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            flat, seen, matrix, distortion, flags=cv2.SOLVEPNP_IPPE
        )
        solutions = [
            cv2.solvePnPRefineLM(flat, seen, matrix, distortion, r.copy(), t.copy())
            for r, t in zip(turns, shifts, strict=True)
        ]
    except cv2.error as err:
        raise VisionError("the corners fit no pose of the pattern") from err
    poses = []
    for turn, shift in solutions:
        computed, jacobian = cv2.projectPoints(flat, turn, shift, matrix, distortion)
        residuals = view.pixels - computed.reshape(-1, 2)
        if np.all(np.isfinite(residuals)) and shift.ravel()[2] > 0.0:
            poses.append((rms(residuals), turn, shift, residuals, jacobian))
    if not poses:
        raise VisionError("the corners fit no pose of the pattern")
    poses.sort(key=lambda p: p[0])
    error, turn, shift, residuals, jacobian = poses[0]
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    others = [p for p in poses[1:] if _angle(rotation, cv2.Rodrigues(p[1])[0]) > np.radians(3.0)]
    rival = others[0][0] / max(error, 1e-9) if others else np.inf
    variance = np.sum(residuals**2) / max(residuals.size - 6, 1)
    j = _in_optical_frame(jacobian[:, :6], turn)
    covariance = variance * np.linalg.pinv(j.T @ j)
    return PatternPose(
        rotation,
        np.asarray(shift, dtype=np.float64).ravel(),
        residuals,
        np.asarray(covariance, dtype=np.float64),
        float(rival),
    )


def without_outliers(view: PatternView, pose: PatternPose, typical: float) -> PatternView:
    """The view without single corners that were found in a wrong place (a glare, a finger).

    Args:
        view: view in which the pattern was located.
        pose: pose of the pattern, with the residuals of the view's corners.
        typical: usual reprojection error [px].
    """
    distance = np.linalg.norm(pose.residuals, axis=1)
    good = distance <= max(5.0 * typical, 4.0 * float(np.median(distance)), LEAST_OUTLIER)
    if np.all(good) or np.mean(good) < LEAST_SHARE:
        return view
    return replace(view, corners=view.corners[good], pixels=view.pixels[good])


def _standard_deviations(
    views: Sequence[PatternView],
    pattern: Pattern,
    camera: Intrinsics,
    poses: Sequence[tuple[FloatArray, FloatArray]],
    lens: Lens,
) -> FloatArray:
    """Standard deviations of fx, fy, cx, cy [px], all else (distortion, poses) being unknown too,
    shape (4,).

    OpenCV's own take a pseudo-inverse, by which what the views leave open looks certain.
    """
    matrix, distortion = camera.matrix, np.array(camera.distortion)
    columns = np.concatenate([np.arange(6, 10), 10 + np.nonzero(_free(lens))[0]])
    information = np.zeros((len(columns), len(columns)))
    squares, count = 0.0, 0
    for view, (turn, shift) in zip(views, poses, strict=True):
        computed, jacobian = cv2.projectPoints(
            pattern.points[view.corners], turn, shift, matrix, distortion
        )
        own, pose = jacobian[:, columns], jacobian[:, :6]
        basis, _ = np.linalg.qr(pose)
        own = own - basis @ (basis.T @ own)  # what no change of the view's pose can imitate
        information += own.T @ own
        residuals = view.pixels - computed.reshape(-1, 2)
        squares += float(np.sum(residuals**2))
        count += residuals.size
    free = max(count - 6 * len(views) - len(columns), 1)
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    values = np.maximum(values, SINGULAR)
    variance = np.sum(vectors**2 / values, axis=1) / scale**2 * squares / free
    return np.asarray(np.sqrt(variance[:4]))


def _free(lens: Lens) -> FloatArray:
    """Whether each stored coefficient is free, shape (stored,), in OpenCV's order."""
    radial = [lens.radial > k for k in range(3)]
    first = [radial[0], radial[1], lens.tangential, lens.tangential, radial[2]]
    return np.array(first + [True] * (lens.stored - 5))


def _angle(a: FloatArray, b: FloatArray) -> float:
    return float(np.arccos(np.clip(0.5 * (np.trace(a.T @ b) - 1.0), -1.0, 1.0)))


def _in_optical_frame(jacobian: FloatArray, turn: FloatArray) -> FloatArray:
    """Derivatives by a small rotation on the left instead of those by the rotation vector."""
    v = np.asarray(turn, dtype=np.float64).ravel()
    angle = float(np.linalg.norm(v))
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    if angle < 1e-6:
        left = np.eye(3) + 0.5 * cross
    else:
        left = (
            np.eye(3)
            + (1.0 - np.cos(angle)) / angle**2 * cross
            + (angle - np.sin(angle)) / angle**3 * cross @ cross
        )
    result = np.array(jacobian, dtype=np.float64)
    result[:, :3] = result[:, :3] @ np.linalg.inv(left)
    return result
