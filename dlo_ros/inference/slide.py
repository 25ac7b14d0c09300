# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How far shapes lie apart, but for the slide along the DLO that measured points leave open.

A camera sees where u ends at a free end alone. Elsewhere an observer counts it from where the
command holds the DLO: with a clamp 5 mm off along the DLO every u near it is off by that much, and
ever less towards the other end. ERR at equal u would hold it against the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dlo_ros.command import END, START
from dlo_ros.inference.err import rule
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.observation_operator import directions
from dlo_ros.inference.scene import free_ends
from dlo_ros.spline import FloatArray, SplineBasis


@dataclass(frozen=True)
class Apart:
    """Observed minus predicted shapes at Q points along u, without the slide.

    Args:
        whole: shape (F, Q, 3) [m].
        along: its part along the observed shapes, shape (F, Q) [m].
        weight: of the quadrature along u, shape (Q,); they sum to 1.
    """

    whole: FloatArray
    along: FloatArray
    weight: FloatArray

    @property
    def err(self) -> FloatArray:
        """Mean distance, shape (F,) [m]: ERR of eq. (10) but for the slide."""
        return np.asarray(np.linalg.norm(self.whole, axis=2) @ self.weight)

    @property
    def along_square(self) -> float:
        """Mean square of the distance along the DLO [m^2]."""
        return float(np.mean(self.along**2 @ self.weight))


def slid(recording: Recording, predicted: FloatArray, length: float) -> Apart:
    """Differences without what is in proportion to the distance from an end, if one is held there.

    Args:
        predicted: control points of the recording's last F frames, shape (F, n, 3 or more).
        length: L [m].
    """
    basis = SplineBasis(predicted.shape[1], length)
    u, values, weight = rule(basis)
    share, weight = u / length, weight / length
    observed = recording.observed[-len(predicted) :]
    whole = values @ (observed - predicted[..., :3])
    _, tangent, _ = directions(_slopes(basis) @ observed)
    along = np.sum(whole * tangent, axis=2)
    free = free_ends(recording.manipulation, predicted.shape[1])
    held = [profile for end, profile in ((START, 1.0 - share), (END, share)) if end not in free]
    root, profiles = np.sqrt(weight)[:, None], np.array(held).reshape(-1, len(share)).T
    size = np.linalg.lstsq(root * profiles, root * along.T, rcond=None)[0]
    slide = (profiles @ size).T
    return Apart(whole - slide[..., None] * tangent, along - slide, weight)


@lru_cache(maxsize=32)
def _slopes(basis: SplineBasis) -> FloatArray:
    """First derivatives of the basis functions at the points of the rule, shape (Q, n)."""
    return basis.matrix(rule(basis)[0], 1)
