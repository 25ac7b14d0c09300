# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The result of one image, and the part of it that helps to find the DLO in the next."""

from __future__ import annotations

from dataclasses import dataclass

from dlo_ros.observation import Observation
from dlo_ros.spline import FloatArray
from dlo_ros.vision.fit.planar_clamps import EndPoses
from dlo_ros.vision.fit.spline_fit import SplineFit
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.picture_strip import Mask


@dataclass(frozen=True, eq=False)
class VisionResult:
    """The result of one image.

    Args:
        observation: control points and measured points, with the image's stamp.
        residual: root mean square distance of the measured points across the spline [m].
        residual_px: the same [px].
        fraction_seen: share of the length where the DLO was seen.
        seen_length: length from end to end [m]; compare with rod.length.
        pixels: the centreline in the image, from start to end [px], shape (m, 2).
        pixels_seen: whether each pixel of the centreline was seen (else bridged), shape (m,).
        width: width of the DLO [px].
        contrast: contrast of the DLO to its background [grey levels].
        tracked: whether the last shape's surroundings sufficed (else the whole image was searched).
    """

    observation: Observation
    residual: float
    residual_px: float
    fraction_seen: float
    seen_length: float
    pixels: FloatArray
    pixels_seen: Mask
    width: float
    contrast: float
    tracked: bool

    @classmethod
    def of(
        cls, fit: SplineFit, located: Located, pixels: FloatArray, *, tracked: bool
    ) -> VisionResult:
        """The result of a fit.

        Args:
            fit: the fitted spline.
            located: the DLO in the picture.
            pixels, tracked: see the class.
        """
        return cls(
            fit.observation,
            fit.residual,
            fit.residual_px,
            fit.fraction_seen,
            fit.seen_length,
            pixels,
            fit.curve_seen,
            located.width,
            located.contrast,
            tracked,
        )


@dataclass(frozen=True, eq=False)
class LastShape:
    """The last shape, from which tracking starts."""

    stamp: int
    curve: FloatArray
    seen_length: float
    width: float
    colour: FloatArray
    contrast: float
    ends: EndPoses
    known_width: bool
    tones: bool

    @classmethod
    def of(
        cls, stamp: int, curve: FloatArray, seen_length: float, located: Located, ends: EndPoses
    ) -> LastShape:
        """The shape of a picture.

        Args:
            stamp: stamp of the picture [ns].
            curve: points (x, z) of the shape [m], equally spaced in u, shape (m, 2).
            seen_length: length from end to end [m].
            located: the DLO in the picture.
            ends: the clamps at that stamp.
        """
        return cls(
            stamp,
            curve,
            seen_length,
            located.width,
            located.colour,
            located.contrast,
            ends,
            located.known_width,
            located.tones,
        )

    def velocity_to(self, curve: FloatArray, stamp: int) -> FloatArray | None:
        """Velocity of the points of a later shape, (m, 2) [m/s]; None where it is no later."""
        elapsed = (stamp - self.stamp) * 1e-9
        return (curve - self.curve) / elapsed if elapsed > 0.0 else None
