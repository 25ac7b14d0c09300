# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The position of a free end: the likelihood of each place along the DLO's course.

Beyond the end the picture shows the board. A hole, a shadow or another dark thing there may look
like the DLO, and something above the DLO may hide its end. So each cross-section is compared with
the DLO's own cross-section a little further in and with the board beside it, and a hidden Markov
model (Rabiner, A tutorial on hidden Markov models, Proc. IEEE 77, 1989) with the states *visible*,
*hidden* and *ended* gives the likelihood of every place of the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.segmentation.cross_sections import LEAST_ODDS, Sections, offsets_for
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.picture_strip import Float32, inside, normals_of, strip_along
from dlo_ros.vision.segmentation.ridge_map import Image

TEMPLATE = (1.5, 8.0)  # [widths] inwards from the provisional end: the DLO's own cross-section
INWARDS = 5.0  # [widths] from the provisional end, where the end may lie at the innermost
FEWEST_SECTIONS = 10  # of a template
INDEPENDENT = 0.2  # [widths] along the DLO over which cross-sections err alike
ABOUT = 1.0  # log likelihood that is no difference
FINE = 0.1  # [widths] distance of the cross-sections
COURSE_REACH = 3.0
"""Distance from the outermost place where the DLO was seen, up to which its course is known to half
its width [widths]: over that a curvature that changes by 1 / (10 widths) turns it aside by as much.
"""
EDGES = 1.0  # edges of other things that cross a DLO, in 100 widths of its length
EDGE = math.log(EDGES * FINE / 100.0)  # log odds that one of them lies at a certain cross-section


@dataclass(frozen=True, eq=False)
class Tip:
    """Likelihood of the places of one free end.

    Args:
        at: places, in profiles of the course (with fractions, beyond its ends too), shape (m,).
        likelihood: log likelihood of the end lying there, up to a constant, shape (m,).
        visible: the outermost profile that looks like the DLO itself.
        compared: whether the DLO's own cross-section is known, so that the picture tells anything.
    """

    at: FloatArray
    likelihood: FloatArray
    visible: float
    compared: bool = True

    @property
    def innermost(self) -> float:
        """The innermost place that is about as likely as any, in profiles."""
        if not self.compared:
            return self.visible
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
        located: the DLO along the course.
        course: smoothed middle [px], shape (m, 2).
        provisional: profile near which the end was found.
        window: distances from the end between which the part lies that predicts the course near the
            end [widths].
        from_start: whether the end is the one at the start of the course.
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
    powers = np.vander(x[used], 3)
    bend, slope, middle = np.linalg.solve(powers.T @ powers, powers.T @ course[used])
    result[replaced] = (x[replaced, None] * bend + slope) * x[replaced, None] + middle
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
        located: the DLO along a course that goes on beyond the end.
        course: smoothed middle of the DLO, from `continued` [px], shape (m, 2).
        provisional: profile near which the end was found.
        beyond: profiles by which the end may lie outside the course.
        from_start: whether the end is the one at the start of the course.
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
    offsets = offsets_for(width)
    own = provisional - sign * np.arange(TEMPLATE[0], TEMPLATE[1], FINE) * per_width
    own = own[(own >= 0.0) & (own <= count - 1.0)]
    own = own[located.seen[np.rint(own).astype(np.int64)]]
    outside = edge + sign * np.arange(step, beyond, step)
    places = np.concatenate([at, outside])
    if len(own) < FEWEST_SECTIONS:  # nothing to compare with: the end may be anywhere
        return Tip(places, np.zeros(len(places)), provisional, compared=False)
    sections = Sections.of(_strip(image, course, normals, own, offsets), offsets, width)
    strip = _strip(image, course, normals, at, offsets)
    visible, ended = sections.odds(strip)
    here = np.clip(np.rint(at), 0, count - 1).astype(np.int64)
    if located.excluded is not None:
        visible = np.where(located.excluded[here], LEAST_ODDS, visible)
    pictured = inside(image, course[here])
    # Far from where the DLO was seen the bare board may lie beside it.
    seen = np.flatnonzero(located.seen)
    outermost_seen = seen[0] if from_start else seen[-1]
    on_course = sign * (at - outermost_seen) < COURSE_REACH * per_width
    visible = np.where(pictured, visible, 0.0)
    ended = np.where(pictured & on_course, ended, 0.0)
    weight = step / (INDEPENDENT * per_width)
    nothing = np.zeros(len(outside))
    likelihood = ends(
        np.concatenate([weight * visible, nothing]),
        np.concatenate([weight * ended, nothing]),
        EDGE,
        bool(located.seen[here[0]]),
    )
    # An end that lies just where the edge of something else runs would do so by chance.
    crossed = sections.crossed(strip, step / per_width)
    likelihood[: len(at)] += np.where(crossed, EDGE, 0.0)
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


@njit()
def ends(visible: FloatArray, ended: FloatArray, edge: float, seen_before: bool) -> FloatArray:
    """Log likelihood of the end lying before each cross-section, shape (m,).

    Args:
        visible, ended: log odds of each cross-section if the DLO is seen there, or has ended.
        edge: log odds of something's edge lying there, which hides the DLO or shows it again.
        seen_before: whether the DLO was seen before the first cross-section; else it is as likely
            to be hidden there.
    """
    count = len(visible)
    result = np.empty(count)
    seen, hidden = 0.0, -1e9 if seen_before else 0.0
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
