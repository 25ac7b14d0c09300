# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Cross-sections of a picture along a course, compared with the DLO's own and the bare board."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.picture_strip import CORE, Float32, Mask

ACROSS = 1.05  # [widths] half the breadth of a cross-section
SAMPLES = 10  # of a cross-section, in a width
SIDES = 0.75  # [widths] from the middle, where the board begins
AMPLITUDE_STD = 0.12  # of the DLO's contrast, as texture and shading change it along the DLO
MISFIT_STD = 0.06  # of the contrast, beyond the template's own misfit
HALF = 0.65  # of a cross-section: one edge of the DLO and most of its middle
ONE_SIDED = 1.0  # log odds that it costs to look at one half alone
FAINTEST = 0.3  # of the contrast: a fainter DLO is not distinguished from none
SAME_GROUND = 0.12  # of the contrast: grounds that differ by less are one,
SPREADS = 3.0  # or by less than so many times what the ground beside the DLO varies
BROAD = 2.0  # range of the amplitudes that something unknown shows
BEST_LOG_ODDS = math.log(
    BROAD / (math.sqrt(2.0 * math.pi) * AMPLITUDE_STD)
)  # log odds of a perfect match
LEAST_ODDS = -3.0  # log likelihood ratio of one cross-section at the least: gross errors happen
EDGE_BREADTH = 0.3  # [widths] before and behind an edge, where the ground is compared
SLANT = 1.0  # [widths] by which an edge may lie further on one side than in the middle


def offsets_for(width: float) -> FloatArray:
    """Offsets of a cross-section's samples from the middle [px], shape (k,).

    Args:
        width: width of the DLO [px].
    """
    half = round(ACROSS * SAMPLES)
    return np.arange(-half, half + 1.0) * (width / SAMPLES)


