# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Bridges over what was not seen of a DLO: something must hide it there."""

from __future__ import annotations

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.cross_sections import SPREADS, Sections, offsets_for
from dlo_ros.vision.segmentation.picture_strip import (
    Float32,
    Mask,
    normals_of,
    resample,
    smooth_curve,
    strip_along,
)
from dlo_ros.vision.segmentation.ridge_map import Image

STEPS = 5  # cross-sections in a width
NEARBY = 8.0  # [widths] to both sides of a bridge, where the DLO shows how it looks
FEWEST_SECTIONS = 10  # of the DLO near a bridge that show how it looks
LONGEST_BARE = 1.0  # [widths] of bare board under a course that edges and noise may fake
BORDER = 1.0  # [widths] before and behind a bridge, where what hides the DLO may begin
BEFORE = 3.0  # [widths] up to which the ground is taken that goes on below a bridge
LEAST_STEP = 0.03  # of the DLO's contrast, from the ground to something pale upon it
SOFT = 0.25  # share of the step, from which on, and up to the rest of it, an edge climbs


def check_bridges(image: Image, pixels: FloatArray, seen: Mask, width: float) -> None:
    """Refuse a course that runs over the bare board between two parts of the DLO that were seen.

    Args:
        image: BGR.
        pixels: the course from start to end [px], shape (m, 2).
        seen: whether the DLO was seen there, shape (m,).
        width: width of the DLO [px].

    Raises:
        VisionError: with the reason.
    """
    if seen.all() or np.count_nonzero(seen) < FEWEST_SECTIONS:
        return
    course = resample(pixels, width / STEPS)
    visible = np.interp(np.linspace(0.0, 1.0, len(course)), _shares(pixels), seen) > 0.5
    changes = np.flatnonzero(np.diff(np.concatenate([[True], visible, [True]]).astype(np.int8)))
    # Near an end the DLO may have been held, or stop.
    bridges = [
        (first, last)
        for first, last in changes.reshape(-1, 2)
        if first > 0 and last < len(course) and last - first > LONGEST_BARE * STEPS
    ]
    if not bridges:
        return
    normals = normals_of(smooth_curve(course, float(STEPS)))
    offsets = offsets_for(width)
    index = np.arange(len(course))
    for first, last in bridges:
        reach = round(NEARBY * STEPS)
        own = visible & (index >= first - reach) & (index < last + reach)
        if np.count_nonzero(own) < FEWEST_SECTIONS:
            continue
        dlo = Sections.of(strip_along(image, course[own], normals[own], offsets), offsets, width)
        about = slice(max(0, first - round(BEFORE * STEPS)), last + round(BEFORE * STEPS))
        strip = strip_along(image, course[about], normals[about], offsets)
        first, last = first - about.start, last - about.start
        _, bare = dlo.odds(strip[first:last])
        bare_for = _longest((bare > 0.0) & ~_covered(dlo, strip, first, last)) / STEPS
        if bare_for > LONGEST_BARE:
            raise VisionError(
                f"what looks like the DLO leaves it for {bare_for:.1f} widths of bare board"
            )


def _covered(dlo: Sections, strip: Float32, first: int, last: int) -> Mask:
    """Which cross-sections of a bridge show something about as pale as the board, shape (b,).

    The ground that was seen on both sides of the DLO before and behind a bridge goes on below it.
    What hides the DLO has another colour, and a border where the bridge begins and where it stops.

    Args:
        dlo: the DLO near the bridge.
        strip: cross-sections of the course about the bridge, shape (m, k, 3).
        first, last: the bridge's among them (exclusive).
    """
    grounds = dlo.grounds(strip)
    border = round(BORDER * STEPS)
    around = grounds[:, : max(0, first - border)], grounds[:, last + border :]
    nothing = np.zeros(last - first, dtype=np.bool_)
    if min(part.shape[1] for part in around) == 0:
        return nothing
    contrast = max(float(np.linalg.norm(dlo.axis)), 1.0)
    levels = np.array([np.median(part, axis=1) for part in around])  # of both sides, (2, 2, 3)
    if np.linalg.norm(levels - dlo.board, axis=2).max() > dlo.same * contrast:
        return nothing
    spread = max(
        float(np.median(np.linalg.norm(part - level[:, None], axis=2)))
        for part, level in zip(around, levels, strict=True)
    )
    share = np.clip((np.arange(len(strip)) - first) / (last - first), 0.0, 1.0)[:, None]
    before, behind = levels.mean(axis=1)
    ground = before * (1.0 - share) + behind * share
    away = dlo.middles(strip[first:last]) - ground[first:last]
    covered = np.linalg.norm(away, axis=1) > max(LEAST_STEP * contrast, SPREADS * spread)
    if not covered.any():
        return nothing
    step = np.median(away[covered], axis=0)
    shares = (grounds - ground) @ step / max(float(step @ step), 1e-9)
    half = (first + last) // 2
    bordered = _has_border(shares[:, :half]) and _has_border(shares[:, half:][:, ::-1])
    return np.asarray(covered) if bordered else nothing


def _has_border(shares: FloatArray) -> bool:
    """Whether something begins at once, on either side of a course, and not softly as a shade does.

    Args:
        shares: of its colour, at both sides along the course, shape (2, m).
    """
    soft = np.count_nonzero((shares > SOFT) & (shares < 1.0 - SOFT), axis=1)
    begins = np.any(shares < SOFT, axis=1) & np.any(shares > 1.0 - SOFT, axis=1)
    return bool(np.any(begins & (soft <= LONGEST_BARE * STEPS)))


def _shares(points: FloatArray) -> FloatArray:
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    return np.asarray(s / s[-1])


def _longest(mask: Mask) -> int:
    """Length of the longest run where a mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
