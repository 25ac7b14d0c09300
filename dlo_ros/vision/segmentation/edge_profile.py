# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sub-pixel position of a DLO across a curve that is already close to it.

The picture is sampled on lines across the curve, which straightens the DLO into a strip. In the
strip its two edges are located, each against its own background, so that texture of the DLO, uneven
light and different ground on the two sides do not shift the middle.

A DLO that moves while the picture is taken has edges that climb over the exposure's path. The
window in which an edge is looked for holds the whole of it: in a shorter one the slope is alike
everywhere, and the edge would be found wherever it is expected.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.edge_levels import doubt_of_middle
from dlo_ros.vision.segmentation.edge_search import (
    FADE,
    band_mean,
    blur_length,
    climbing_length,
    middle_of,
    slope_towards,
    steepest_change,
)
from dlo_ros.vision.segmentation.medians import median, median_filter
from dlo_ros.vision.segmentation.picture_strip import (
    CORE,
    Float32,
    Mask,
    inside,
    normals_of,
    smooth_curve,
    smooth_strip,
    strip_along,
)
from dlo_ros.vision.segmentation.profile_masks import (
    eroded,
    filled,
    long_runs,
    odd_width,
    outliers,
    robust_std,
    running_median,
    without_islands,
)
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.segmentation.section_confirmation import confirm

GROUND = (0.75, 1.05)  # where its background is measured, in widths from the middle
FAINT = 0.01  # weight of a profile without an edge but of the DLO's colour
COLOUR_WINDOW = 4.0  # [widths] to each side, for the colour that the DLO has nearby
FOREIGN = 1.5  # times the contrast: no light changes a DLO's colour by that much
CERTAIN_LIKENESS = 0.75  # likeness that needs no second edge
LONGEST_SINGLE = 4.0  # [widths] along which one edge alone may show the DLO
ISLAND = 1.5  # [widths] a shorter piece between two longer gaps is chance
WEAK_SIDE = 0.3  # a side of less than this share of the usual contrast shows no edge
MOST_TONES = 4  # of a DLO that changes its colour, those between two counted as well
FREE_HALF = (0.3, 0.75)  # [widths] that half the measured width may be
KNOWN_HALF = (0.44, 0.56)  # the same where the width is known
BLUR_WINDOW = 4.0  # [widths] to each side, for the length over which edges climb
WIDEST_WINDOW = 0.65  # [widths] from an edge to the end of the strip that is sampled
SAMPLING_STD = 0.027  # [px] systematic errors of sampling that scatter does not show
SPEED_CHANGE = 0.3
"""Standard deviation of the share by which a DLO's speed changes while a picture is taken.

One that swings at 3 Hz turns its phase by that within 1/60 s. A picture shows the mean over the
exposure, the stamp means its middle: they are SPEED_CHANGE / 24 of the path apart.
"""
COLOUR_LIMIT = 0.6  # of the contrast: a larger change of colour is another object


@dataclass(frozen=True, eq=False)
class Located:
    """The DLO's middle along a curve.

    Args:
        curve: points of the curve that was searched across [px], shape (m, 2).
        normals: unit normals there, shape (m, 2).
        offset: offset of the DLO's middle along the normal [px], shape (m,); interpolated where
            unseen.
        seen: whether an edge was found there, shape (m,).
        likeness: similarity of the colour in the middle to the DLO's, 1 equal and 0 different,
            shape (m,).
        width: width of the DLO [px].
        contrast: median contrast to the background [grey levels].
        colour: median colour of the DLO, BGR, shape (3,).
        spacing: distance between the curve's points [px].
        width_spread: standard deviation of the width along the DLO [px] (robust).
        imbalance: difference of the backgrounds on the two sides over the contrast to the nearer
            one, median; large along the edge of an object.
        blur: length over which light was smeared across the DLO, by motion or by the lens [px],
            shape (m,).
        doubt: uncertainty of the middle of the usual cross-section [px], shape (m,).
        known_width, tones: arguments of `locate`.
        excluded: places where the user says that the DLO is not, shape (m,); None: nowhere.
        apart: distance of the two edges [px], NaN where only one was found, shape (m,).
    """

    curve: FloatArray
    normals: FloatArray
    offset: FloatArray
    seen: Mask
    likeness: FloatArray
    width: float
    contrast: float
    colour: FloatArray
    spacing: float
    width_spread: float
    imbalance: float
    blur: FloatArray
    doubt: FloatArray
    known_width: bool = False
    tones: bool = False
    excluded: Mask | None = None
    apart: FloatArray | None = None

    @property
    def trust(self) -> FloatArray:
        """Weight of each profile in a fit: 1 where seen, little where only the colour fits."""
        return np.where(self.seen, 1.0, np.where(self.likeness > CERTAIN_LIKENESS, FAINT, 0.0))

    @property
    def shared_std(self) -> FloatArray:
        """Standard deviation of what all profiles of a place have in common [px], shape (m,).

        A DLO whose speed changes during the exposure is seen beside where it is at the middle of
        it, by a share of the path; a highlight or a shadow of its own shifts its middle. Without
        `SAMPLING_STD`, which is part of the doubt.
        """
        lopsided = np.maximum(self.doubt**2 - SAMPLING_STD**2, 0.0)
        return np.asarray(np.sqrt(lopsided + (SPEED_CHANGE / 24.0 * self.blur) ** 2))

    @property
    def points(self) -> FloatArray:
        """The middle of the DLO [px], shape (m, 2)."""
        return self.curve + self.offset[:, None] * self.normals


