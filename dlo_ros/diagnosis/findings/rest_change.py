# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A DLO that rests otherwise in one recording than in another, though it is held alike.

A model has one shape at rest for each way in which the DLO is held. What creeps from recording to
recording, was bent meanwhile or is gripped anew has several, and nothing that is the same in all
recordings explains them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dlo_ros.inference.err import shape_errors
from dlo_ros.inference.joint import Simulated
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import FEWEST
from dlo_ros.spline import SplineBasis


@dataclass(frozen=True)
class RestChange:
    """Two recordings between which the shape at rest has changed.

    Args:
        names: of the recordings.
        distance: mean distance along u of the two shapes at rest, as they were measured [m].
        expected: the same of the simulated ones, which are held as those are [m].
    """

    names: tuple[str, str]
    distance: float
    expected: float


def rest_change(
    shown: Simulated, recordings: Sequence[Recording], least: float
) -> RestChange | None:
    """The two recordings that differ most at their beginning, beyond what holds them differently.

    Were the model wrong by all of the distance that it expects, the rest of the measured one would
    be left: poses that differ a little do not count.

    Args:
        shown: simulation of the recordings.
        least: distance that must be left [m]; what is less does not matter.
    """
    resting = []
    for recording, predicted in zip(recordings, shown.predicted, strict=True):
        frames = recording.frames_at_rest
        if frames >= FEWEST and len(predicted) == len(recording.times):
            shapes = recording.observed, predicted[..., :3]
            resting.append((recording.name, *(s[:frames].mean(axis=0) for s in shapes)))
    pairs = list(combinations(resting, 2))
    if not pairs:
        return None
    length = shown.model.settings.rod.length
    basis = SplineBasis(recordings[0].observed.shape[1], length)
    distance, expected = (
        shape_errors(np.array([a[k] for a, _ in pairs]), np.array([b[k] for _, b in pairs]), basis)
        for k in (1, 2)
    )
    most = int(np.argmax(distance - expected))
    if distance[most] - expected[most] <= least:
        return None
    (first, _, _), (second, _, _) = pairs[most]
    return RestChange((first, second), float(distance[most]), float(expected[most]))
