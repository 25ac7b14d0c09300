# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Surrogates of residuals: random fields that relations found by chance are compared with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from dlo_ros.spline import FloatArray

SURROGATES = 800
ENVELOPE = 0.2
"""Share of a recording over which the size of its residual is smoothed."""


def chances(
    amplitudes: Sequence[FloatArray], slow: Sequence[FloatArray], judged: dict[str, FloatArray],
    rng: np.random.Generator,
) -> dict[str, tuple[float, float]]:  # fmt: skip
    """Share of surrogates, Gaussian and shifted, that each input explains as well as the residual.

    Args:
        amplitudes: amplitudes of patterns along the DLO over time, for each recording, shape (F,
            M).
        slow: orthonormal columns that span slow drifts, for each recording, shape (F, d).
        judged: orthonormal columns of each input without drift, all recordings below one another.

    Returns:
        For each input the share of Gaussian surrogates of which the best of all inputs explains as
        much, and of shifted ones of which this input does.
    """
    moving = [without(a, s) for a, s in zip(amplitudes, slow, strict=True)]
    drawn = [_gaussian(a, rng) for a in amplitudes], [_shifted(m, rng) for m in moving]
    gaussian, shifted = (
        _explained([without(d, s) for d, s in zip(kind, slow, strict=True)], judged)
        for kind in drawn
    )
    real = _explained([m[:, None] for m in moving], judged)
    ranks = {n: 1.0 - np.searchsorted(np.sort(e), e) / len(e) for n, e in gaussian.items()}
    best = np.min(list(ranks.values()), axis=0)
    result = {}
    for name, (here,) in real.items():
        own = float(np.mean(gaussian[name] >= here))
        same = float(np.sum(shifted[name] >= here * (1.0 - 1e-9)))
        result[name] = (
            float((1 + np.sum(best <= own)) / (len(best) + 1)), (1 + same) / (SURROGATES + 1)
        )  # fmt: skip
    return result


def without(field: FloatArray, slow: FloatArray) -> FloatArray:
    """A field (F, ...) without what orthonormal columns (F, d) explain."""
    flat = field.reshape(len(field), -1)
    return np.asarray((flat - slow @ (slow.T @ flat)).reshape(field.shape))


def _explained(
    fields: Sequence[FloatArray], judged: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    """Share of the power of fields (F, S, M), one for each recording, by each input, shape (S,)."""
    whole = np.concatenate(fields)
    power = np.maximum(np.sum(whole**2, axis=(0, 2)), 1e-300)
    return {
        name: np.sum(np.tensordot(basis, whole, (0, 0)) ** 2, axis=(0, 2)) / power
        for name, basis in judged.items()
    }


def _gaussian(part: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Fields of the same spectrum and size over time, shape (F, S, M)."""
    frames = len(part)
    power = gaussian_filter1d(np.sum(part**2, axis=1), max(ENVELOPE * frames, 1.0))
    envelope = np.sqrt(power + 0.02 * np.mean(power) + 1e-300)[:, None]
    spectrum = np.fft.rfft(part / envelope, axis=0)[:, None]
    drawn = rng.normal(size=(2, len(spectrum), SURROGATES, 1))
    fields = np.fft.irfft(spectrum * (drawn[0] + 1j * drawn[1]), n=frames, axis=0)
    return np.asarray(fields * envelope[:, None])


def _shifted(part: FloatArray, rng: np.random.Generator) -> FloatArray:
    """The field moved in time, around the end to the beginning, with drawn sign, (F, S, M)."""
    frames = len(part)
    first = rng.integers(frames, size=SURROGATES)
    sign = rng.choice([-1.0, 1.0], size=(SURROGATES, 1))
    return np.asarray(sign * part[(first + np.arange(frames)[:, None]) % frames])