@dataclass(frozen=True, eq=False)
class Sections:
    """The DLO's cross-section: 0 on the board, 1 on the DLO.

    Args:
        shape: shape (k,).
        board: colour beside the DLO, shape (3,).
        axis: difference of the DLO's colour and the board's, shape (3,).
        misfit: misfit of the DLO's own cross-sections, in contrasts.
        same: contrasts by which colours differ that are one ground.
    """

    shape: FloatArray
    board: FloatArray
    axis: FloatArray
    misfit: float
    same: float

    @classmethod
    def of(cls, strip: Float32, offsets: FloatArray, width: float) -> Sections:
        """From cross-sections of the DLO, shape (m, k, 3)."""
        usual = np.median(strip, axis=0).astype(np.float64)
        aside = np.abs(offsets) >= SIDES * width
        board = np.median(strip[:, aside].reshape(-1, 3), axis=0).astype(np.float64)
        axis = usual[np.abs(offsets) <= CORE * width].mean(axis=0) - board
        contrast = max(float(np.linalg.norm(axis)), 1.0)
        shape = (usual - board) @ axis / contrast**2
        sides = [strip[:, offsets * k >= SIDES * width].mean(axis=1) for k in (-1.0, 1.0)]
        spread = [float(np.median(np.linalg.norm(side - board, axis=1))) for side in sides]
        same = max(SAME_GROUND, SPREADS * min(spread) / contrast)
        found = cls(shape, board, axis, 0.0, same)
        return replace(found, misfit=float(np.median(found.fit(strip)[:, 2])))

    def fit(self, strip: Float32, part: slice = slice(None)) -> FloatArray:
        """Ground, amplitude, misfit and unlikeness of the colour in each cross-section.

        All of them in contrasts: the level of the ground, the amplitude of the DLO's shape above
        it, what is left over, and how far the mean colour is from the board's. Shape (m, 4).

        Args:
            strip: shape (m, k, 3).
            part: part of the cross-section that is compared.
        """
        part_of = np.ascontiguousarray(strip[:, part])
        return np.asarray(compare(part_of, self.shape[part], self.board, self.axis))

    def crossed(self, strip: Float32, offsets: FloatArray, width: float, step: float) -> Mask:
        """Whether an edge that shows on both sides of the DLO runs through each cross-section.

        Args:
            strip: shape (m, k, 3).
            offsets: offsets of the cross-section's pixels [px], shape (k,).
            width: width of the DLO [px].
            step: distance of the cross-sections [widths].
        """
        contrast = max(float(np.linalg.norm(self.axis)), 1.0)
        count, reach = len(strip), max(1, round(EDGE_BREADTH / step))
        index = np.arange(count)
        before, behind = np.maximum(index - reach, 0), np.minimum(index + reach, count - 1)
        changes = []
        for side in (offsets <= -SIDES * width, offsets >= SIDES * width):
            colour = strip[:, side].mean(axis=1)
            change = np.linalg.norm(colour[behind] - colour[before], axis=1)
            changes.append(change > self.same * contrast)
        left, right = changes
        result = np.zeros(count, dtype=np.bool_)
        slant = round(SLANT / step)
        for d in range(min(slant, (count - 1) // 2) + 1):  # the edge may run askew
            inner, outer, inwards = slice(d, count - d), slice(2 * d, count), slice(count - 2 * d)
            result[inner] |= (left[outer] & right[inwards]) | (left[inwards] & right[outer])
        return result

    def odds(self, strip: Float32) -> tuple[FloatArray, FloatArray]:
        """Log odds of each cross-section, of a visible DLO and of the bare board, over anything."""
        whole = self.fit(strip)
        visible = self._visible(whole)
        # One half of a section is enough beside a hole or another thing on one side.
        half = round(HALF * strip.shape[1])
        for part in (slice(half), slice(-half, None)):
            visible = np.maximum(visible, self._visible(self.fit(strip, part)) - ONE_SIDED)
        _, amplitude, misfit, unlike = whole.T
        worse = np.maximum(misfit - self.misfit, 0.0) / MISFIT_STD
        ended = BEST_LOG_ODDS - 0.5 * (amplitude / AMPLITUDE_STD) ** 2 - 0.5 * worse**2
        ended = np.where(unlike < self.same, np.maximum(ended, 0.0), 0.0)
        return np.maximum(visible, LEAST_ODDS), ended

    def _visible(self, fitted: FloatArray) -> FloatArray:
        ground, amplitude, misfit, _ = fitted.T
        contrast = max(float(np.linalg.norm(self.axis)), 1.0)
        colour = self.board + ground[:, None] * self.axis
        light = np.sqrt(np.sum(colour**2, axis=1)) / max(
            float(np.linalg.norm(self.board)), contrast
        )
        # In a shadow contrasts shrink with the light; before other ground the DLO keeps its tone.
        tone = 1.0 - ground
        expected = np.where(np.abs(amplitude - light) < np.abs(amplitude - tone), light, tone)
        worse = np.maximum(misfit - self.misfit, 0.0) / MISFIT_STD
        visible = (
            BEST_LOG_ODDS - 0.5 * ((amplitude - expected) / AMPLITUDE_STD) ** 2 - 0.5 * worse**2
        )
        # Before ground of its own tone the DLO cannot be recognised.
        return np.asarray(np.where(expected < FAINTEST, np.minimum(visible, 0.0), visible))


@njit()
def compare(strip: Float32, shape: FloatArray, board: FloatArray, axis: FloatArray) -> FloatArray:
    """See `Sections.fit`."""
    rows, count, _ = strip.shape
    contrast = max(math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2), 1.0)
    unit = (axis[0] / contrast, axis[1] / contrast, axis[2] / contrast)
    mean_shape, power = 0.0, 0.0
    for j in range(count):
        mean_shape += shape[j]
    mean_shape /= count
    for j in range(count):
        power += (shape[j] - mean_shape) ** 2
    power = max(power, 1e-9)
    result = np.empty((rows, 4))
    away = np.empty((count, 3))
    along = np.empty(count)
    mean = np.empty(3)
    for i in range(rows):
        mean[:] = 0.0
        product, level = 0.0, 0.0
        for j in range(count):
            along[j] = 0.0
            for c in range(3):
                away[j, c] = (strip[i, j, c] - board[c]) / contrast
                along[j] += away[j, c] * unit[c]
                mean[c] += away[j, c] / count
            product += along[j] * (shape[j] - mean_shape)
            level += along[j] / count
        amplitude = product / power
        ground = level - amplitude * mean_shape
        left = 0.0
        for j in range(count):
            left += (along[j] - ground - amplitude * shape[j]) ** 2
            # The colours of board and DLO may lie on a bent line in shade, so of the other colours
            # only what changes across counts.
            for c in range(3):
                left += (away[j, c] - mean[c] - (along[j] - level) * unit[c]) ** 2
        result[i, 0] = ground
        result[i, 1] = amplitude
        result[i, 2] = math.sqrt(left / count)
        result[i, 3] = math.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
    return result
