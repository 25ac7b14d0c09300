# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where a free end lies: the likelihood of each place along the DLO's course.

Beyond the end the picture shows the board. A hole, a shadow or another dark thing there may look
like the DLO, and something above the DLO may hide its end. So each cross-section is compared with
the DLO's own cross-section a little further in and with the board beside it, and a hidden Markov
model (Rabiner, A tutorial on hidden Markov models, Proc. IEEE 77, 1989) with the states *visible*,
*hidden* and *ended* gives the likelihood of every place of the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.profile import Located
from dlo_ros.vision.segmentation import Image
from dlo_ros.vision.strip import CORE, Float32, Mask, inside, normals_of, strip_along

TEMPLATE = (1.5, 8.0)  # [widths] inwards from the provisional end: the DLO's own cross-section
INWARDS = 5.0  # [widths] from the provisional end, where the end may lie at the innermost
FEWEST_SECTIONS = 10  # of a template
ACROSS = 1.05  # [widths] half the breadth of a cross-section
SAMPLES = 10  # of a cross-section, in a width
SIDES = 0.75  # [widths] from the middle, where the board begins
AMPLITUDE_STD = 0.12  # of the DLO's contrast, as texture and shading change it along the DLO
MISFIT_STD = 0.06  # of the contrast, beyond the template's own misfit
HALF = 0.65  # of a cross-section: one edge of the DLO and most of its middle
ONE_SIDED = 1.0  # log odds that it costs to look at one half alone
FAINTEST = 0.3  # of the contrast: a DLO that must be fainter is not told from none
SAME_GROUND = 0.12  # of the contrast: grounds that differ by less are one,
SPREADS = 3.0  # or by less than so many times what the ground beside the DLO varies
INDEPENDENT = 0.2  # [widths] along the DLO over which cross-sections err alike
BROAD = 2.0  # range of the amplitudes that something unknown shows
MOST = math.log(BROAD / (math.sqrt(2.0 * math.pi) * AMPLITUDE_STD))  # log odds of a perfect match
LEAST_ODDS = -3.0  # log likelihood ratio of one cross-section at the least: gross errors happen
ABOUT = 1.0  # log likelihood that is no difference
FINE = 0.1  # [widths] distance of the cross-sections
EDGES = 1.0  # edges of other things that cross a DLO, in 100 widths of its length
EDGE = math.log(EDGES * FINE / 100.0)  # log odds that one of them lies at a certain cross-section
EDGE_BREADTH = 0.3  # [widths] before and behind an edge, where the ground is compared
SLANT = 1.0  # [widths] by which an edge may lie further on one side than in the middle


@dataclass(frozen=True, eq=False)
class Tip:
    """Likelihood of the places of one free end.

    Args:
        at: places, in profiles of the course (with fractions, beyond its ends too), shape (m,).
        likelihood: log likelihood of the end lying there, up to a constant, shape (m,).
        visible: the outermost profile that looks like the DLO itself.
    """

    at: FloatArray
    likelihood: FloatArray
    visible: float

    @property
    def innermost(self) -> float:
        """The innermost place that is about as likely as any, in profiles."""
        likely = self.likelihood > self.likelihood.max() - ABOUT
        return float(self.at[int(np.argmax(likely))])


def continued(
    located: Located,
    course: FloatArray,
    provisional: float,
    window: tuple[float, float],
    *,
    from_start: bool,
) -> FloatArray:
    """A course whose part about a free end continues the part further in, shape (m, 2).

    Beyond the end the course may have been drawn to a hole or to something else that is dark.

    Args:
        located: along the course.
        course: smoothed middle [px], shape (m, 2).
        provisional: profile near which the end was found.
        window: how far in from there the part lies that tells how it goes on [widths].
        from_start: which end.
    """
    per_width = located.width / located.spacing
    index = np.arange(len(course), dtype=np.float64)
    inwards = (index - provisional if from_start else provisional - index) / per_width
    used = located.seen & (inwards > window[0]) & (inwards < window[1])
    if np.count_nonzero(used) < FEWEST_SECTIONS:
        return course
    x = index - index[used].mean()
    result = course.copy()
    replaced = inwards < window[0]
    for k in (0, 1):
        result[replaced, k] = np.polyval(np.polyfit(x[used], course[used, k], 2), x[replaced])
    return result


