# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Errors of which neighbouring frames share a part: autoregressive processes of first order."""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray


def ar1_spectral_density(memory: float | FloatArray, frequency: FloatArray) -> FloatArray:
    """Spectral density of an AR(1) process of unit variance."""
    return np.asarray((1.0 - memory**2) / (1.0 - 2.0 * memory * np.cos(frequency) + memory**2))


def ar1_rate(memory: float | FloatArray, frequency: FloatArray) -> FloatArray:
    """Derivative of the log of `ar1_spectral_density` by minus ln (1 - memory)."""
    cosine = np.cos(frequency)
    below = 1.0 - 2.0 * memory * cosine + memory**2
    return np.asarray(
        -2.0 * memory / (1.0 + memory) - 2.0 * (1.0 - memory) * (memory - cosine) / below
    )
