# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Posterior covariance that knows how much recordings disagree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.inference.spectrum import Spectrum
from dlo_ros.inference.variances import Variances, posterior
from dlo_ros.spline import FloatArray

LEAST_OTHERS = 0.02
"""Smallest share of the information on a number by which other recordings than one count."""


def widened_covariance(
    spectra: Sequence[Spectrum], variances: Sequence[Variances], offset: FloatArray,
    precision: FloatArray,
) -> FloatArray:  # fmt: skip
    """Posterior covariance that also holds how much recordings disagree, shape (P, P).

    A model whose laws are not the true ones fits each recording with other numbers. The spread of
    the recordings' gradients tells of it, corrected for what each recording determines by itself
    (Bell and McCaffrey, Bias reduction in standard errors for linear regression with multi-stage
    samples, 2002); each standard deviation is at least that. Nothing is simulated for it.

    Args:
        offset, precision: prior means minus the point of linearisation, and inverse prior
            variances, see `posterior`.
    """
    found = posterior(spectra, variances, offset, precision)
    if len(spectra) < 2:
        return found.covariance
    root = np.linalg.cholesky(found.covariance)
    between = np.zeros_like(found.covariance)
    for s, v in zip(spectra, variances, strict=True):
        each = 1.0 / v.of(s)
        hessian = np.einsum("b,bpq->pq", each, s.hessian)
        pull = root.T @ (each @ s.gradient - hessian @ found.step)
        share, axes = np.linalg.eigh(root.T @ hessian @ root)
        moved = root @ (axes @ ((axes.T @ pull) / np.sqrt(np.maximum(1.0 - share, LEAST_OTHERS))))
        between += np.outer(moved, moved)
    known = np.diag(found.covariance)
    wider = np.sqrt(np.maximum(np.diag(between), known) / known)
    return np.asarray(found.covariance * np.outer(wider, wider))
