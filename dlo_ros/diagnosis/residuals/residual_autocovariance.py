# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Autocovariance of residuals from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.inference.thresholds import CHANCE
from dlo_ros.spline import FloatArray

DRAWS = 400


def root_autocovariance(residuals: Sequence[FloatArray]) -> float:
    """Square root of the autocovariance at a lag of one frame, in units of the noise, signed.

    Noise that is new in every frame does not contribute to the product of neighbouring frames. A
    recording of one frame has none; there the variance beyond the noise takes its place.

    Args:
        residuals: residuals of each recording, shape (F, K).
    """
    products, count = 0.0, 0
    for r in residuals:
        if len(r) > 1:
            products += float(np.sum(r[1:] * r[:-1]))
            count += r[1:].size
        else:
            products += float(np.sum(r**2 - 1.0))
            count += r.size
    return float(np.sign(products) * np.sqrt(abs(products) / max(count, 1)))


def chance(residuals: Sequence[FloatArray], seed: int = 0) -> float:
    """The root autocovariance that residuals of the same size exceed by chance, see `CHANCE`.

    The frames are given random signs: what repeats along the DLO within a frame stays. A recording
    of one frame has no neighbours; for it noise is drawn.
    """
    rng = np.random.default_rng(seed)

    def drawn(r: FloatArray) -> FloatArray:
        if len(r) == 1:
            return rng.normal(size=r.shape)
        return np.asarray(r * rng.choice([-1.0, 1.0], (len(r), 1)))

    found = [root_autocovariance([drawn(r) for r in residuals]) for _ in range(DRAWS)]
    return float(np.quantile(found, 1.0 - CHANCE))
