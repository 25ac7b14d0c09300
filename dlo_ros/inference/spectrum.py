# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Residuals and Jacobians as sums over bins of frequency and smoothness.

Errors of real measurements and of models are correlated in time and along the DLO. The cosine
transform in time and the principal modes of a smooth function along the DLO make such errors nearly
independent (Whittle, Estimation and information in stationary time series, 1953), so that in each
bin their variance is one number. The normal equations of each bin are all that inference needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise, product

import numpy as np
from scipy.fft import dct

from dlo_ros.inference.smooth_modes import modes, whitening
from dlo_ros.spline import FloatArray

GROWTH = 1.6
"""Ratio of neighbouring frequency bins' borders."""
MODE_GROUPS = (0, 1, 2, 3, 5, 8)
"""First mode of each group of modes along the DLO, smoothest first."""


@dataclass(frozen=True)
class Spectrum:
    """Normal equations of one recording, bin by bin; B bins, P parameters.

    Args:
        frames: number of frames F; of joined spectra that of all of them.
        count: number of values in each bin, shape (B,).
        sum_of_squares: sum of squared residuals [m^2], shape (B,).
        gradient: J^T r, shape (B, P).
        hessian: J^T J, shape (B, P, P).
        part: 0 across the DLO in the plane, 1 along it, 2 out of the plane, shape (B,).
        share: mean share of a number in the mean square of a smooth error, shape (B,).
        white: the same of an error that is white along the DLO, shape (B,).
        nodal: the same of one that every control point has of its own, shape (B,).
        frequency: mean of the bin, in radians a frame, shape (B,).
        motion: mean square of the DLO's own motion at these frequencies, in a number that is smooth
            along the DLO as `share` says [m^2], shape (B,).
        still: F where the frequency is zero, else 0: by how much more the variance of an error that
            is the same in all frames is seen there, shape (B,).
        jacobian: the Jacobian itself, by parts, modes, and frequencies, shape (D, n, F, P); None
            where it is not kept.
    """

    frames: int
    count: FloatArray
    sum_of_squares: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    part: np.ndarray
    share: FloatArray
    white: FloatArray
    nodal: FloatArray
    frequency: FloatArray
    motion: FloatArray
    still: FloatArray
    jacobian: FloatArray | None = None

    @property
    def parts(self) -> int:
        """Number of directions: 2 in the plane, 3 in space."""
        return int(self.part.max()) + 1

    def chosen(self, columns: Sequence[int]) -> Spectrum:
        """The spectrum of some of the parameters, of which the Jacobian is not kept."""
        pick = np.array(columns, dtype=np.int64)
        return replace(
            self, gradient=self.gradient[:, pick], hessian=self.hessian[:, pick[:, None], pick],
            jacobian=None,
        )  # fmt: skip

    def of_residual(self, residual: FloatArray, columns: Sequence[int]) -> Spectrum:
        """The spectrum of other residuals with the same Jacobian, by some of the parameters.

        Args:
            residual: coefficients [m], shape (F, K).
            columns: numbers of the parameters.
        """
        assert self.jacobian is not None  # it is that of a recording
        every = list(columns) == list(range(self.gradient.shape[1]))
        jacobian = self.jacobian if every else self.jacobian[..., list(columns)]
        parts, n, frames, count = jacobian.shape
        left = transformed(residual[:, None], n)
        bins = list(product(bands(frames), range(parts), mode_groups(n)))
        values = [left[p, a:b, low:high].ravel() for (low, high), p, (a, b) in bins]
        slopes = [jacobian[p, a:b, low:high].reshape(-1, count) for (low, high), p, (a, b) in bins]
        return replace(
            self if every else self.chosen(columns),
            sum_of_squares=np.array([x @ x for x in values]),
            gradient=np.array([x @ j for x, j in zip(values, slopes, strict=True)]),
            jacobian=jacobian,
        )


