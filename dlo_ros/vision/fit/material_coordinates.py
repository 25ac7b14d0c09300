# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Material coordinates along a DLO one of whose ends at least is free.

What is known is the clamp (u = 0 or u = L), the length L, and the arc length along the course,
which differs from u by the errors of scale and L. A free end is an observation like another: where
the picture shows it clearly, u = L lies there; where it does not, the arc length decides alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from dlo_ros.errors import VisionError
from dlo_ros.kernel_cache import njit
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.segmentation.edge_profile import Located
from dlo_ros.vision.segmentation.picture_strip import smooth_curve
from dlo_ros.vision.segmentation.ridge_map import Image
from dlo_ros.vision.tracing.free_ends import free_end
from dlo_ros.vision.tracing.tip_likelihood import Tip, continued, find_tip

LENGTH_STD = 0.005  # of L: error of L, camera and pose in a careful set-up
ROUGH_LENGTH_STD = 0.03  # the same where the grip slipped or the camera was moved,
ROUGH_SHARE = 0.03  # which happens in so many set-ups
TIP_STD = 0.08  # [widths] systematic error of a clearly seen end: it is cut askew, frayed, rounded
UNEVEN_STD = 0.002  # of the arc length: errors of scale are not quite the same all along
GAP_STD = 0.1  # relative error of the length of a bridge
CONTINUED = ((1.5, 6.0), (0.4, 4.0))
"""Distances from a found end between which the part lies that predicts the course there [widths]:
first where a hole beside the end cannot have moved it, then closer."""
SETTLED = 0.3  # [widths] by which both may place an end apart that is clear
MOST_BEYOND = 0.15  # of L that a hidden end may lie beyond the course
NEGLIGIBLE = 40.0  # log odds: what is less likely by that is lost in the rounding of a sum

Missing = TypeVar("Missing", float, FloatArray)


@dataclass(frozen=True, eq=False)
class Ends:
    """Positions of the DLO's ends on its course.

    Args:
        places: places of start and end, in profiles, shape (2,).
        covariance: covariance of both places, in arc length [m^2], shape (2, 2).
        visible: arc length between the outermost places that look like the DLO [m]; NaN where
            both ends are held.
        settled: whether free ends lie where they do whichever part of the DLO predicts the course
            there: beside a hole they may not, and a course along the DLO tells more than chains.
    """

    places: FloatArray
    covariance: FloatArray
    visible: float = np.nan
    settled: bool = True


