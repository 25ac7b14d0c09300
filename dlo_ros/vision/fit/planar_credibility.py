# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Credibility of a detection: whether it can be the DLO, and defects of pictures without one."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.fit.control_point_count import choose_control_points
from dlo_ros.vision.fit.planar_clamps import EndPoses
from dlo_ros.vision.fit.spline_fit import SplineFit
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.tracing.occlusion_bridges import check_bridges
from dlo_ros.vision.tracing.strip_change import check_strips

LEAST_SEEN = 0.55  # share of the length that must be seen
LENGTH_LIMITS = ((0.03, 0.03), (0.1, 0.05), (0.12, 0.12))
"""By how much of L what is seen may be too short or too long where no end, one or both are held. A
DLO that is held at one end and seen short is one whose other end is hidden."""
WIDEST = 1.35  # diameters that a DLO may look wide, where the file's diameter is 12 % too small
NARROWEST = 1.0 / WIDEST  # diameters: what looks narrower is a strip of the DLO or of its shadow
FAINT = 60.0  # [grey levels] a DLO of less contrast may not differ from its own shadow,
WIDEST_FAINT = 1.16  # so that this is the limit: with its shadow it looks at least 1.17 wide
TRACKING_LENGTH_LIMIT = 0.03  # of the length at the last frame
LARGEST_RESIDUAL = 1.0  # [widths] between measured points and spline

MOST_BESIDE = 0.1  # of L that an end may be seen beside the place where the command has its clamp
SHARPEST = 0.55  # [rad] over its own width that a DLO bends: a radius of 1.8 widths

SATURATED = 0.5  # share of pixels that are all white or all black, beyond which that is the reason
BRIGHTEST, DARKEST = 253, 2  # [grey levels]
DARK = 40.0  # [grey levels] the brightest that a picture shows which is too dark
BLURRED = 0.7  # [widths] standard deviation of a blur that leaves no edges
LEAST_EDGE = 8.0  # [grey levels] in a picture with less there is nothing to be blurred
EDGES = 99.8  # [%] what is meant by the sharpest edges of a picture
LOOKED_AT = 100  # rows, or columns, of a picture that are looked at


class IncompleteError(VisionError):
    """A shape that may be a part of the DLO, but is not the whole DLO."""


def check(
    fit: SplineFit, located: Located, ends: EndPoses, camera: Camera, length: float, diameter: float
) -> None:
    """Check that a detection is credible.

    Args:
        fit: fitted spline of the detected DLO.
        located: the DLO as it was located in the picture.
        ends: the clamps.
        camera: camera of the picture.
        length: length of the DLO, L [m].
        diameter: diameter of the DLO [m].

    Raises:
        VisionError: with the reason; `IncompleteError` where it may be a part of the DLO.
    """
    faint = located.contrast < FAINT
    if fit.width > diameter * (WIDEST_FAINT if faint else WIDEST):
        raise VisionError(
            f"what looks like the DLO is {1000 * fit.width:.3g} mm wide, rod.diameter is "
            f"{1000 * diameter:.3g} mm; its shadow may have been taken for it"
        )
    if fit.width < diameter * NARROWEST:
        raise VisionError(
            f"what looks like the DLO is {1000 * fit.width:.3g} mm wide, rod.diameter is "
            f"{1000 * diameter:.3g} mm; a part of it or its shadow may have been taken for it"
        )
    if fit.fraction_seen < LEAST_SEEN:
        raise IncompleteError(
            f"only {100 * fit.fraction_seen:.0f} % of the DLO is visible, at least "
            f"{100 * LEAST_SEEN:.0f} % are needed"
        )
    edge = np.array([camera.width, camera.height]) - 1.0
    for end, at in ((ends.start, 0), (ends.end, -1)):
        if end is None:
            x, z = fit.curve[at]
            pixel = camera.project(np.array([[x, 0.0, z]]))[0]
            if np.min(np.minimum(pixel, edge - pixel)) < 0.5 * located.width:
                raise IncompleteError("what looks like the DLO runs out of the picture")
    held = (ends.start is not None) + (ends.end is not None)
    short, long = LENGTH_LIMITS[held]
    if not 1.0 - short < fit.visible_length / length < 1.0 + long:
        raise IncompleteError(
            f"what looks like the DLO is {fit.visible_length:.3g} m long, rod.length is "
            f"{length:.3g} m"
        )
    if fit.residual_px > LARGEST_RESIDUAL * located.width:
        raise VisionError(
            f"the spline misses the measured centreline by {1000 * fit.residual:.1f} mm; "
            f"more control points are needed{_enough(fit, length)}, or it is no DLO"
        )
    if sharpest_turn(fit.curve, fit.width) > SHARPEST:
        raise VisionError("what looks like the DLO bends more sharply than one can")
    if ends.doubted is not None:
        places = zip(fit.curve[[0, -1]], ends.doubted, strict=True)
        beside = max(float(np.hypot(*(end - place))) for end, place in places if place is not None)
        if beside > MOST_BESIDE * length:
            raise VisionError(
                f"an end of what looks like the DLO lies {1000 * beside:.3g} mm beside its clamp"
            )


