# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures that are grossly wrong: they stand alone among their neighbours."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import FEWEST, MOST_GROSS, OUTLIER
from dlo_ros.spline import FloatArray

SAME, SLOPE = np.sqrt(2.0 / 1.5), np.sqrt(6.0 / 1.5)
"""Effect of noise on the difference from the next picture, and from a slope through the next two,
over that on the difference from the mean of two neighbours."""


def without_gross(recording: Recording, missed: FloatArray) -> Recording:
    """The recording without pictures that are grossly wrong.

    Such a picture stands alone, both in what was seen and in what a model misses: a fast motion of
    the DLO stands out in the former only, and what a model gets wrong goes on in the next picture.

    Args:
        missed: observed minus predicted control points [m], shape (F, n, 3), of the last F frames.
    """
    gross = np.zeros(len(recording.observed), dtype=bool)
    gross[-len(missed) :] = outliers(recording.observed[-len(missed) :], missed)
    if not 0 < gross.sum() <= MOST_GROSS * len(gross):
        return recording
    return recording.of(np.flatnonzero(~gross))


def outliers(*fields: FloatArray) -> np.ndarray:
    """Pictures that jump out of their neighbours' in each of some fields, shape (F,).

    A model that is wrong is wrong in neighbouring pictures alike; a picture that was seen wrongly
    stands alone.

    Args:
        fields: fields such as residuals, shape (F, n, 3) each.
    """
    flat = [f.reshape(len(f), -1).copy() for f in fields]
    wrong = np.zeros(len(flat[0]), dtype=bool)
    if len(wrong) < FEWEST:
        return wrong
    most = [max(_usual(_jumps(f)[0]), np.finfo(float).tiny) for f in flat]
    first, last = 0, len(wrong)
    while last - first >= FEWEST and wrong.sum() <= MOST_GROSS * len(wrong):
        found = [_jumps(f[first:last]) for f in flat]
        # Over the largest usual jump, in the field in which a picture jumps least.
        jump = np.min([j / m for (j, _), m in zip(found, most, strict=True)], axis=0)
        # Beside a picture that jumps its neighbours seem to jump as well: it goes first.
        worst = np.flatnonzero((jump > 1.0) & (jump >= maximum_filter1d(jump, 5)))
        if not len(worst):
            break
        wrong[first + worst] = True
        for f, (_, expected) in zip(flat, found, strict=True):
            f[first + worst] = expected[worst]
        # Where nothing comes after it, what is expected may be as wrong: a picture beside it is.
        first, last = first + int(worst[0] == 0), last - int(first + worst[-1] == last - 1)
    return wrong


def _usual(jump: FloatArray) -> float:
    """The largest jump that is no exception."""
    middle = float(np.median(jump))
    typical = 1.4826 * float(np.median(np.abs(jump - middle)))
    return middle + OUTLIER * max(typical, 0.1 * middle)


def _jumps(flat: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far each picture is from what its neighbours let expect, shape (F,), and that, (F, N).

    Of several expectations that which comes nearest counts. Near the ends, where noise does more to
    an expectation, it is taken in units of what it does to the mean of two neighbours.

    Args:
        flat: shape (F, N).
    """
    frames = len(flat)
    beyond = np.zeros((2, flat.shape[1]))
    padded = np.concatenate([beyond, flat, beyond])
    a, b, c, d, e = (padded[k : k + frames] for k in range(5))
    between, parabola = 0.5 * (b + d), (4.0 * (b + d) - a - e) / 6.0
    middle = np.median(np.stack([a, b, c, d, e]), axis=0)
    unit = np.ones((3, frames))
    for k, step in ((0, 1), (-1, -1)):
        between[k], parabola[k] = flat[k + step], 2.0 * flat[k + step] - flat[k + 2 * step]
        parabola[k + step] = 2.0 * flat[k + 2 * step] - flat[k + 3 * step]
        middle[[k, k + step]] = np.inf
        unit[0, k], unit[1, [k, k + step]] = SAME, SLOPE
    courses = np.stack([between, parabola, middle])
    jump = np.linalg.norm(flat - courses, axis=2) / unit
    nearest, number = np.argmin(jump, axis=0), np.arange(frames)
    return jump[nearest, number], courses[nearest, number]