def find_tip(
    image: Image,
    located: Located,
    course: FloatArray,
    provisional: float,
    beyond: float,
    *,
    from_start: bool,
) -> Tip:
    """Likelihood of the places of a free end.

    Args:
        image: BGR.
        located: along a course that goes on beyond the end.
        course: its smoothed middle, from `continued` [px], shape (m, 2).
        provisional: profile near which the end was found.
        beyond: profiles by which the end may lie outside the course.
        from_start: which end.
    """
    count, width = len(located.curve), located.width
    sign = -1.0 if from_start else 1.0  # of profiles towards the outside
    edge = 0.0 if from_start else count - 1.0
    per_width = width / located.spacing
    normals = normals_of(course)
    step = max(FINE * per_width, 1.0 / located.spacing)
    inner = max(-INWARDS * per_width, -abs(provisional - (count - 1.0 - edge)))
    outwards: FloatArray = np.arange(inner, abs(edge - provisional) + 0.5 * step, step)
    at = provisional + sign * outwards
    scale = width / SAMPLES
    offsets: FloatArray = np.arange(-round(ACROSS * SAMPLES), round(ACROSS * SAMPLES) + 1.0) * scale
    own = provisional - sign * np.arange(TEMPLATE[0], TEMPLATE[1], FINE) * per_width
    own = own[(own >= 0.0) & (own <= count - 1.0)]
    own = own[located.seen[np.rint(own).astype(np.int64)]]
    if len(own) < FEWEST_SECTIONS:
        return Tip(np.array([provisional]), np.zeros(1), provisional)
    sections = _Sections.of(_strip(image, course, normals, own, offsets), offsets, width)
    strip = _strip(image, course, normals, at, offsets)
    visible, ended = sections.odds(strip)
    here = np.clip(np.rint(at), 0, count - 1).astype(np.int64)
    if located.excluded is not None:
        visible = np.where(located.excluded[here], LEAST_ODDS, visible)
    pictured = inside(image, course[here])
    visible, ended = np.where(pictured, visible, 0.0), np.where(pictured, ended, 0.0)
    weight = step / (INDEPENDENT * per_width)
    outside = edge + sign * np.arange(step, beyond, step)
    nothing = np.zeros(len(outside))
    likelihood = ends(
        np.concatenate([weight * visible, nothing]),
        np.concatenate([weight * ended, nothing]),
        EDGE,
    )
    # An end that lies just where the edge of something else runs would do so by chance.
    crossed = sections.crossed(strip, offsets, width, step / per_width)
    likelihood[: len(at)] += np.where(crossed, EDGE, 0.0)
    places = np.concatenate([at, outside])
    # An end lies before the first cross-section without the DLO.
    places = places - 0.5 * sign * step
    like = np.flatnonzero(visible > 0.0)
    outermost = at[like[-1]] if len(like) else at[0]
    return Tip(places, likelihood, float(outermost))


def _strip(
    image: Image, points: FloatArray, normals: FloatArray, at: FloatArray, offsets: FloatArray
) -> Float32:
    index = np.arange(len(points))
    here = np.column_stack([np.interp(at, index, c) for c in points.T])
    across = np.column_stack([np.interp(at, index, c) for c in normals.T])
    return strip_along(image, here, across, offsets)


@dataclass(frozen=True, eq=False)
class _Sections:
    """The DLO's cross-section: 0 on the board, 1 on the DLO.

    Args:
        shape: shape (k,).
        board: colour beside the DLO, shape (3,).
        axis: from the board's colour to the DLO's, shape (3,).
        misfit: of the DLO's own cross-sections, in contrasts.
        same: contrasts by which colours differ that are one ground.
    """

    shape: FloatArray
    board: FloatArray
    axis: FloatArray
    misfit: float
    same: float

    @classmethod
    def of(cls, strip: Float32, offsets: FloatArray, width: float) -> _Sections:
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
            part: of the cross-section that is looked at.
        """
        part_of = np.ascontiguousarray(strip[:, part])
        return np.asarray(compare(part_of, self.shape[part], self.board, self.axis))

    def crossed(self, strip: Float32, offsets: FloatArray, width: float, step: float) -> Mask:
        """Whether an edge that shows on both sides of the DLO runs through each cross-section.

        Args:
            strip: shape (m, k, 3).
            offsets: of the cross-section's pixels [px], shape (k,).
            width: of the DLO [px].
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
        for d in range(-slant, slant + 1):  # the edge may run askew
            a, b = index + d, index - d
            inside = (np.minimum(a, b) >= 0) & (np.maximum(a, b) < count)
            result[inside] |= left[a[inside]] & right[b[inside]]
        return result

    def odds(self, strip: Float32) -> tuple[FloatArray, FloatArray]:
        """Log odds of each cross-section, of a visible DLO and of the bare board, over anything."""
        whole = self.fit(strip)
        visible = self._visible(whole)
        # Beside a hole, or something else on one side, one half will do.
        half = round(HALF * strip.shape[1])
        for part in (slice(half), slice(-half, None)):
            visible = np.maximum(visible, self._visible(self.fit(strip, part)) - ONE_SIDED)
        _, amplitude, misfit, unlike = whole.T
        worse = np.maximum(misfit - self.misfit, 0.0) / MISFIT_STD
        ended = MOST - 0.5 * (amplitude / AMPLITUDE_STD) ** 2 - 0.5 * worse**2
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
        visible = MOST - 0.5 * ((amplitude - expected) / AMPLITUDE_STD) ** 2 - 0.5 * worse**2
        # Before ground of its own tone the DLO cannot be told.
        return np.asarray(np.where(expected < FAINTEST, np.minimum(visible, 0.0), visible))


@njit()
def compare(strip: Float32, shape: FloatArray, board: FloatArray, axis: FloatArray) -> FloatArray:
    """See `_Sections.fit`."""
    rows, count, _ = strip.shape
    contrast = max(math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2), 1.0)
    unit = axis / contrast
    mean_shape = shape.mean()
    power = max(float(np.sum((shape - mean_shape) ** 2)), 1e-9)
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


@njit()
def ends(visible: FloatArray, ended: FloatArray, edge: float) -> FloatArray:
    """Log likelihood of the end lying before each cross-section, shape (m,).

    Args:
        visible, ended: log odds of each cross-section if the DLO is seen there, or has ended.
        edge: log odds of something's edge lying there, which hides the DLO or shows it again.
    """
    count = len(visible)
    result = np.empty(count)
    seen, hidden = 0.0, -1e9
    for k in range(count):
        result[k] = max(seen, hidden) + math.log1p(math.exp(-abs(seen - hidden)))
        back = hidden + edge
        out = seen + edge
        seen = max(seen, back) + math.log1p(math.exp(-abs(seen - back))) + visible[k]
        hidden = max(hidden, out) + math.log1p(math.exp(-abs(hidden - out)))
    after = 0.0
    for k in range(count - 1, -1, -1):
        after += ended[k]
        result[k] += after
    return result
