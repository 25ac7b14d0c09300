# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What a fit of a model to recordings minimises: minus the log likelihood of what it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.spline import FloatArray

CONVERGED = 0.5
"""Gain of the log posterior at which a fit ends."""
WHITE_CONVERGED = 0.05
"""Gain over the whole misfit, at which a fit ends that takes all that is left for white noise."""
ROBUST_CONVERGED = 0.01
"""The same of a robust fit."""


class Loss(Protocol):
    """A way to judge what a model leaves."""

    @property
    def fits_variances(self) -> bool:
        """Whether the variances of the errors are fitted anew in each iteration."""

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """Hessian (P, P) and gradient (P,) of the data's log likelihood, without the prior."""

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """The loss of a model's values, with another's variances, without the prior."""

    def least_gain(self, at: Evaluation) -> float:
        """Gain at which a fit ends."""


@dataclass(frozen=True)
class CorrelatedLoss:
    """Errors are correlated as their variances say (`dlo_ros.inference.variances`)."""

    fits_variances: ClassVar[bool] = True

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """See `Loss`."""
        return _weighted(at.spectra, _inverse_variances(at))

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """See `Loss`."""
        return _half_sum(at.spectra, _inverse_variances(reference))

    def least_gain(self, at: Evaluation) -> float:
        """See `Loss`."""
        return CONVERGED


@dataclass(frozen=True)
class WhiteLoss:
    """All that is left counts as white noise of one variance.

    Args:
        converged: gain over the misfit at which a fit ends.
    """

    converged: float = WHITE_CONVERGED
    fits_variances: ClassVar[bool] = False

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """See `Loss`."""
        return _weighted(at.spectra, _inverse_variance(at))

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """See `Loss`."""
        return _half_sum(at.spectra, _inverse_variance(reference))

    def least_gain(self, at: Evaluation) -> float:
        """See `Loss`."""
        return self.converged * misfit(at, at, self)


@dataclass(frozen=True)
class RobustLoss:
    """Pictures that a model misses by more than a scale count little, as of a Cauchy distribution.

    Args:
        noise: standard deviation of each coefficient [m], shape (K,), of each recording.
        scale: deviation of pictures that are right, in units of the noise.
        redescending: whether outliers count for nothing (Geman and McClure, 1987), which needs a
            start near the right fit.
    """

    noise: tuple[FloatArray, ...]
    scale: float
    redescending: bool = False
    fits_variances: ClassVar[bool] = False

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """See `Loss`."""
        size = len(at.model.parameters)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        for (r, j), noise, beyond in zip(at.fields, self.noise, self.squares(at), strict=True):
            root = 1.0 / (1.0 + beyond) ** (1.0 if self.redescending else 0.5)
            rows = (j * (root[:, None] / noise)[:, None]).transpose(0, 2, 1).reshape(-1, size)
            hessian += rows.T @ rows
            gradient += rows.T @ (r * root[:, None] / noise).ravel()
        return hessian, gradient

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """See `Loss`."""
        counts = [len(n) * self.scale**2 for n in self.noise]
        losses = map(self.of_pictures, self.squares(at))
        return 0.5 * sum(c * loss for c, loss in zip(counts, losses, strict=True))

    def least_gain(self, at: Evaluation) -> float:
        """See `Loss`."""
        return ROBUST_CONVERGED * self.value(at, at)

    def squares(self, at: Evaluation) -> list[FloatArray]:
        """Mean square of each picture's residual over the squared scale, shape (F,) each."""
        return [
            np.mean((r / noise) ** 2, axis=1) / self.scale**2
            for (r, _), noise in zip(at.fields, self.noise, strict=True)
        ]

    def of_pictures(self, squares: FloatArray) -> float:
        """The loss of some pictures, in units of that of one which is right."""
        each = squares / (1.0 + squares) if self.redescending else np.log1p(squares)
        return float(np.sum(each))


CORRELATED, WHITE = CorrelatedLoss(), WhiteLoss()


def misfit(at: Evaluation, reference: Evaluation, loss: Loss = CORRELATED) -> float:
    """Minus the log posterior of a model's values, with another's variances."""
    prior = float(at.model.precision() @ at.model.offset() ** 2)
    return loss.value(at, reference) + 0.5 * prior


def _inverse_variances(at: Evaluation) -> list[FloatArray]:
    """Inverse variance of each bin of each recording."""
    return [1.0 / v.of(s) for s, v in zip(at.spectra, at.variances, strict=True)]


def _inverse_variance(at: Evaluation) -> list[FloatArray]:
    """That of everything together, for each bin of each recording."""
    squares = sum(float(s.sum_of_squares.sum()) for s in at.spectra)
    count = sum(float(s.count.sum()) for s in at.spectra)
    return [np.full(len(s.count), count / squares) for s in at.spectra]


def _weighted(
    spectra: Sequence[Spectrum], weights: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Sum of the normal equations of all bins."""
    pairs = list(zip(spectra, weights, strict=True))
    hessian = sum(np.einsum("b,bpq->pq", w, s.hessian) for s, w in pairs)
    return np.asarray(hessian), np.asarray(sum(w @ s.gradient for s, w in pairs))


def _half_sum(spectra: Sequence[Spectrum], weights: Sequence[FloatArray]) -> float:
    """Half the weighted sum of squares."""
    pairs = zip(spectra, weights, strict=True)
    return 0.5 * sum(float(s.sum_of_squares @ w) for s, w in pairs)
