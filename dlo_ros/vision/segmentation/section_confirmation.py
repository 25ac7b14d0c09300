# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Cross-sections that those before and behind them must confirm.

Two edges that lie the DLO's width apart are the DLO's. A single edge may be that of another strand
or of what hides the DLO, and so may two edges beside a gap, since means along the DLO mix what lies
to both sides of the gap's edge. But a DLO bends smoothly: a cubic through the sure sections
to both sides predicts the middle with a standard deviation, and what lies elsewhere is no DLO.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.medians import median
from dlo_ros.vision.segmentation.picture_strip import Mask
from dlo_ros.vision.segmentation.profile_masks import eroded

NEARBY = 4.0  # [widths] to both sides of a stretch, along which sure sections predict it
ORDER = 4  # coefficients of a cubic
BEYOND = 3.0  # standard deviations of an edge that is something else's
LEAST_CERTAIN = 0.05  # [widths] standard deviation of a prediction that confirms nothing
FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
"""Fourth difference: of a smooth curve it is small, so that it measures the scatter."""


def confirm(
    points: FloatArray,
    normals: FloatArray,
    seen: Mask,
    both: Mask,
    width: float,
    spacing: float,
    along: float,
    longest: int,
    edge_std: float,
) -> tuple[Mask, FloatArray]:
    """Mask of the sections that are the DLO's, and the standard deviation of the doubtful ones.

    Args:
        points: middles of the sections [px], shape (m, 2).
        normals: unit normals, shape (m, 2).
        seen: whether a middle was found, shape (m,).
        both: whether from two edges, shape (m,).
        width: width of the DLO [px].
        spacing: distance between the sections [px].
        along: standard deviation of the weights of the means along the DLO, in sections.
        longest: sections; a longer gap is one beside which the means mix.
        edge_std: standard deviation of the distance of the two edges [px].

    Returns:
        The mask without what the sure sections do not confirm, shape (m,), and the standard
        deviation of the prediction at what they do, 0 at sure sections [px], shape (m,).
    """
    sure = seen & both
    gaps = _longer(~sure, longest)
    sure &= eroded(~gaps, max(1, round(2.0 * along)))
    doubtful = seen & ~sure
    doubt = np.zeros(len(seen))
    scatter = _scatter(points, normals, sure, max(1, round(width / spacing)))
    if not np.any(doubtful) or not np.isfinite(scatter):
        return seen, doubt
    # Means along the DLO make so many sections count as one.
    alike = max(1.0, 2.0 * np.sqrt(np.pi) * along)
    result = seen.copy()
    reach = round(NEARBY * width / spacing)
    for first, last in _runs(~sure):
        at = first + np.flatnonzero(doubtful[first:last])
        low = max(first - reach, 0)
        near = low + np.flatnonzero(sure[low : last + reach])
        if len(at) == 0:
            continue
        result[at] = False
        if len(near) < 2 * ORDER:
            continue
        middle, half = 0.5 * (near[0] + near[-1]), 0.5 * (near[-1] - near[0])
        basis = np.vander((near - middle) / half, ORDER)
        here = np.vander((at - middle) / half, ORDER)
        inverse = np.linalg.inv(basis.T @ basis)
        predicted = here @ (inverse @ (basis.T @ points[near]))
        std = scatter * np.sqrt(alike * np.einsum("ij,jk,ik->i", here, inverse, here))
        apart = np.abs(np.sum((points[at] - predicted) * normals[at], axis=1))
        limit = BEYOND * np.sqrt(std**2 + scatter**2 + (0.5 * edge_std) ** 2)
        result[at] = (apart < limit) & (std < LEAST_CERTAIN * width)
        doubt[at] = std
    return result, doubt


def _scatter(points: FloatArray, normals: FloatArray, sure: Mask, lag: int) -> float:
    """Standard deviation of sure sections across the DLO [px]; infinite where too few are sure."""
    count = len(points) - 4 * lag
    if count < 1:
        return float("inf")
    parts = [slice(k * lag, k * lag + count) for k in range(len(FOURTH))]
    whole = np.logical_and.reduce([sure[part] for part in parts])
    if np.count_nonzero(whole) < 2 * ORDER:
        return float("inf")
    fourth = sum(c * points[part] for c, part in zip(FOURTH, parts, strict=True))
    across = np.sum(fourth * normals[parts[2]], axis=1)[whole]
    return 1.4826 * float(median(np.abs(across)) / np.linalg.norm(FOURTH))


def _runs(mask: Mask) -> np.ndarray:
    """First and last index (exclusive) of each run where a mask is true, shape (k, 2)."""
    return np.flatnonzero(
        np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    ).reshape(-1, 2)


def _longer(mask: Mask, size: int) -> Mask:
    """The mask without runs that are not longer than a size."""
    result = np.zeros_like(mask)
    for first, last in _runs(mask):
        result[first:last] = last - first > size
    return result