def joined(spectra: Sequence[Spectrum]) -> Spectrum:
    """The bins of some recordings, one after the other."""
    arrays = {
        f.name: np.concatenate([getattr(s, f.name) for s in spectra])
        for f in fields(Spectrum) if f.name not in ("frames", "jacobian")
    }  # fmt: skip
    return Spectrum(frames=sum(s.frames for s in spectra), **arrays)


@lru_cache(maxsize=32)
def nodal_shares(control_points: int) -> FloatArray:
    """Shares of the modes in the mean square of errors of single control points, shape (n,)."""
    vectors, _ = modes(control_points)
    found = np.sum((whitening(control_points, 1.0) @ vectors) ** 2, axis=0)
    return np.asarray(found / found.sum())


def bands(frames: int) -> list[tuple[int, int]]:
    """Borders of the frequency bins; the mean over time has one of its own."""
    borders = [0]
    while borders[-1] < frames:
        borders.append(min(max(borders[-1] + 1, round(GROWTH * borders[-1])), frames))
    return list(pairwise(borders))


def mode_groups(control_points: int) -> list[tuple[int, int]]:
    """First and last of the modes along the DLO in each group."""
    return list(pairwise([*(g for g in MODE_GROUPS if g < control_points), control_points]))


def transformed(fields: FloatArray, control_points: int) -> FloatArray:
    """Fields by direction, mode along the DLO, and frequency, shape (parts, n, F, C).

    Args:
        fields: C fields of coefficients, shape (F, C, K), K = parts * n.
        control_points: n.
    """
    n, (frames, count, _) = control_points, fields.shape
    found = dct(fields, axis=0, norm="ortho").reshape(-1, n) @ modes(n)[0]
    return np.ascontiguousarray(found.reshape(frames, count, -1, n).transpose(2, 3, 0, 1))


def motion_power(coefficients: FloatArray) -> FloatArray:
    """Power of a recorded motion at each frequency of the cosine transform [m^2], shape (F,).

    Args:
        coefficients: of what is moved from where it is in the mean [m], shape (F, K).
    """
    return np.asarray(np.sum(dct(coefficients, axis=0, norm="ortho") ** 2, axis=1))


def spectrum(
    residual: FloatArray, jacobian: FloatArray, control_points: int,
    motion: FloatArray | None = None,
) -> Spectrum:  # fmt: skip
    """Compress residuals and Jacobians of one recording.

    Args:
        residual: coefficients [m], shape (F, K), K = parts * n; see `Recording.across`.
        jacobian: derivatives of the prediction, shape (F, P, K).
        control_points: n.
        motion: power of the motion, see `motion_power`, shape (F or more,); None: it is not known.
    """
    frames, width = residual.shape
    n = control_points
    shares, nodal = modes(n)[1], nodal_shares(n)
    both = transformed(np.concatenate([residual[:, None], jacobian], axis=1), n)
    groups = mode_groups(n)
    bins = list(product(bands(frames), range(width // n), groups))
    values = [
        both[part, first:last, low:high].reshape(-1, both.shape[3])
        for (low, high), part, (first, last) in bins
    ]
    products = np.array([x.T @ x for x in values])  # (B, 1 + P, 1 + P)
    again, in_band = len(bins) // len(groups), len(groups) * (width // n)
    share, alone = (np.tile([x[a:b].mean() for a, b in groups], again) for x in (shares, nodal))
    frequency = np.array([np.pi * 0.5 * (low + high - 1) / frames for (low, high), _, _ in bins])
    power = np.zeros(frames) if motion is None else motion
    swing = np.repeat([power[low:high].mean() for low, high in bands(frames)], in_band)
    return Spectrum(
        frames,
        count=np.array([len(x) for x in values], dtype=np.float64),
        sum_of_squares=products[:, 0, 0],
        gradient=products[:, 0, 1:],
        hessian=products[:, 1:, 1:],
        part=np.array([part for _, part, _ in bins]),
        share=share,
        white=np.full(len(bins), 1.0 / n),
        nodal=alone,
        frequency=frequency,
        motion=swing * share,
        still=np.where(frequency == 0.0, float(frames), 0.0),
        jacobian=both[..., 1:],
    )