def sharpest_turn(curve: FloatArray, width: float) -> float:
    """Largest change of direction of a curve over its own width [rad].

    Args:
        curve: (x, z) [m], shape (m, 2).
        width: [m].
    """
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    at = np.linspace(0.0, s[-1], max(8, round(2.0 * float(s[-1]) / width)))
    x, z = (np.diff(np.interp(at, s, column)) for column in curve.T)
    ahead, behind = slice(2, None), slice(None, -2)
    turn = np.arctan2(
        x[behind] * z[ahead] - z[behind] * x[ahead], x[behind] * x[ahead] + z[behind] * z[ahead]
    )
    return float(np.abs(turn).max())


def _enough(fit: SplineFit, length: float) -> str:
    points = fit.observation.points
    try:
        return "" if points is None else f" ({choose_control_points(points, length)} would do)"
    except VisionError:
        return ""


def check_change(length: float, before: float) -> None:
    """Check that the seen length is that of the last image.

    Args:
        length, before: seen length, now and in the last image [m].

    Raises:
        VisionError: with the reason.
    """
    change = abs(length / before - 1.0)
    if change > TRACKING_LENGTH_LIMIT:
        raise VisionError(f"the length changed by {100 * change:.1f} % since the last image")


def check_gaps(image: Image, pixels: FloatArray, seen: Mask, width: float, contrast: float) -> None:
    """Refuse a course that leaves the DLO, or changes over to another strip, where it was unseen.

    Args:
        image: BGR.
        pixels: the course from start to end [px], shape (m, 2).
        seen: whether the DLO was seen there, shape (m,).
        width: width of the DLO [px].
        contrast: its contrast [grey levels].

    Raises:
        VisionError: with the reason.
    """
    check_bridges(image, pixels, seen, width)
    check_strips(image, pixels, seen, width, contrast)


def unusable(image: Image, width: float) -> str:
    """Defect of a picture, if any: overexposed, dark or blurred.

    Args:
        image: BGR.
        width: expected width of the DLO [px].
    """
    grey = _some_rows(image)
    white = float(np.mean(grey >= BRIGHTEST))
    if white > SATURATED:
        return f"the picture is overexposed, {100 * white:.0f} % of it are saturated"
    black = float(np.mean(grey <= DARKEST))
    if black > SATURATED and np.percentile(grey, EDGES) < DARK:
        return f"the picture is too dark, {100 * black:.0f} % of it are black"
    # A DLO that lies along the rows has no edge that a row crosses at a right angle.
    along = [_edges(lines, width) for lines in (image, image.transpose(1, 0, 2))]
    near, contrast = np.max(along, axis=0)
    # An edge of contrast c blurred by sigma climbs by c / (sigma sqrt(2 pi)) a pixel.
    blur = contrast / max(near, 1e-6) / np.sqrt(2.0 * np.pi)
    if contrast > LEAST_EDGE and blur > max(BLURRED * width, 2.0):
        return "the picture is blurred"
    return ""


def _edges(image: Image, width: float) -> tuple[float, float]:
    """How much the sharpest edges that rows of a picture cross climb in a pixel, and in all.

    Args:
        image: BGR.
        width: expected width of the DLO [px].

    Returns:
        Both in grey levels; zero where the rows are too short for the DLO.
    """
    grey = _some_rows(image)
    far = max(2, round(2.0 * width))
    if grey.shape[1] <= 4 * far:
        return 0.0, 0.0
    # Grain is taken out first, which blurs by about a pixel itself.
    smooth = cv2.GaussianBlur(grey, (0, 0), sigmaX=1.0, sigmaY=0.01)
    near = np.percentile(np.abs(smooth[:, 2:] - smooth[:, :-2]), EDGES) / 2.0
    contrast = np.percentile(np.abs(smooth[:, 2 * far :] - smooth[:, : -2 * far]), EDGES)
    return float(near), float(contrast)


def _some_rows(image: Image) -> NDArray[np.float32]:
    """Grey levels of about `LOOKED_AT` rows of a BGR picture."""
    rows = np.ascontiguousarray(image[:: max(1, image.shape[0] // LOOKED_AT)])
    return np.asarray(cv2.cvtColor(rows, cv2.COLOR_BGR2GRAY), np.float32)
