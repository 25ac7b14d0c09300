# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The DLO located along a course of which the picture's ridges tell about where it runs.

A strong shadow may stand out more than the DLO that casts it. But it only takes light away, of all
colours by the same share; what lies beside it, and is no such share of the ground, is the DLO.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.edge_profile import Located, locate
from dlo_ros.vision.segmentation.picture_strip import (
    resample,
    smooth_curve,
    spacing_for,
    strip_along,
)
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.tracing.centring import centred
from dlo_ros.vision.tracing.ridge_snapping import follow

UNEQUAL = 0.5  # [contrasts] grounds on both sides that differ by less leave no DLO beside a shadow
NEUTRAL = 0.1  # of a shadow's contrast, by which noise and coloured light change its colour
PLACES: FloatArray = np.array([-1.05, 0.0, 1.0, 1.9])
"""[widths] Middles of the ground, a shadow, the DLO that casts it, and the ground beyond."""
BREADTH: FloatArray = 0.15 * np.linspace(-1.0, 1.0, 5)  # [widths] about each of them


@dataclass(frozen=True, eq=False)
class RoughDetection:
    """What is known of a DLO that was found on the whole, but not measured yet.

    Args:
        colour: BGR, shape (3,).
        contrast: to the ground [grey levels].
        width: [px], by the diameter.
        known_width, tones: see `locate`.
    """

    colour: FloatArray
    contrast: float
    width: float
    known_width: bool
    tones: bool


def locate_course(image: Image, curve: FloatArray, width: float, rough: RoughDetection) -> Located:
    """Locate the DLO along a course that lies about on it.

    Args:
        image: BGR.
        curve: equally spaced points [px], shape (m, 2).
        width: width of the DLO as it was seen [px].
        rough: what is known of the DLO.
    """
    spacing = spacing_for(width)
    curve = smooth_curve(curve, 0.8 * width / spacing)
    colour = None if rough.tones else rough.colour
    moved = follow(image, curve, width, 0.8 * width, colour, rough.contrast)
    moved, aside = centred(image, resample(moved, spacing), rough.width)
    known = aside or rough.known_width
    if known:  # then what looks like edges is no reliable measure of the width
        width = rough.width
    at = resample(moved, spacing)
    located = locate(image, at, width, known_width=known, tones=rough.tones)
    side = side_of_caster(image, located)
    if side == 0:
        return located
    at = resample(located.points + side * located.width * located.normals, spacing)
    return locate(image, at, rough.width, known_width=True, tones=rough.tones)


def side_of_caster(image: Image, located: Located) -> int:
    """Side, 1 along the normals or -1, on which a DLO lies whose shadow was located; 0: none.

    Args:
        image: BGR.
        located: what was located in it.
    """
    if located.imbalance < UNEQUAL or not np.any(located.seen):
        return 0
    points, normals = located.points[located.seen], located.normals[located.seen]
    for side in (1, -1):
        offsets = side * located.width * (PLACES[:, None] + BREADTH).ravel()
        usual = np.median(strip_along(image, points, normals, offsets), axis=0)
        ground, shadow, dlo, beyond = usual.reshape(len(PLACES), -1, 3).mean(axis=1)
        contrast = max(float(np.linalg.norm(shadow - ground)), 1.0)
        if not_shaded(shadow, ground) < NEUTRAL * contrast < not_shaded(dlo, beyond):
            return side
    return 0


def not_shaded(colour: FloatArray, ground: FloatArray) -> float:
    """Distance of a colour from the nearest one that the ground has in a shadow [grey levels].

    Args:
        colour, ground: BGR, shapes (3,).
    """
    share = np.clip(colour @ ground / max(float(ground @ ground), 1.0), 0.0, 1.0)
    return float(np.linalg.norm(colour - share * ground))
