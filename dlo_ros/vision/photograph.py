# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Every DLO in a photograph of which nothing is known: no camera, no width, no number.

The picture is searched for bars of several widths. What is followed over a long way with the same
width and contrast on both sides is a DLO; a fold, a wood grain or the edge of a sheet is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dlo_ros.spline import FloatArray
from dlo_ros.vision.fit.smoothing_spline import smooth
from dlo_ros.vision.segmentation.edge_profile import Located, locate
from dlo_ros.vision.segmentation.picture_strip import Mask, resample, smooth_curve, spacing_for
from dlo_ros.vision.segmentation.ridge_map import Image, RidgeMap, as_bgr, map_ridges
from dlo_ros.vision.segmentation.user_hints import Hints, limited
from dlo_ros.vision.tracing.chain_grouping import join
from dlo_ros.vision.tracing.chain_ordering import Path
from dlo_ros.vision.tracing.free_ends import free_end, prolong
from dlo_ros.vision.tracing.ridge_snapping import follow
from dlo_ros.vision.tracing.ridge_tracing import Chain, find_chains

NARROWEST = 4.0  # [px]
SMALLEST = 32  # [px] in a smaller picture nothing is looked for
NARROWEST_SHARE = 0.0016  # of the picture's larger side
LEAST_MEASURED = 0.6  # of the searched width: what is measured narrower is an edge, not a bar
RATIO = 1.6  # of one searched width to the next
WIDEST = 0.04  # of the picture's larger side
SHORTEST = 12.0  # [widths]
SHORTEST_SHARE = 0.1  # of the larger side of the picture
LEAST_SEEN = 0.7
LEAST_CONTRAST = 30.0  # [grey levels]
RELATIVE_CONTRAST = 0.3  # of that of the clearest DLO in the picture
RELATIVE_LENGTH = 0.15  # of that of the longest
CHAIN_CONTRAST = 0.15  # of that of the clearest long chain
LARGEST_IMBALANCE = 0.7
MOST_CHAINS = 500
MOST_COURSES = 50  # that are followed at one width
WIDTH_SPREAD = 0.22  # of the width: a DLO is equally wide all along
OVERLAP = 0.4  # share of a course that lies on a better one: it is the same DLO


@dataclass(frozen=True, eq=False)
class FoundDlo:
    """One DLO in a photograph.

    Args:
        pixels: centreline from start to end [px], shape (m, 2). The start is the end further left.
        u: share of the arc length in the picture, 0 to 1, shape (m,).
        seen: whether it was seen there (else bridged), shape (m,).
        width: [px].
        contrast: contrast to the background [grey levels].
    """

    pixels: FloatArray
    u: FloatArray
    seen: Mask
    width: float
    contrast: float

    @property
    def length(self) -> float:
        """Arc length [px]."""
        return float(np.sum(np.hypot(*np.diff(self.pixels, axis=0).T)))


def find_dlos(image: Image, hints: Hints | None = None) -> list[FoundDlo]:
    """All DLOs in a picture, the longest first; an empty list where there is none.

    Args:
        image: BGR or mono, uint8.
        hints: hints of the user on where the DLOs are.

    Raises:
        VisionError: it is no image.
        InputError: a mask or the empty board has another size than the image.
    """
    image = as_bgr(image)
    found: list[FoundDlo] = []
    largest = max(image.shape[:2])
    width = narrowest = max(NARROWEST, NARROWEST_SHARE * largest)
    if min(image.shape[:2]) < SMALLEST:
        return []
    while width <= max(narrowest, WIDEST * largest):
        allowed = None if hints is None else hints.allowed(image, width)
        if allowed is not None and not allowed.any():
            return []
        bars = map_ridges(image, width, allowed)
        for path in join(_clear(find_chains(bars), bars.width), bars)[:MOST_COURSES]:
            if path.length < 0.7 * SHORTEST * bars.width:
                break  # they come longest first
            dlo = _measured(image, bars, path, width, allowed)
            if dlo is not None:
                found.append(dlo)
        width *= RATIO
    return _distinct(found)


