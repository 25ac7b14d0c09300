# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Messages of a force sensor, brought to the instants of shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dlo_ros.command import NANOSECONDS
from dlo_ros.inference.thresholds import FEWEST, OUTLIER
from dlo_ros.observation import Wrenches
from dlo_ros.spline import FloatArray

LONGEST_WINDOW = 0.05
"""Time to either side of a shape [s] from which forces are brought to its instant: a motion of 1 Hz
is then followed to 0.1 %."""
QUADRATIC = 3
"""Messages in a window from which its values follow a parabola: a line through three of 100 Hz
would flatten a DLO's own swings, those of 8 Hz by a tenth."""
LACKING = 0.05
"""Prior standard deviation of what the model lacks, over the weight or the largest force: it is
rather explained."""


def near(
    measured: Wrenches, stamps: Sequence[int]
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Measured forces and torques brought to the instants of shapes.

    A parabola or line through the messages of a window, at most half the way to the next shape.

    Args:
        stamps: stamps of the shapes [ns], F of them.

    Returns:
        Force and torque (F, 6), standard deviation of each over that of one message, (F,), and
        which instants have messages near enough, (F,).
    """
    at = np.asarray(stamps, dtype=np.int64)
    half = LONGEST_WINDOW
    if len(at) > 1:
        half = min(half, 0.5 * float(np.median(np.diff(at))) / NANOSECONDS)
    table = np.hstack([measured.force, measured.torque])
    values, share = np.zeros((len(at), 6)), np.ones(len(at))
    found = np.zeros(len(at), dtype=bool)
    for k, stamp in enumerate(at):
        time = (measured.stamps - stamp) / NANOSECONDS
        pick = np.flatnonzero(np.abs(time) <= half * (1.0 + 1e-6))
        if len(pick) < 2 or time[pick[0]] > 0.0 or time[pick[-1]] < 0.0:
            before, after = np.flatnonzero(time <= 0.0), np.flatnonzero(time >= 0.0)
            if not len(before) or not len(after):
                continue
            # Messages that come more seldom than shapes: the neighbours' line.
            pick = np.unique([before[-1], after[0]])
            if time[pick[-1]] - time[pick[0]] > 2.0 * LONGEST_WINDOW:
                continue
        degree = 2 if len(pick) >= QUADRATIC else min(len(pick) - 1, 1)
        powers = (time[pick] / max(float(np.abs(time[pick]).max()), 1e-9))[:, None]
        weights = np.linalg.pinv(powers ** np.arange(degree + 1))[0]
        values[k], share[k], found[k] = weights @ table[pick], np.linalg.norm(weights), True
    return values, share, found


def scatter(measured: Wrenches) -> FloatArray:
    """White noise of one message by its third differences [N; N m], shape (6,)."""
    table = np.hstack([measured.force, measured.torque])
    if len(table) < FEWEST:
        return np.zeros(6)
    jumps = np.diff(table, 3, axis=0) / np.sqrt(20.0)
    return np.asarray(1.4826 * np.median(np.abs(jumps), axis=0))


def shaken(measured: Wrenches, stamps: Sequence[int]) -> NDArray[np.bool_]:
    """Which shapes have forces about them that jump as no motion between pictures does, (F,).

    Where a motion begins or ends abruptly a DLO rings along itself, faster than a picture or a
    sensor follows. Jumps below what the model lacks anyway do not count: without noise a sensor
    shows all motions.

    Args:
        stamps: stamps of the shapes [ns], F of them.
    """
    at = np.asarray(stamps, dtype=np.int64)
    if len(measured.stamps) < FEWEST:
        return np.zeros(len(at), dtype=bool)
    jump = np.linalg.norm(np.diff(measured.force, 3, axis=0), axis=1) / np.sqrt(20.0)
    usual = float(np.linalg.norm(scatter(measured)[:3]))
    lacking = LACKING * float(np.abs(measured.force).max())
    inside = np.flatnonzero(jump > max(OUTLIER * usual, lacking))
    result = np.zeros(len(at), dtype=bool)
    half = round(0.5 * LONGEST_WINDOW * NANOSECONDS)
    for k in inside:  # four messages make a jump
        result |= (at >= measured.stamps[k] - half) & (at <= measured.stamps[k + 3] + half)
    return result
