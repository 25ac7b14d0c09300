# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Information on logarithms: what a theory leaves open, and what a further unknown takes away."""

from __future__ import annotations

import numpy as np

from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray

STRETCH_STIFFNESS = 2.0
"""Error of ln E by the rod theory, in strains: curvature counts per length of the stretched rod
(the paper's eq. (7)) or of the unstretched one, as most other simulators have it, and a DLO may be
of either kind. Cantilevers of both kinds as boundary value problems differ by 1.1 to 2.5 of the
strain in ln E, swings of a rod of the second kind by 0.7 to 3.7 (root mean squares 1.9 and 2.0)."""


def model_shifts(settings: RodSettings, count: int) -> list[FloatArray]:
    """Possible shifts of ln E, of `count` logarithms: by the rod theory, and by the diameter.

    Shapes determine E D^2 / mu.
    """
    rod = settings.rod
    first = np.eye(count)[0]
    return [
        STRETCH_STIFFNESS * strain(settings) * first,
        2.0 * rod.diameter_std / rod.diameter * first,
    ]


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