def locate(
    image: Image,
    curve: FloatArray,
    width: float,
    colour: FloatArray | None = None,
    *,
    known_width: bool = False,
    tones: bool = False,
) -> Located:
    """Sub-pixel middle of the DLO across a curve that lies on it to about a third of its width.

    Args:
        image: BGR.
        curve: equally spaced points [px], shape (m, 2).
        width: width of the DLO [px], to about a fifth; it is measured anew.
        colour: colour of the DLO where it is known.
        known_width: the edges lie the width apart to a tenth; what lies otherwise is none.
        tones: whether the DLO changes its colour along itself.
    """
    spacing = median(np.hypot(*np.diff(curve, axis=0).T))
    normals = normals_of(smooth_curve(curve, width / spacing))
    step = float(np.clip(width / 12.0, 0.5, 1.5))
    reach = int(np.ceil(1.15 * width / step))
    offsets: FloatArray = np.arange(-reach, reach + 1.0) * step
    strip = strip_along(image, curve, normals, offsets)
    along = 0.4 * width / spacing

    fine = smooth_strip(strip, along)

    def mean(low: float, high: float) -> Float32:
        first, last = np.searchsorted(offsets, [low * width - 1e-6, high * width + 1e-6])
        return np.asarray(band_mean(fine, first, last))

    core, left, right = mean(-CORE, CORE), mean(-GROUND[1], -GROUND[0]), mean(*GROUND)
    # A DLO of two tones may have one of them at either edge.
    core_left = mean(-CORE, -0.05) if known_width else core
    core_right = mean(0.05, CORE) if known_width else core
    contrast_left = np.linalg.norm(core_left - left, axis=1)
    contrast_right = np.linalg.norm(core_right - right, axis=1)
    usual = median(np.minimum(contrast_left, contrast_right))
    usual = max(usual, 1.0)
    typical = np.median(core, axis=0) if colour is None else colour
    middle = np.zeros(len(curve))
    half = 0.5 * width
    slope_left, climb_left = slope_towards(fine, offsets, core_left - left)
    slope_right, climb_right = slope_towards(fine, offsets, right - core_right)
    least = min(0.42 * width, 0.25 * width + 2.0)
    one_sided: FloatArray | float = 0.0
    for _ in range(2):
        # A motion smears both edges alike, and its path changes slowly along the DLO. What climbs
        # more slowly at one edge, or for a short way, is something else beside the DLO.
        ramp = np.minimum(
            climbing_length(slope_left, offsets, climb_left, middle - half, least),
            climbing_length(slope_right, offsets, climb_right, middle + half, least),
        )
        ramp = running_median(ramp, 2 * round(BLUR_WINDOW * width / spacing) + 1)
        # The expected place may be anywhere in the ramp, so the window is as wide to either side.
        window = np.clip(ramp / (1.0 - FADE), least, max(least, WIDEST_WINDOW * width))
        edge_left, found_left = steepest_change(
            slope_left, offsets, climb_left, middle - half, window, width
        )
        edge_right, found_right = steepest_change(
            slope_right, offsets, climb_right, middle + half, window, width
        )
        found_left &= contrast_left > WEAK_SIDE * usual
        found_right &= contrast_right > WEAK_SIDE * usual
        both = found_left & found_right
        if np.any(both):
            measured = 0.5 * median((edge_right - edge_left)[both])
            low, high = KNOWN_HALF if known_width else FREE_HALF
            half = float(np.clip(measured, low * width, high * width))
            # Edges that do not lie the width apart: one of them is something else's.
            one_sided = abs(measured - 0.5 * width) if measured != half else 0.0
        middle, seen = middle_of(edge_left, found_left, edge_right, found_right, half)
        size = max(3, 2 * round(width / spacing) + 1)
        middle = median_filter(filled(middle, seen), size)
    middle, seen = middle_of(edge_left, found_left, edge_right, found_right, half)
    seen &= ~(both & odd_width(edge_right - edge_left, both, width / spacing))
    nearer = np.minimum(contrast_left, contrast_right)
    likeness = _likeness(core, nearer, seen & both, np.asarray(typical), usual, width / spacing)
    if tones:
        likeness = np.maximum(likeness, _likeness_of_tones(core, seen & both, usual))
    likeness[~inside(image, curve)] = 0.0
    # The right width between two edges makes up for a changed colour, as in a shadow; a single
    # edge may be that of whatever hides the DLO.
    alike = np.where(both, likeness > 1.0 - COLOUR_LIMIT, likeness > CERTAIN_LIKENESS)
    seen &= eroded(alike, round(along))
    # Beside a hole a single edge will do; a long one is that of something else.
    seen &= both | ~long_runs(seen & ~both, round(LONGEST_SINGLE * width / spacing))
    seen &= inside(image, curve + middle[:, None] * normals, 1.0)
    seen &= ~outliers(middle, seen, width, spacing)
    longest = round(ISLAND * width / spacing)
    edge_std = robust_std((edge_right - edge_left)[both])
    points = curve + middle[:, None] * normals
    seen, unsure = confirm(points, normals, seen, both, width, spacing, along, longest, edge_std)
    seen = without_islands(seen, longest)
    axis = core - 0.5 * (left + right)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-6)[:, None]
    across = np.einsum("ikc,ic->ik", strip, axis)
    lopsided = doubt_of_middle(across, offsets, middle, seen, 2.0 * half, spacing)
    if known_width and np.any(both):
        # A third edge lies beside the DLO's: where the distance of two changes, it is one of them.
        apart = filled(edge_right - edge_left, both)
        apart = running_median(apart, 2 * round(BLUR_WINDOW * width / spacing) + 1)
        one_sided = np.asarray(np.hypot(one_sided, 0.5 * np.abs(apart - 2.0 * half)))
    return Located(
        curve,
        normals,
        filled(middle, seen),
        np.asarray(seen, dtype=np.bool_),
        likeness.astype(np.float64),
        2.0 * half,
        usual,
        np.asarray(typical, dtype=np.float64),
        spacing,
        edge_std,
        median(np.linalg.norm(left - right, axis=1)) / usual,
        blur_length(ramp, step),
        np.hypot(np.hypot(lopsided, one_sided), unsure),
        known_width,
        tones,
        apart=np.where(both, edge_right - edge_left, np.nan),
    )


