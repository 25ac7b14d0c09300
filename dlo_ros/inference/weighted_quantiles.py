# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Quantiles of values that do not count alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.spline import FloatArray


def weighted_quantiles(
    values: FloatArray, weights: FloatArray, levels: Sequence[float]
) -> FloatArray:
    """Quantiles of weighted values, each in the middle of its weight, linear between them.

    Args:
        values: numbers, shape (N,).
        weights: their weights, which sum to 1, shape (N,).
        levels: levels between 0 and 1, L of them.

    Returns:
        Shape (L,).
    """
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    return np.asarray(np.interp(levels, below, values[order]))
