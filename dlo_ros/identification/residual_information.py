# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Information of residuals on parameters, with the actual covariance of the residuals.

Residuals are neither white nor alike in all directions: a camera measures across the DLO only,
errors of the calibration and of the model are the same in many pictures, and two rod theories
differ in the stretch. So the fit's gradient is taken as a sum of errors whose covariance is
estimated from the residuals, and the covariance of the parameters follows from that of the gradient
(a sandwich: H^-1 M H^-1 with H = J^T J and M = J^T Sigma J).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from dlo_ros.identification.information import determined_directions, strain
from dlo_ros.identification.residual_noise import correlation_length, lagged_products
from dlo_ros.inference.forecast import Forecast
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

FITTED = 2.0  # numbers that a fit takes out of the residuals
NOISE_LIMIT = 1e-7  # [m]: residuals below are rounding
MOST_LAGS = 2000  # frames between which a correlation is kept
DECAYED = 0.1  # of a correlation, below which the rest of it is not summed
# Curvature counts per length of the stretched rod (the paper's eq. (7)) or of the unstretched one,
# as most other simulators have it. Cantilevers of both kinds as boundary value problems differ by
# 1.1 to 2.5 of the strain in ln E (root mean square 1.9) and by up to 0.2 in what is left of the
# shape. A DLO may be of either kind: 1.9 / sqrt(2). A discrete rod of the second kind agrees.
STRETCH_SHAPE = 0.3  # of L


@dataclass(frozen=True)
class Errors:
    """Variances and correlations of the parts of one recording's residuals.

    Args:
        across, along: variance of the part that is new in every picture, of one number, across
            the DLO and along it [m^2].
        lasting: variance of the part that dies out over time [m^2].
        persistence: correlation of the drawn-out part from picture to picture, 0 to 1.
        constant: variance of the part that stays [m^2].
        reach: number of control points over which the lasting parts are correlated.
    """

    across: float
    along: float
    lasting: float
    persistence: float
    constant: float
    reach: float


def discrepancy(found: Forecast, settings: RodSettings) -> float:
    """Error of the shape that the model itself may have [m]: discretisation and rod theory."""
    rod, simulation = settings.rod, settings.simulation
    own = max(np.nan_to_num(found.resolution_error), simulation.tolerance)
    return float(rod.length * np.hypot(own, STRETCH_SHAPE * strain(settings)))


def tangents(predicted: FloatArray) -> FloatArray:
    """Directions of the predicted DLO at its control points' abscissae, shape (F, n, 3)."""
    basis = SplineBasis(predicted.shape[1], 1.0)
    slope = basis.matrix(basis.greville, 1) @ predicted[:, :, :3]
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=2, keepdims=True), 1e-12))


