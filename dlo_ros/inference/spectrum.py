# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Residuals and Jacobians as sums over bins of frequency and smoothness.

Errors of real measurements and of models are correlated in time and along the DLO. The cosine
transform in time and the principal modes of a smooth function along the DLO make such errors nearly
independent (Whittle, Estimation and information in stationary time series, 1953), so that in each
bin their variance is one number. The normal equations of each bin are all that inference needs.

Recordings of one set-up share its errors, those of its calibration above all, which are the same in
all frames of all recordings. They stand in the mean over all frames of all recordings and in
nothing that is orthogonal to it. So the means over time of R recordings are turned into that mean,
which is kept with the first recording, and R - 1 contrasts between recordings.
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
        alike: the same of an error that is the same in all frames of all recordings; of the first
            recording alone it is not 0, shape (B,).
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
    alike: FloatArray
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
    """Compress residuals and Jacobians of one recording by itself; see `spectra`."""
    return spectra([(residual, jacobian)], control_points, None if motion is None else [motion])[0]


def spectra(
    fields: Sequence[tuple[FloatArray, FloatArray]], control_points: int,
    motions: Sequence[FloatArray] | None = None,
) -> tuple[Spectrum, ...]:  # fmt: skip
    """Compress residuals and Jacobians of R recordings of one set-up.

    Args:
        fields: of each recording: residual coefficients [m], shape (F, K), K = parts * n, see
            `Recording.across`, and derivatives of the prediction, shape (F, P, K).
        control_points: n.
        motions: power of each motion, see `motion_power`, shape (F or more,); None: not known.
    """
    n = control_points
    both = [transformed(np.concatenate([r[:, None], j], axis=1), n) for r, j in fields]
    frames = np.array([x.shape[2] for x in both], dtype=np.float64)
    turn = _turn_means(both)
    result = []
    for k, x in enumerate(both):
        power = np.zeros(x.shape[2]) if motions is None else motions[k]
        alike = float(frames.sum()) if k == 0 else 0.0
        result.append(_binned(x, power, float(turn[k] ** 2 @ frames), alike))
    return tuple(result)


def of_residuals(
    known: Sequence[Spectrum], residuals: Sequence[FloatArray], columns: Sequence[int]
) -> tuple[Spectrum, ...]:
    """The spectra of other residuals with the same Jacobians, by some of the parameters.

    Args:
        known: spectra of all recordings, with Jacobians.
        residuals: of each recording, coefficients [m], shape (F, K).
        columns: numbers of the parameters.
    """
    jacobians = [s.jacobian for s in known if s.jacobian is not None]
    assert len(jacobians) == len(known)  # they are those of recordings
    left = [transformed(r[:, None], j.shape[1]) for r, j in zip(residuals, jacobians, strict=True)]
    _turn_means(left)
    every = list(columns) == list(range(known[0].gradient.shape[1]))
    result = []
    for s, x, j in zip(known, left, jacobians, strict=True):
        jacobian = j if every else j[..., list(columns)]
        values = [y[:, 0] for y in _by_bin(x)]
        result.append(replace(
            s if every else s.chosen(columns),
            sum_of_squares=np.array([y @ y for y in values]),
            gradient=np.array([y @ z for y, z in zip(values, _by_bin(jacobian), strict=True)]),
            jacobian=jacobian,
        ))  # fmt: skip
    return tuple(result)


def _turn_means(both: Sequence[FloatArray]) -> FloatArray:
    """Turn means over time into one over all frames of all recordings, and contrasts, in place.

    Args:
        both: transformed fields of R recordings, shapes (parts, n, F, C).

    Returns:
        The orthogonal matrix (R, R); its first row is that of the mean.
    """
    if len(both) == 1:
        return np.ones((1, 1))
    root = np.sqrt([x.shape[2] for x in both])
    mirror = root / np.linalg.norm(root) - np.eye(len(both))[0]
    turn = np.eye(len(both)) - 2.0 * np.outer(mirror, mirror) / (mirror @ mirror)  # Householder
    turned = np.tensordot(turn, np.array([x[:, :, 0] for x in both]), 1)
    for x, mean in zip(both, turned, strict=True):
        x[:, :, 0] = mean
    return np.asarray(turn)


def _by_bin(both: FloatArray) -> list[FloatArray]:
    """The numbers of transformed fields (parts, n, F, C) in each bin, B arrays (m, C)."""
    parts, n, frames, columns = both.shape
    return [
        both[part, first:last, low:high].reshape(-1, columns)
        for (low, high), part, (first, last) in product(bands(frames), range(parts), mode_groups(n))
    ]


def _binned(both: FloatArray, motion: FloatArray, still: float, alike: float) -> Spectrum:
    """Normal equations of a transformed residual and its derivatives, (parts, n, F, 1 + P)."""
    parts, n, frames, _ = both.shape
    shares, nodal = modes(n)[1], nodal_shares(n)
    groups = mode_groups(n)
    bins, values = list(product(bands(frames), range(parts), groups)), _by_bin(both)
    products = np.array([x.T @ x for x in values])  # (B, 1 + P, 1 + P)
    again, in_band = len(bins) // len(groups), len(groups) * parts
    share, alone = (np.tile([x[a:b].mean() for a, b in groups], again) for x in (shares, nodal))
    frequency = np.array([np.pi * 0.5 * (low + high - 1) / frames for (low, high), _, _ in bins])
    swing = np.repeat([motion[low:high].mean() for low, high in bands(frames)], in_band)
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
        still=np.where(frequency == 0.0, still, 0.0),
        alike=np.where(frequency == 0.0, alike, 0.0),
        jacobian=both[..., 1:],
    )
