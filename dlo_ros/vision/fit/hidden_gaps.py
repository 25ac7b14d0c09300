# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The course of a DLO over gaps in which something hides it.

What was traced there is the edges of whatever hides the DLO, and beside a gap they shift its middle
by some tenths of a pixel. So neither leads a fit. A spline that is given too long an interval of
its parameter for a gap bulges; how long the DLO is in it follows from its course on both sides: as
long as a cubic Hermite curve whose tangents have their length in proportion to its own. The factor
is that of an arc of a circle, 4 tan(a / 4) / a where it turns by a.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray

SHORTEST = 1.5  # [widths] of a gap over which what was traced leads astray
BESIDE = 0.8  # [widths] from a gap, up to which what hides the DLO shifts its middle
FAR = 5.0  # [widths] from a gap, up to which the course tells its direction there
LITTLE = 1e-4  # weight of a profile beside a gap, against 1: it leads where nothing else does
FEWEST_POINTS = 5  # of the DLO on one side of a gap, which show its direction
ROUNDS = 6  # of the length of a curve and its tangents, after which both agree to 1e-3
SAMPLES: FloatArray = np.linspace(0.0, 1.0, 21)[:, None]

Gaps = Sequence[tuple[int, int]]


def hidden_gaps(profiles: NDArray[np.int64], trust: FloatArray, per_width: float) -> Gaps:
    """Last profile before each longer gap in which something hides the DLO, and first one behind.

    Where its colour was seen, if no edge, along most of a gap, the DLO is not hidden.

    Args:
        profiles: places in which the DLO was seen, growing, shape (m,).
        trust: weights of all profiles in a fit, zero where nothing of the DLO was seen.
        per_width: profiles in a width of the DLO.
    """
    at = np.flatnonzero(np.diff(profiles) > SHORTEST * per_width)
    gaps = [(profiles[k], profiles[k + 1]) for k in at]
    return [(a, b) for a, b in gaps if np.mean(trust[a + 1 : b] > 0.0) < 0.5]


def trusted(trust: FloatArray, gaps: Gaps, per_width: float) -> FloatArray:
    """Weights of all profiles in a fit: none within gaps, little beside them, shape (m,).

    Args:
        trust: weights without regard to gaps, shape (m,).
        gaps: see `hidden_gaps`.
        per_width: profiles in a width of the DLO.
    """
    profiles = np.arange(len(trust))
    for first, last in gaps:
        near = (profiles > first - BESIDE * per_width) & (profiles < last + BESIDE * per_width)
        within = (profiles > first) & (profiles < last)
        trust = np.where(within, 0.0, np.where(near, LITTLE * trust, trust))
    return trust


def even_parameters(
    profiles: FloatArray, points: FloatArray, gaps: Gaps, per_width: float
) -> Callable[[FloatArray], FloatArray]:
    """Parameters in which gaps are as long as the DLO in them is likely to be.

    Args:
        profiles: places in which the DLO was seen, growing, shape (m,).
        points: its middle there, shape (m, d).
        gaps: see `hidden_gaps`.
        per_width: profiles in a width of the DLO.

    Returns:
        Function from profiles to parameters, which are a profile apart where the DLO was seen and
        beyond its ends.
    """
    if not gaps:
        return lambda at: at
    added = np.zeros(len(profiles))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(profiles)
    for first, last in gaps:
        before = (profiles > first - FAR * per_width) & (profiles < first - BESIDE * per_width)
        behind = (profiles > last + BESIDE * per_width) & (profiles < last + FAR * per_width)
        if min(np.count_nonzero(before), np.count_nonzero(behind)) < FEWEST_POINTS:
            continue
        begin, leaving = _border(profiles[before] - first, points[before])
        end, arriving = _border(profiles[behind] - last, points[behind])
        speed = float(np.median(steps[(before | behind)[1:]]))
        length = _hermite_length(end - begin, leaving, arriving) / speed
        added[profiles >= last] += length - (last - first)
    return lambda at: at + np.interp(at, profiles, added)


def _border(away: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value and derivative, shapes (d,), that a parabola through points has at a gap's border."""
    _, slope, value = np.polyfit(away, points, 2)
    return value, slope


def _hermite_length(chord: FloatArray, leaving: FloatArray, arriving: FloatArray) -> float:
    """Length of the Hermite curve over a chord that is an arc of a circle where one fits."""
    s = SAMPLES
    length = float(np.linalg.norm(chord))
    leaving, arriving = (t / np.linalg.norm(t) for t in (leaving, arriving))
    quarter = 0.25 * max(float(np.arccos(np.clip(leaving @ arriving, -1.0, 1.0))), 1e-6)
    bends = s * (1.0 - s) ** 2 * leaving - s**2 * (1.0 - s) * arriving
    bends *= np.tan(quarter) / quarter
    for _ in range(ROUNDS):
        curve = s**2 * (3.0 - 2.0 * s) * chord + length * bends
        length = float(np.sum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    return length