def find_ends(
    image: Image,
    located: Located,
    camera: Camera,
    length: float,
    length_std: float,
    prolonged: float,
    free: tuple[bool, bool],
) -> Ends:
    """Positions of the ends of a located DLO.

    Args:
        image: BGR.
        located: the DLO along a course that is prolonged beyond free ends.
        camera: camera of the picture.
        length: L [m].
        length_std: standard deviation of L [m]; 0: not known.
        prolonged: length by which the course was prolonged [px].
        free: whether start and end are free.
    """
    last = len(located.curve) - 1.0
    if not any(free):
        return Ends(np.array([0.0, last]), np.zeros((2, 2)))
    smooth = smooth_curve(located.points, 0.5 * located.width / located.spacing)
    pixel = float(np.median(camera.metres_per_pixel(smooth[:: max(1, len(smooth) // 50)])))
    beyond = MOST_BEYOND * length / (pixel * located.spacing)
    tips: list[Tip | None] = [None, None]
    course, settled = smooth.copy(), True
    for k in (0, 1):
        if not free[k]:
            continue
        start = k == 0
        place = free_end(located, prolonged, start)
        for window in CONTINUED:
            before = place
            own, tip = _continued_to_tip(image, located, smooth, place, window, beyond, start)
            place = float(np.clip(tip.innermost, 0.0, last))
        if abs(place - before) * located.spacing >= SETTLED * located.width:
            settled = False
            # A hole beside the end has drawn one course aside: less of the DLO is seen along it.
            rival = _continued_to_tip(image, located, smooth, before, CONTINUED[0], beyond, start)
            if rival[1].likelihood.max() > tip.likelihood.max():
                own, tip = rival
                place = float(np.clip(tip.innermost, 0.0, last))
        part = slice(None, round(place)) if start else slice(round(place), None)
        course[part] = own[part]
        tips[k] = tip
    plane = camera.to_board(course)[:, [0, 2]]
    steps = np.hypot(*np.diff(plane, axis=0).T)
    if not np.all(np.isfinite(steps)):
        raise VisionError("the DLO would lie beyond the horizon of the board")
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    found = locate_ends(arc, (tips[0], tips[1]), length, length_std, located.width * pixel)
    outer = [k * last if tip is None else tip.visible for k, tip in enumerate(tips)]
    visible = _arc_at(arc, np.array(outer))
    return replace(found, visible=float(visible[1] - visible[0]), settled=settled)


def _continued_to_tip(
    image: Image, located: Located, smooth: FloatArray, place: float,
    window: tuple[float, float], beyond: float, start: bool,
) -> tuple[FloatArray, Tip]:  # fmt: skip
    """The course that a part of the DLO predicts near an end, and the likelihood of that end."""
    course = continued(located, smooth, place, window, from_start=start)
    return course, find_tip(image, located, course, place, beyond, from_start=start)


def locate_ends(
    arc: FloatArray,
    tips: tuple[Tip | None, Tip | None],
    length: float,
    length_std: float,
    width: float,
) -> Ends:
    """Posterior mean and covariance of the free ends' places.

    Args:
        arc: arc length at each profile of the course [m], shape (m,).
        tips: likelihood of start and end; None: held, at the course's first or last profile.
        length: L [m].
        length_std: standard deviation of L [m]; 0: not known.
        width: width of the DLO [m].
    """
    count = len(arc)
    held = (np.array([0.0]), np.array([count - 1.0]))
    at = [held[k] if tip is None else tip.at for k, tip in enumerate(tips)]
    odds = [np.zeros(1) if tip is None else tip.likelihood for tip in tips]
    s = [_arc_at(arc, a) for a in at]
    weight = _posterior(*odds, *s, length, *_length_stds(length, length_std))
    weight /= weight.sum()
    each = weight.sum(axis=1), weight.sum(axis=0)
    mean = np.array([float(p @ x) for p, x in zip(each, s, strict=True)])
    away = [x - m for x, m in zip(s, mean, strict=True)]
    covariance = np.array(
        [
            [float(each[0] @ away[0] ** 2), float(away[0] @ weight @ away[1])],
            [float(away[0] @ weight @ away[1]), float(each[1] @ away[1] ** 2)],
        ]
    )
    for k, tip in enumerate(tips):
        if tip is not None:
            covariance[k, k] += (TIP_STD * width) ** 2
    places = np.array([float(p @ x) for p, x in zip(each, at, strict=True)])
    return Ends(places, covariance)


def length_log_likelihood(seen: FloatArray | float, length: float, length_std: float) -> FloatArray:
    """Log likelihood of the length of a DLO in a picture, up to a constant.

    Args:
        seen: length from end to end in the picture [m], any shape.
        length: L [m].
        length_std: standard deviation of L [m]; 0: not known.
    """
    missing = np.asarray(seen) - length
    return np.asarray(np.logaddexp(*_length_terms(missing, *_length_stds(length, length_std))))


def _length_stds(length: float, length_std: float) -> tuple[float, float]:
    """Standard deviations of a DLO's length in a careful set-up, and in another one [m]."""
    return (
        math.hypot(LENGTH_STD * length, length_std),
        math.hypot(ROUGH_LENGTH_STD * length, length_std),
    )


@njit()
def _length_terms(missing: Missing, spread: float, rough: float) -> tuple[Missing, Missing]:
    """Log likelihoods of what is missing of a length in each of the two kinds of set-up."""
    usual = math.log((1.0 - ROUGH_SHARE) / spread) - 0.5 * (missing / spread) ** 2
    slipped = math.log(ROUGH_SHARE / rough) - 0.5 * (missing / rough) ** 2
    return usual, slipped


@njit()
def _posterior(
    start_odds: FloatArray,
    end_odds: FloatArray,
    start: FloatArray,
    end: FloatArray,
    length: float,
    spread: float,
    rough: float,
) -> FloatArray:
    """Posterior probability of each pair of ends up to a constant factor, shape (m, n).

    Args:
        start_odds, end_odds: log likelihoods of the places, shapes (m,) and (n,).
        start, end: arc lengths of the places [m], likewise.
        length: L [m].
        spread, rough: standard deviations from `_length_stds`.
    """
    weight = np.empty((len(start), len(end)))
    # The larger of two terms is at least half of their sum, and far quicker to tell.
    best = -math.inf
    for i in range(len(start)):
        for j in range(len(end)):
            usual, slipped = _length_terms(end[j] - start[i] - length, spread, rough)
            weight[i, j] = start_odds[i] + end_odds[j] + max(usual, slipped)
            best = max(best, weight[i, j])
    for i in range(len(start)):
        for j in range(len(end)):
            if weight[i, j] < best - NEGLIGIBLE:
                weight[i, j] = 0.0
                continue
            usual, slipped = _length_terms(end[j] - start[i] - length, spread, rough)
            odds = start_odds[i] + end_odds[j] - best
            weight[i, j] = math.exp(usual + odds) + math.exp(slipped + odds)
    return weight


def _arc_at(arc: FloatArray, at: FloatArray) -> FloatArray:
    """Arc length at profiles, prolonged evenly beyond both ends of the course."""
    index = np.arange(len(arc), dtype=np.float64)
    inside = np.interp(at, index, arc)
    first, last = arc[1] - arc[0], arc[-1] - arc[-2]
    return np.asarray(inside + np.minimum(at, 0.0) * first + np.maximum(at - index[-1], 0.0) * last)


def std_along(u: FloatArray, length: float, covariance: FloatArray, doubtful: float) -> FloatArray:
    """Standard deviation of u [m], shape (m,).

    Args:
        u: material coordinates [m], shape (m,).
        length: L [m].
        covariance: covariance of the ends' places [m^2], shape (2, 2).
        doubtful: length of the bridges [m].
    """
    x = u / length
    ends = (
        (1.0 - x) ** 2 * covariance[0, 0]
        + 2.0 * x * (1.0 - x) * covariance[0, 1]
        + x**2 * covariance[1, 1]
    )
    between = ((UNEVEN_STD * length) ** 2 + (GAP_STD * doubtful) ** 2) * x * (1.0 - x)
    return np.asarray(np.sqrt(np.maximum(ends, 0.0) + between))
