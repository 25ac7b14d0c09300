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
        beside: how many samples at either side of a cross-section lie beside the DLO.
        core: the samples in its middle.
    """

    shape: FloatArray
    board: FloatArray
    axis: FloatArray
    misfit: float
    same: float
    beside: int
    core: Mask

    @classmethod
    def of(cls, strip: Float32, offsets: FloatArray, width: float) -> Sections:
        """From cross-sections of the DLO, shape (m, k, 3)."""
        usual = _medians(strip)
        beside = int(np.count_nonzero(offsets >= SIDES * width))
        both = np.hstack([strip[:, :beside], strip[:, -beside:]])
        board = _medians(both.reshape(-1, 1, 3))[0]
        core = np.abs(offsets) <= CORE * width
        axis = usual[core].mean(axis=0) - board
        contrast = max(float(np.linalg.norm(axis)), 1.0)
        shape = (usual - board) @ axis / contrast**2
        spread = np.median(np.linalg.norm(_grounds(strip, beside) - board, axis=2), axis=1)
        same = max(SAME_GROUND, SPREADS * float(spread.min()) / contrast)
        found = cls(shape, board, axis, 0.0, same, beside, core)
        return replace(found, misfit=float(np.median(found.fit(strip)[:, 2])))

    def fit(self, strip: Float32, part: slice = slice(None)) -> FloatArray:
        """Ground, amplitude, misfit and unlikeness of the colour in each cross-section.

        All of them in contrasts: the level of the ground, the amplitude of the DLO's shape above
        it, what is left over, and how far the mean colour is from the board's. Shape (m, 4).

        Args:
            strip: shape (m, k, 3).
            part: part of the cross-section that is compared.
        """
        first, last, _ = part.indices(strip.shape[1])
        return np.asarray(compare(strip, first, last, self.shape, self.board, self.axis))

    def grounds(self, strip: Float32) -> FloatArray:
        """Mean colours to both sides of the DLO in cross-sections, shape (2, m, 3)."""
        return np.asarray(_grounds(strip, self.beside))

    def middles(self, strip: Float32) -> FloatArray:
        """Mean colours of the middles of cross-sections, shape (m, 3)."""
        return np.asarray(strip[:, self.core].mean(axis=1), dtype=np.float64)

    def crossed(self, strip: Float32, step: float) -> Mask:
        """Whether an edge that shows on both sides of the DLO runs through each cross-section.

        Args:
            strip: shape (m, k, 3).
            step: distance of the cross-sections [widths].
        """
        contrast = max(float(np.linalg.norm(self.axis)), 1.0)
        count, reach = len(strip), max(1, round(EDGE_BREADTH / step))
        index = np.arange(count)
        before, behind = np.maximum(index - reach, 0), np.minimum(index + reach, count - 1)
        colours = self.grounds(strip)
        change = np.linalg.norm(colours[:, behind] - colours[:, before], axis=2)
        left, right = change > self.same * contrast
        result = np.zeros(count, dtype=np.bool_)
        slant = round(SLANT / step)
        for d in range(min(slant, (count - 1) // 2) + 1):  # the edge may run askew
            inner, outer, inwards = slice(d, count - d), slice(2 * d, count), slice(count - 2 * d)
            result[inner] |= (left[outer] & right[inwards]) | (left[inwards] & right[outer])
        return result

    def odds(self, strip: Float32) -> tuple[FloatArray, FloatArray]:
        """Log odds of each cross-section, of a visible DLO and of the bare board, over anything."""
        half = round(HALF * strip.shape[1])
        visible, ended = _log_odds(
            strip, half, self.shape, self.board, self.axis, self.misfit, self.same
        )
        return visible, ended


@njit()
def _grounds(strip: Float32, beside: int) -> FloatArray:
    """Mean colours of so many samples at either side of cross-sections, shape (2, m, 3)."""
    rows, count, channels = strip.shape
    result = np.zeros((2, rows, channels))
    for i in range(rows):
        for j in range(beside):
            for c in range(channels):
                result[0, i, c] += strip[i, j, c] / beside
                result[1, i, c] += strip[i, count - 1 - j, c] / beside
    return result


@njit()
def _medians(strip: Float32) -> FloatArray:
    """Medians over the first axis, shape (m, k, 3) to (k, 3)."""
    rows, count, channels = strip.shape
    result = np.empty((count, channels))
    column = np.empty(rows, dtype=np.float32)
    for j in range(count):
        for c in range(channels):
            for i in range(rows):
                column[i] = strip[i, j, c]
            result[j, c] = np.median(column)
    return result


@njit()
def _log_odds(
    strip: Float32,
    half: int,
    shape: FloatArray,
    board: FloatArray,
    axis: FloatArray,
    misfit: float,
    same: float,
) -> tuple[FloatArray, FloatArray]:
    """See `Sections.odds`; a half of a cross-section has so many samples."""
    count = strip.shape[1]
    whole = compare(strip, 0, count, shape, board, axis)
    # One half of a section is enough beside a hole or another thing on one side.
    one = compare(strip, 0, half, shape, board, axis)
    other = compare(strip, count - half, count, shape, board, axis)
    visible, ended = np.empty(len(whole)), np.zeros(len(whole))
    for i in range(len(whole)):
        sides = max(_visible(one[i], board, axis, misfit), _visible(other[i], board, axis, misfit))
        seen = max(_visible(whole[i], board, axis, misfit), sides - ONE_SIDED)
        visible[i] = max(seen, LEAST_ODDS)
        if whole[i, 3] < same:
            worse = max(whole[i, 2] - misfit, 0.0) / MISFIT_STD
            found = BEST_LOG_ODDS - 0.5 * (whole[i, 1] / AMPLITUDE_STD) ** 2 - 0.5 * worse**2
            ended[i] = max(found, 0.0)
    return visible, ended


@njit(from_python=False)
def _visible(fitted: FloatArray, board: FloatArray, axis: FloatArray, misfit: float) -> float:
    """Log odds of a visible DLO in a cross-section that `compare` has fitted."""
    ground, amplitude = fitted[0], fitted[1]
    light = bright = contrast = 0.0
    for c in range(3):
        light += (board[c] + ground * axis[c]) ** 2
        bright += board[c] ** 2
        contrast += axis[c] ** 2
    light = math.sqrt(light) / max(math.sqrt(bright), math.sqrt(contrast), 1.0)
    # In a shadow contrasts shrink with the light; before other ground the DLO keeps its tone.
    tone = 1.0 - ground
    expected = light if abs(amplitude - light) < abs(amplitude - tone) else tone
    worse = max(fitted[2] - misfit, 0.0) / MISFIT_STD
    visible = BEST_LOG_ODDS - 0.5 * ((amplitude - expected) / AMPLITUDE_STD) ** 2 - 0.5 * worse**2
    # Before ground of its own tone the DLO cannot be recognised.
    return float(min(visible, 0.0) if expected < FAINTEST else visible)


@njit()
def compare(
    strip: Float32, first: int, last: int, shape: FloatArray, board: FloatArray, axis: FloatArray
) -> FloatArray:
    """Fit of the samples first to last (exclusive) of each cross-section; see `Sections.fit`."""
    rows, count = len(strip), last - first
    contrast = max(math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2), 1.0)
    unit = (axis[0] / contrast, axis[1] / contrast, axis[2] / contrast)
    mean_shape, power = 0.0, 0.0
    for j in range(count):
        mean_shape += shape[first + j]
    mean_shape /= count
    for j in range(count):
        power += (shape[first + j] - mean_shape) ** 2
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
                away[j, c] = (strip[i, first + j, c] - board[c]) / contrast
                along[j] += away[j, c] * unit[c]
                mean[c] += away[j, c] / count
            product += along[j] * (shape[first + j] - mean_shape)
            level += along[j] / count
        amplitude = product / power
        ground = level - amplitude * mean_shape
        left = 0.0
        for j in range(count):
            left += (along[j] - ground - amplitude * shape[first + j]) ** 2
            # The colours of board and DLO may lie on a bent line in shade, so of the other colours
            # only what changes across counts.
            for c in range(3):
                left += (away[j, c] - mean[c] - (along[j] - level) * unit[c]) ** 2
        result[i, 0] = ground
        result[i, 1] = amplitude
        result[i, 2] = math.sqrt(left / count)
        result[i, 3] = math.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
    return result