def _clear(chains: list[Chain], width: float) -> list[Chain]:
    """Chains that are not far fainter than the clearest long one."""
    strength = [c.strength for c in chains]
    long = [s for c, s in zip(chains, strength, strict=True) if c.length > 5 * width]
    least = CHAIN_CONTRAST * max(long, default=0.0)
    clear = [c for c, s in zip(chains, strength, strict=True) if s >= least]
    # In a picture full of texture only the longest can be parts of a DLO.
    return sorted(clear, key=lambda c: -len(c.points))[:MOST_CHAINS]


def _measured(
    image: Image, bars: RidgeMap, path: Path, width: float, allowed: Image | None
) -> FoundDlo | None:
    """Follow a course in the full picture; None where it is no DLO after all."""
    points = bars.to_image(path.points)
    narrowest = LEAST_MEASURED * width
    for _ in range(2):
        spacing = spacing_for(width)
        curve, extra = prolong(points, width, spacing, True, True)
        if len(curve) < 8:
            return None
        curve = smooth_curve(curve, 0.8 * width / spacing)
        moved = follow(image, curve, width, 0.6 * width, path.colour, path.contrast)
        located = limited(locate(image, resample(moved, spacing), width), allowed)
        low = free_end(located, extra, from_start=True)
        high = free_end(located, extra, from_start=False)
        shortest = max(SHORTEST * located.width, SHORTEST_SHARE * max(image.shape[:2]))
        if (high - low) * located.spacing < shortest:
            return None
        if located.width < narrowest:
            return None
        # The second round measures with the width that the first has found.
        width = located.width
        points = located.points[round(low) : round(high) + 1]
    return _credible(located, low, high)


def _credible(located: Located, low: float, high: float) -> FoundDlo | None:
    index = np.arange(len(located.curve), dtype=np.float64)
    inner = (index >= low) & (index <= high)
    seen = located.seen & inner
    if np.count_nonzero(seen) < LEAST_SEEN * np.count_nonzero(inner):
        return None
    if located.contrast < LEAST_CONTRAST or located.width_spread > WIDTH_SPREAD * located.width:
        return None
    if located.imbalance > LARGEST_IMBALANCE:
        return None
    span = 3.0 * located.width / located.spacing
    used = (located.trust > 0.0) & inner
    curve, _ = smooth(
        index[used], located.points[used], span, (low, high), trust=located.trust[used]
    )
    grid = np.linspace(low, high, max(50, int(high - low)))
    pixels = curve(grid)
    if pixels[0, 0] > pixels[-1, 0]:
        pixels, grid = pixels[::-1], grid[::-1]
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    visible = located.seen[np.clip(np.rint(grid).astype(int), 0, len(located.curve) - 1)]
    return FoundDlo(pixels, s / s[-1], visible, located.width, located.contrast)


def _distinct(found: list[FoundDlo]) -> list[FoundDlo]:
    """Leave out what was found a second time at another width, and what is far fainter."""
    found = sorted(found, key=lambda d: -float(np.mean(d.seen)) * d.length * d.contrast)
    kept: list[FoundDlo] = []
    for dlo in found:
        if kept and (
            dlo.contrast < RELATIVE_CONTRAST * max(k.contrast for k in kept)
            or dlo.length < RELATIVE_LENGTH * max(k.length for k in kept)
        ):
            continue
        covered = np.zeros(len(dlo.pixels), dtype=np.bool_)
        for other in kept:
            distance, _ = cKDTree(other.pixels).query(dlo.pixels)
            covered |= distance < 0.8 * max(dlo.width, other.width)
        if np.mean(covered) < OVERLAP:
            kept.append(dlo)
    return sorted(kept, key=lambda d: -d.length)