def residual_errors(residual: FloatArray, direction: FloatArray) -> Errors:
    """Decomposition of residuals into parts of different correlation.

    Args:
        residual: residual as in `Forecast`, shape (F, n, 3) [m].
        direction: unit tangents of the DLO, shape (F, n, 3).
    """
    frames, n, _ = residual.shape
    squares = np.sum(residual**2, axis=(0, 1))
    across_numbers = max(int(np.count_nonzero(squares > 1e-9 * max(squares.max(), 1e-300))) - 1, 1)
    lengthwise = np.sum(residual * direction, axis=2)
    along = float(np.mean(lengthwise**2))
    total = float(np.sum(squares)) / (frames * n)
    # All that is not white is taken to lie across: that is where shapes differ.
    rho = _autocovariance(residual) / n
    constant = float(np.mean(rho[frames // 4 : frames // 2 + 1])) if frames >= 8 else 0.0
    constant = max(constant, 0.0)
    lasting, persistence = 0.0, 0.0
    if 1 < frames < 8:
        constant = max(float(np.mean(rho[1:])), 0.0)
    elif frames >= 8:
        rest = rho[1 : frames // 4 + 1] - constant
        lasting = max(float(np.mean(rest[:2])), 0.0)
        if lasting > 0.0:
            below = np.flatnonzero(rest < DECAYED * lasting)
            stop = int(below[0]) if len(below) else len(rest)
            memory = max(float(np.sum(rest[:stop])) / lasting, 1e-3)
            persistence = memory / (1.0 + memory)
            lasting /= max(persistence, 0.3)
    else:
        constant = total  # one picture
    white = max(total - constant - lasting, 0.0) / max(total, 1e-300)
    mean = residual.mean(axis=0, keepdims=True)
    reach = correlation_length([mean], 1) if constant + lasting > 0.0 else 1.0
    # What the fit took out is put back.
    seen = _independent(frames, n, across_numbers, white, persistence, reach)
    back = seen / max(seen - FITTED, 0.5)
    return Errors(
        max(back * white * max(total - along, 0.0) / across_numbers, NOISE_LIMIT**2),
        back * white * along,
        back * lasting / across_numbers,
        persistence,
        back * constant / across_numbers,
        reach,
    )


def _autocovariance(residual: FloatArray) -> FloatArray:
    """Mean product of residuals that lie 0, 1, ... pictures apart, over all of a picture."""
    count = len(residual)
    return (lagged_products(residual) / np.arange(count, 0, -1))[:MOST_LAGS]


def _independent(
    frames: int, n: int, directions: int, white: float, persistence: float, reach: float
) -> float:
    """Estimated number of independent values among the residuals."""
    memory = (1.0 + persistence) / max(1.0 - persistence, 1e-3)
    lasting = max(frames / memory, 1.0) * n / reach
    return directions * (white * frames * n + (1.0 - white) * lasting)


@dataclass(frozen=True)
class NormalEquations:
    """J^T J of a least-squares problem, and the covariance of its J^T r.

    Args:
        hessian: J^T J, shape (P, P).
        passing: covariance of J^T r by errors that are new in every picture or die out, (P, P).
        staying: change of J^T r by each of C independent errors of unit variance that are the same
            in all pictures, shape (P, C).
    """

    hessian: FloatArray
    passing: FloatArray
    staying: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance of J^T r, shape (P, P)."""
        return np.asarray(self.passing + self.staying @ self.staying.T)

    def scaled(self, weight: float) -> NormalEquations:
        """The equations with residuals and derivatives in another unit."""
        return NormalEquations(
            weight * self.hessian, weight**2 * self.passing, weight * self.staying
        )

    def remembered(self, share: float) -> NormalEquations:
        """The equations as if the variance of passing errors were larger by a share's inverse."""
        return NormalEquations(share * self.hessian, share * self.passing, share * self.staying)

    def followed_by(self, other: NormalEquations) -> NormalEquations:
        """Both together: what stays is the same error in both, so that it does not average out."""
        return NormalEquations(
            self.hessian + other.hessian,
            self.passing + other.passing,
            self.staying + other.staying,
        )

    def information(self, shifts: Sequence[FloatArray] = ()) -> FloatArray:
        """Information on the P parameters, shape (P, P).

        Args:
            shifts: uncorrected errors of the parameters that are known to be possible, each (P,).
        """
        return sandwich(self.hessian, self.covariance + _shifted(self.hessian, shifts))


def _shifted(hessian: FloatArray, shifts: Sequence[FloatArray]) -> FloatArray:
    """Covariance of J^T r by parameters that are wrong by shifts, shape (P, P)."""
    moved = [hessian @ shift for shift in shifts]
    return np.asarray(sum((np.outer(m, m) for m in moved), np.zeros_like(hessian)))


def normal_equations(found: Forecast, settings: RodSettings | None = None) -> NormalEquations:
    """Normal equations of one recording, for what its residuals are made of.

    Args:
        found: forecast with derivatives.
        settings: settings of the model, for its own error; None leaves that out.
    """
    assert found.derivative is not None
    direction = tangents(found.predicted)
    own = 0.0 if settings is None else discrepancy(found, settings)
    errors = residual_errors(found.residual, direction)
    return _normal_equations(found.derivative, direction, errors, own)


def _normal_equations(
    derivative: FloatArray, direction: FloatArray, errors: Errors, own: float
) -> NormalEquations:
    """See `normal_equations`.

    Args:
        derivative: derivatives of the prediction as in `Forecast`, shape (F, P, n, 3).
        direction: unit tangents of the DLO, shape (F, n, 3).
        errors: variances and correlations of the residuals.
        own: error of the model [m], the same in all pictures and smooth along the DLO.
    """
    parameters, n = derivative.shape[1:3]
    lengthwise = np.sum(derivative * direction[:, None], axis=3)  # (F, P, n)
    total = np.einsum("fpic,fqic->pq", derivative, derivative)
    slide = np.einsum("fpi,fqi->pq", lengthwise, lengthwise)
    passing = errors.across * (total - slide) + errors.along * slide
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    near = np.exp(-2.0 * apart / errors.reach) if errors.reach > 1.0 else np.eye(n)
    if errors.lasting > 0.0:
        # The correlation dies out geometrically to either side: a filter forwards and backwards.
        decay = ([1.0], [1.0, -errors.persistence])
        carried = lfilter(*decay, derivative, axis=0) - derivative
        carried += lfilter(*decay, derivative[::-1], axis=0)[::-1]
        carried = np.einsum("ij,fpjc->fpic", near, carried)
        passing = passing + errors.lasting * np.einsum("fpic,fqic->pq", derivative, carried)
    summed = derivative.sum(axis=0)  # (P, n, 3)
    staying = [
        np.sqrt(variance) * np.einsum("pic,ik->pkc", summed, np.linalg.cholesky(shape))
        for variance, shape in ((errors.constant, near), (own**2 / n, np.exp(-2.0 * apart / n)))
    ]
    columns = np.stack(staying, axis=1).reshape(parameters, -1)
    return NormalEquations(total, np.asarray(passing), np.asarray(columns))


def sandwich(hessian: FloatArray, covariance: FloatArray) -> FloatArray:
    """H M^-1 H, where flat directions of H stay flat."""
    scale, _, basis = determined_directions(hessian)
    h = hessian * np.outer(scale, scale)
    m = covariance * np.outer(scale, scale)
    inner = np.linalg.pinv(basis.T @ m @ basis, hermitian=True)
    right = basis.T @ h / scale  # h / scale = scale * hessian
    return np.asarray(right.T @ inner @ right)
