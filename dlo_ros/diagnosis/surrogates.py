"""Surrogates of residuals: what might be there by chance, to hold relations against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from dlo_ros.spline import FloatArray

SURROGATES = 800
ENVELOPE = 0.2
"""Of a recording, over which the size of its residual is smoothed."""


def chances(
    amplitudes: Sequence[FloatArray], slow: Sequence[FloatArray], judged: dict[str, FloatArray],
    rng: np.random.Generator,
) -> dict[str, tuple[float, float]]:  # fmt: skip
    """How often surrogates are explained as well, Gaussian ones and shifted ones, for each input.

    Args:
        amplitudes: per recording, over time, of patterns along the DLO, shape (F, M).
        slow: per recording, projection on what drifts, shape (F, F).
        judged: for each input orthonormal columns without drift, all recordings below one another.

    Returns:
        For each input the share of Gaussian surrogates of which the best of all inputs explains as
        much, and of shifted ones of which this input does.
    """
    moving = [a - s @ a for a, s in zip(amplitudes, slow, strict=True)]
    drawn = [_gaussian(a, rng) for a in amplitudes], [_shifted(m, rng) for m in moving]
    explained = [_explained([d - s @ d for d, s in zip(kind, slow, strict=True)], judged)
                 for kind in drawn]  # fmt: skip
    real = _explained([m[None] for m in moving], judged)
    gaussian, shifted = explained
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


def _explained(
    fields: Sequence[FloatArray], judged: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    """Share of the power of fields (S, F, M), one for each recording, by each input, shape (S,)."""
    whole = np.concatenate(fields, axis=1)
    power = np.maximum(np.sum(whole**2, axis=(1, 2)), 1e-300)
    return {n: np.sum((b.T @ whole) ** 2, axis=(1, 2)) / power for n, b in judged.items()}


def _gaussian(part: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Fields of the same spectrum and size over time, shape (S, F, M)."""
    frames = len(part)
    power = gaussian_filter1d(np.sum(part**2, axis=1), max(ENVELOPE * frames, 1.0))
    envelope = np.sqrt(power + 0.02 * np.mean(power) + 1e-300)[:, None]
    spectrum = np.fft.rfft(part / envelope, axis=0)
    drawn = rng.normal(size=(2, SURROGATES, len(spectrum), 1))
    fields = np.fft.irfft(spectrum * (drawn[0] + 1j * drawn[1]), n=frames, axis=1)
    return np.asarray(fields * envelope)


def _shifted(part: FloatArray, rng: np.random.Generator) -> FloatArray:
    """The field moved in time, around the end to the beginning, with drawn sign, (S, F, M)."""
    frames = len(part)
    first = rng.integers(frames, size=(SURROGATES, 1))
    sign = rng.choice([-1.0, 1.0], size=(SURROGATES, 1, 1))
    return np.asarray(sign * part[(first + np.arange(frames)) % frames])
