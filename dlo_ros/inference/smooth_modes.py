# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Principal modes of a smooth function along the DLO, such as an error of the measurement."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dlo_ros.spline import FloatArray, SplineBasis

REACH = 0.2
"""Correlation length of errors along the DLO, over L: calibration, shading, the place of a free end
and what a model lacks vary no faster."""


@lru_cache(maxsize=32)
def whitening(control_points: int, length: float) -> FloatArray:
    """Symmetric square root of the Gram matrix over L, shape (n, n)."""
    values, vectors = np.linalg.eigh(SplineBasis(control_points, length).gram / length)
    return np.asarray(vectors * np.sqrt(values) @ vectors.T)


@lru_cache(maxsize=32)
def modes(control_points: int) -> tuple[FloatArray, FloatArray]:
    """Principal modes of a smooth function along the DLO, smoothest first.

    Its covariance is a squared exponential (Rasmussen and Williams, Gaussian processes for machine
    learning, 2006, eq. (4.9)).

    Returns:
        Modes as columns over whitened coefficients, shape (n, n), and their shares of the mean
        square, shape (n,), which sum to 1.
    """
    basis = SplineBasis(control_points, 1.0)
    u, weight = basis.quadrature()
    project = np.linalg.inv(whitening(control_points, 1.0)) @ (basis.matrix(u) * weight[:, None]).T
    apart = np.subtract.outer(u, u) / REACH
    values, vectors = np.linalg.eigh(project @ np.exp(-0.5 * apart**2) @ project.T)
    shares = np.maximum(values[::-1], 0.0)
    return vectors[:, ::-1], shares / shares.sum()


@lru_cache(maxsize=32)
def smooth_functions(control_points: int) -> FloatArray:
    """Control points of functions whose products sum to the covariance of a smooth one, (n, n)."""
    vectors, shares = modes(control_points)
    return np.asarray(np.linalg.solve(whitening(control_points, 1.0), vectors * np.sqrt(shares)))
