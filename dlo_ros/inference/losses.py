# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What a fit of a model to recordings minimises: minus the log likelihood of what it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import xlogy

from dlo_ros.inference.joint import Evaluation, Field
from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.inference.variances import Variances
from dlo_ros.spline import FloatArray

CONVERGED = 0.5
"""Gain of the log posterior at which a fit ends whose result is compared with others."""
CONVERGED_TO_REPORT = 0.01
"""The same of numbers that are reported: with a gain of a half a number may be one standard
deviation from its best value, with this one a seventh."""
WHITE_CONVERGED = 0.02
"""Gain over the whole misfit, at which a fit ends that takes all that is left for white noise: the
nearer it comes, the more of what is left is independent, and the more there is to gain."""
FARTHER = 1.1
"""ERR over that at the beginning of a fit and what does not matter, beyond which no step leads
whatever its likelihood: an error that dies out holds whole swings for little, and the fit would
follow their rapid part alone into a wrong minimum."""


def independent(spectra: Sequence[Spectrum]) -> float:
    """Number of independent residuals: the exponential of their spectrum's entropy.

    A model that is wrong leaves few modes and frequencies, with thousands of residuals (Roy and
    Vetterli, The effective rank, 2007).
    """
    squares = np.concatenate([s.sum_of_squares for s in spectra])
    share, count = squares / squares.sum(), np.concatenate([s.count for s in spectra])
    return float(np.exp(-np.sum(xlogy(share, share / count))))


@dataclass(frozen=True)
class CorrelatedLoss:
    """Errors are correlated as their variances say (`dlo_ros.inference.variances`).

    Args:
        converged: gain of the log posterior at which a fit ends.
        known: variances of each recording, such as those of an observer; None: they are fitted.
        goes_on: whether the fit begins where another one has ended, and has been led as far from
            the shapes as any may be.
    """

    converged: float = CONVERGED
    known: tuple[Variances, ...] | None = None
    goes_on: bool = False

    @property
    def fits_variances(self) -> bool:
        """Whether the variances of the errors are fitted anew in each iteration."""
        return self.known is None

    @property
    def farther(self) -> float:
        """ERR over that at the beginning, beyond which no step leads, see `FARTHER`."""
        if self.known is not None:
            return np.inf
        return 1.0 if self.goes_on else FARTHER

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """Hessian (P, P) and gradient (P,) of the data's log likelihood, without the prior."""
        variances = self.known or at.variances
        pairs = [(1.0 / v.of(s), s) for s, v in zip(at.spectra, variances, strict=True)]
        hessian = sum(np.einsum("b,bpq->pq", w, s.hessian) for w, s in pairs)
        return np.asarray(hessian), np.asarray(sum(w @ s.gradient for w, s in pairs))

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """The loss of a model's values, with another's variances, without the prior."""
        variances = self.known or reference.variances
        pairs = zip(at.spectra, reference.spectra, variances, strict=True)
        return 0.5 * sum(float(s.sum_of_squares @ (1.0 / v.of(r))) for s, r, v in pairs)

    def least_gain(self, at: Evaluation) -> float:
        """Gain at which a fit ends."""
        return self.converged


@dataclass(frozen=True)
class WhiteLoss:
    """All that is left counts as white noise, as far as it is independent, whose size it tells.

    Args:
        noise: relative standard deviation of each coefficient, shape (K,), of each recording; None:
            all are alike.
        converged: gain over the misfit at which a fit ends.
    """

    noise: Sequence[FloatArray] | None = None
    converged: float = WHITE_CONVERGED
    farther: ClassVar[float] = np.inf
    fits_variances: ClassVar[bool] = False

    def normal_equations(self, at: Evaluation) -> tuple[FloatArray, FloatArray]:
        """See `CorrelatedLoss`."""
        weight = independent(at.spectra) / self._squares(at)
        size = len(at.model.parameters)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        for residual, jacobian in self._fields(at):
            rows = jacobian.transpose(0, 2, 1).reshape(-1, size)
            hessian += rows.T @ rows
            gradient += rows.T @ residual.ravel()
        return weight * hessian, weight * gradient

    def value(self, at: Evaluation, reference: Evaluation) -> float:
        """See `CorrelatedLoss`."""
        count = independent(reference.spectra)
        return 0.5 * count * self._squares(at) / self._squares(reference)

    def least_gain(self, at: Evaluation) -> float:
        """See `CorrelatedLoss`."""
        return self.converged * misfit(at, at, self)

    def _fields(self, at: Evaluation) -> list[Field]:
        if self.noise is None:
            return list(at.fields)
        return [(r / n, j / n) for (r, j), n in zip(at.fields, self.noise, strict=True)]

    def _squares(self, at: Evaluation) -> float:
        """Sum of squared residuals."""
        return sum(float(np.sum(r**2)) for r, _ in self._fields(at))


Loss = CorrelatedLoss | WhiteLoss
CORRELATED, WHITE = CorrelatedLoss(), WhiteLoss()
TO_REPORT = CorrelatedLoss(CONVERGED_TO_REPORT, goes_on=True)


def misfit(at: Evaluation, reference: Evaluation, loss: Loss = CORRELATED) -> float:
    """Minus the log posterior of a model's values, with another's variances."""
    return loss.value(at, reference) + at.model.surprise()
