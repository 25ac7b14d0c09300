# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Information on logarithms: of a least-squares fit whose residuals are correlated, less what a
theory leaves open and a further unknown takes away.

Such a fit weighs all residuals alike. Its gradient is a sum of errors with the variances of
`dlo_ros.inference.variances`, and the covariance of the parameters follows from that of the
gradient (a sandwich: H^-1 M H^-1 with H = J^T J and M = J^T Sigma J).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlo_ros.inference.priors import DIAMETER_STD
from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.inference.variances import Variances
from dlo_ros.rod_settings import RodParameters, RodSettings
from dlo_ros.spline import FloatArray

STRETCH_STIFFNESS = 2.0
"""Error of ln E by the rod theory, in strains: curvature counts per length of the stretched rod
(the paper's eq. (7)) or of the unstretched one, as most other simulators have it, and a DLO may be
of either kind. Cantilevers of both kinds as boundary value problems differ by 1.1 to 2.5 of the
strain in ln E, swings of a rod of the second kind by 0.7 to 3.7 (root mean squares 1.9 and 2.0)."""
STRETCH_SHAPE = 0.3
"""Difference of the shapes by both kinds of curvature with the best E, in strains and L: that of
the cantilevers is up to 0.2."""


def discrepancy(error: float, settings: RodSettings) -> float:
    """Error of the shape that the model itself may have [m]: discretisation and rod theory.

    Args:
        error: the simulation's own error, over L; NaN where it was not judged.
    """
    rod, simulation = settings.rod, settings.simulation
    own = max(np.nan_to_num(error), simulation.tolerance)
    return float(rod.length * np.hypot(own, STRETCH_SHAPE * strain(settings)))


def model_shift(settings: RodSettings, *, usual: bool = False) -> FloatArray:
    """Possible shift of ln (E, mu, c, t_r): of ln E by rod theory and diameter, shape (4,).

    Shapes determine E D^2 / mu.

    Args:
        usual: see `diameter_error`.
    """
    theory = STRETCH_STIFFNESS * strain(settings)
    thickness = 2.0 * diameter_error(settings.rod, usual=usual)
    return np.array([np.hypot(theory, thickness), 0.0, 0.0, 0.0])


def diameter_error(rod: RodParameters, *, usual: bool = False) -> float:
    """Standard deviation of the diameter over the diameter.

    Args:
        usual: whether a diameter without a stated one has that of `DIAMETER_STD`.
    """
    return rod.diameter_std / rod.diameter or (DIAMETER_STD if usual else 0.0)


def strain(settings: RodSettings) -> float:
    """Stretch of a DLO that hangs from its end."""
    weight = float(np.linalg.norm(settings.gravity))
    return weight * settings.rod.length / settings.rod.specific_modulus


def widened(information: FloatArray, shift: FloatArray) -> FloatArray:
    """Information on numbers that a further unknown shift affects (Sherman and Morrison)."""
    product = information @ shift
    return np.asarray(information - np.outer(product, product) / (1.0 + shift @ product))


def determined_directions(information: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions in which there is information.

    Returns:
        Units in which each number is taken, shape (P,), eigenvalues in these, (K,), and their
        eigenvectors, (P, K).
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    # Derivatives are good to 1e-4 or so: what is smaller is no information.
    kept = values > 1e-9 * max(float(values.max()), 1e-300)
    return scale, values[kept], vectors[:, kept]


@dataclass(frozen=True)
class NormalEquations:
    """J^T J of a least-squares problem, and the covariance of its J^T r.

    Args:
        hessian: J^T J, shape (P, P).
        passing: covariance of J^T r by errors that are new in every picture or die out, (P, P).
        staying: symmetric root of the covariance of J^T r by errors that are the same in all
            pictures, shape (P, P).
    """

    hessian: FloatArray
    passing: FloatArray
    staying: FloatArray

    @classmethod
    def of(cls, bins: Spectrum, variances: Variances) -> NormalEquations:
        """The equations of one recording whose errors have these variances."""
        each = variances.of(bins)[:, None, None] * bins.hessian
        still = bins.frequency == 0.0
        values, vectors = np.linalg.eigh(each[still].sum(axis=0))
        root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return cls(bins.hessian.sum(axis=0), each[~still].sum(axis=0), np.asarray(root))

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

    def information(self, *shifts: FloatArray) -> FloatArray:
        """Information on the P parameters, shape (P, P).

        Args:
            shifts: uncorrected errors of the parameters that are known to be possible, each (P,).
        """
        result = _sandwich(self.hessian, self.covariance)
        for shift in shifts:
            result = widened(result, shift)
        return result


def _sandwich(hessian: FloatArray, covariance: FloatArray) -> FloatArray:
    """H M^-1 H, where flat directions of H stay flat."""
    scale, _, basis = determined_directions(hessian)
    h = hessian * np.outer(scale, scale)
    m = covariance * np.outer(scale, scale)
    inner = np.linalg.pinv(basis.T @ m @ basis, hermitian=True)
    right = basis.T @ h / scale  # h / scale = scale * hessian
    return np.asarray(right.T @ inner @ right)
