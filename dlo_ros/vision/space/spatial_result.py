# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The result of the pictures of one instant in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dlo_ros.observation import Observation
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.segmentation.picture_strip import Mask


@dataclass(frozen=True, eq=False)
class SpaceFit:
    """The fine spline through the centrelines of all views.

    Args:
        basis: basis of the fine spline.
        points: control points of the fine spline [m], shape (k, 3).
        covariance: covariance of the control points, x y z of the first, then of the second ...,
            shape (3 k, 3 k) [m^2].
        stretch: relative stretch: seen length over L, less 1.
        residuals: residuals of each view's points across its centreline [px], each of shape (m,).
        u: material coordinates of each view's points [m], each of shape (m,).
        stds: standard deviations of the views' points, estimated from the residuals [px], each of
            shape (m,).
        weights: robust ones, each of shape (m,).
        roughness: density of the squared third derivative [1/m^3], which bridges what is not seen.
    """

    basis: SplineBasis
    points: FloatArray
    covariance: FloatArray
    stretch: float
    residuals: tuple[FloatArray, ...]
    u: tuple[FloatArray, ...]
    stds: tuple[FloatArray, ...]
    weights: tuple[FloatArray, ...]
    roughness: float

    def covariance_at(self, u: FloatArray) -> FloatArray:
        """Covariance of the curve's points at material coordinates [m], shape (m, 3, 3) [m^2]."""
        return self.covariance_of(self.basis.matrix(u))

    def covariance_of(self, b: FloatArray) -> FloatArray:
        """Covariance of the curve's points [m^2], shape (m, 3, 3).

        Args:
            b: values of the basis functions there, shape (m, k).
        """
        k = self.basis.control_points
        half = (b @ self.covariance.reshape(k, -1)).reshape(len(b), 3, k, 3)
        return np.asarray(np.einsum("majb,mj->mab", half, b))

    def tangents(self, u: FloatArray) -> FloatArray:
        """Unit vectors along growing u at material coordinates [m], shape (m, 3)."""
        return self.tangents_of(self.basis.matrix(u, 1))

    def tangents_of(self, slopes: FloatArray) -> FloatArray:
        """Unit vectors along growing u, shape (m, 3).

        Args:
            slopes: derivatives of the basis functions there, shape (m, k).
        """
        d = slopes @ self.points
        return np.asarray(d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-300))


@dataclass(frozen=True, eq=False)
class SpaceResult:
    """The result of the pictures of one instant.

    Args:
        observation: control points and measured points, with the stamp of the first camera.
        fit: the fine spline.
        views: result of each camera, by its name; all share the observation.
        offset: largest difference of the pictures' stamps [s].
        seen_by_several: share of the length that two cameras saw, or one with its depth.
        seen: whether anything was seen at each of 400 equal steps of u.
    """

    observation: Observation
    fit: SpaceFit
    views: Mapping[str, VisionResult]
    offset: float
    seen_by_several: float
    seen: Mask
