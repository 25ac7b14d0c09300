# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What a fit of a model to recordings minimises: minus the log likelihood of what it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from dlo_ros.inference.joint import Evaluation, Field, Simulated
from dlo_ros.inference.variances import Variances
from dlo_ros.spline import FloatArray

CONVERGED = 0.5
"""Gain of the log posterior at which a fit ends whose result is compared with others."""
CONVERGED_TO_REPORT = 0.01
"""The same of numbers that are reported: with a gain of a half a number may be one standard
deviation from its best value, with this one a seventh."""
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
    """Errors are correlated as their variances say (`dlo_ros.inference.variances`).

    Args:
        converged: gain of the log posterior at which a fit ends.
        known: variances of each recording, such as those of an observer; None: they are fitted.
    """

    converged: float = CONVERGED
    known: tuple[Variances, ...] | None = None

    @property
    def fits_variances(self) -> bool:
        """See `Loss`."""
        return self.known is None

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """See `Loss`."""
        variances = self.known or at.variances
        pairs = [(1.0 / v.of(s), s) for s, v in zip(at.spectra, variances, strict=True)]
        hessian = sum(np.einsum("b,bpq->pq", w, s.hessian) for w, s in pairs)
        return np.asarray(hessian), np.asarray(sum(w @ s.gradient for w, s in pairs))

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """See `Loss`."""
        variances = self.known or reference.variances
        pairs = zip(at.spectra, reference.spectra, variances, strict=True)
        return 0.5 * sum(float(s.sum_of_squares @ (1.0 / v.of(r))) for s, r, v in pairs)

    def least_gain(self, at: Evaluation) -> float:
        """See `Loss`."""
        return self.converged


@dataclass(frozen=True)
class WhiteLoss:
    """All that is left counts as white noise, whose size it tells itself.

    Args:
        noise: relative standard deviation of each coefficient, shape (K,), of each recording; None:
            all are alike.
        converged: gain over the misfit at which a fit ends.
    """

    noise: Sequence[FloatArray] | None = None
    converged: float = WHITE_CONVERGED
    fits_variances: ClassVar[bool] = False

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """See `Loss`."""
        fields, (squares, count) = self._fields(at), self._squares(at)
        hessian, gradient = _summed(fields, [np.ones(len(r)) for r, _ in fields])
        return hessian * count / squares, gradient * count / squares

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """See `Loss`."""
        squares, count = self._squares(reference)
        return 0.5 * count * self._squares(at)[0] / squares

    def least_gain(self, at: Evaluation) -> float:
        """See `Loss`."""
        return self.converged * misfit(at, at, self)

    def _fields(self, at: Evaluation) -> list[Field]:
        return list(at.fields) if self.noise is None else _in_units(at.fields, self.noise)

    def _squares(self, at: Evaluation) -> tuple[float, int]:
        """Sum of squared residuals, and their number."""
        residuals = [r for r, _ in self._fields(at)]
        return sum(float(np.sum(r**2)) for r in residuals), sum(r.size for r in residuals)


@dataclass(frozen=True)
class RobustLoss:
    """Pictures that a model misses by more than a scale count little, as of a Cauchy distribution.

    Args:
        noise: standard deviation of each coefficient [m], shape (K,), of each recording.
        scale: deviation of pictures that are right, in units of the noise.
        redescending: whether outliers count for nothing (Geman and McClure, 1987), which needs a
            start near the right fit.
    """

    noise: Sequence[FloatArray]
    scale: float
    redescending: bool = False
    fits_variances: ClassVar[bool] = False

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """See `Loss`."""
        weights = [1.0 / (1.0 + s) ** (2 if self.redescending else 1) for s in self.squares(at)]
        return _summed(_in_units(at.fields, self.noise), weights)

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """See `Loss`."""
        sizes = [0.5 * len(noise) * self.scale**2 for noise in self.noise]
        return sum(n * self._of(s) for n, s in zip(sizes, self.squares(at), strict=True))

    def least_gain(self, at: Evaluation) -> float:
        """See `Loss`."""
        return ROBUST_CONVERGED * self.value(at, at)

    def squares(self, at: Simulated) -> list[FloatArray]:
        """Mean square of each picture's residual over the squared scale, shape (F,) each."""
        fields = _in_units(at.fields, self.noise)
        return [np.mean(r**2, axis=1) / self.scale**2 for r, _ in fields]

    def of_pictures(self, at: Simulated) -> float:
        """The loss in units of that of a picture which is right; of outliers nearly their number
        where they count for nothing.
        """
        return sum(map(self._of, self.squares(at)))

    def _of(self, squares: FloatArray) -> float:
        each = squares / (1.0 + squares) if self.redescending else np.log1p(squares)
        return float(np.sum(each))


CORRELATED, WHITE = CorrelatedLoss(), WhiteLoss()
TO_REPORT = CorrelatedLoss(CONVERGED_TO_REPORT)


def misfit(at: Evaluation, reference: Evaluation, loss: Loss = CORRELATED) -> float:
    """Minus the log posterior of a model's values, with another's variances."""
    prior = float(at.model.precision() @ at.model.offset() ** 2)
    return loss.value(at, reference) + 0.5 * prior


def _in_units(fields: Sequence[Field], noise: Sequence[FloatArray]) -> list[Field]:
    """Residuals and derivatives in units of each coefficient's noise."""
    return [(r / n, j / n) for (r, j), n in zip(fields, noise, strict=True)]


def _summed(
    fields: Sequence[Field], weights: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of all recordings.

    Args:
        weights: weight of each picture, shape (F,) each.
    """
    size = fields[0][1].shape[1]
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    for (residual, jacobian), weight in zip(fields, weights, strict=True):
        rows = jacobian.transpose(0, 2, 1)
        weighted = (rows * weight[:, None, None]).reshape(-1, size)
        hessian += weighted.T @ rows.reshape(-1, size)
        gradient += weighted.T @ residual.ravel()
    return hessian, gradient