def _likeness(
    core: Float32,
    contrast: FloatArray,
    sure: Mask,
    typical: FloatArray,
    usual: float,
    profiles: float,
) -> FloatArray:
    """Similarity of the middle's colour to the DLO's nearby, where both edges were seen.

    Light changes along a DLO, so the colour is compared in its neighbourhood; where it is hidden,
    and beyond its ends, with the nearest that was seen.
    """
    index = np.arange(len(core))
    if np.count_nonzero(sure) < 5:
        unlike = np.linalg.norm(core - typical, axis=1) / usual
        return np.asarray(np.clip(1.0 - unlike, 0.0, 1.0), dtype=np.float64)
    # Foreign edges that happen to have the right distance are not of the DLO's colour at all.
    foreign = np.linalg.norm(core - typical, axis=1) > FOREIGN * max(usual, 30.0)
    sure = sure & ~foreign if np.count_nonzero(sure & ~foreign) >= 5 else sure
    at = index[sure]
    size = 2 * round(COLOUR_WINDOW * profiles) + 1
    columns = [running_median(core[sure, c].astype(np.float64), size) for c in range(3)]
    near = np.column_stack([np.interp(index, at, column) for column in columns])
    scale = np.interp(index, at, running_median(contrast[sure].astype(np.float64), size))
    unlike = np.linalg.norm(core - near, axis=1) / np.maximum(scale, 0.5 * usual)
    return np.asarray(np.clip(1.0 - unlike, 0.0, 1.0), dtype=np.float64)


def _likeness_of_tones(core: Float32, sure: Mask, usual: float) -> FloatArray:
    """Similarity of the middle's colour to any of the colours of a DLO of several tones."""
    if np.count_nonzero(sure) < MOST_TONES:
        return np.zeros(len(core))
    own = core[sure]
    # Begun with quantiles of the brightness: a random start would give other results each time.
    rank = np.argsort(np.argsort(own.sum(axis=1), kind="stable"), kind="stable")
    _, _, tones = cv2.kmeans(
        own,
        MOST_TONES,
        (rank * MOST_TONES // len(own)).astype(np.int32)[:, None],
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 1.0),
        1,
        cv2.KMEANS_USE_INITIAL_LABELS,
    )
    unlike = np.linalg.norm(core[:, None] - tones[None], axis=2).min(axis=1) / usual
    return np.asarray(np.clip(1.0 - unlike, 0.0, 1.0), dtype=np.float64)
