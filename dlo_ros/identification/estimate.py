# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Estimates of (E, mu): values, standard deviations, and what the data determine."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from dlo_ros.inference.parameter import value_of, with_values
from dlo_ros.inference.priors import MATERIAL_RANGES
from dlo_ros.inference.thresholds import IDENTIFIED, SMALL_SHARE, UNBOUNDED
from dlo_ros.parameter_table import TABLE
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

# A guess guides the search and is no knowledge: standard deviations of the logarithms, wider than
# those of `dlo_ros.inference.priors`, with which a set-up is compared by evidence.
SEARCH_STD = {"young_modulus": 4.0, "density": 0.3, "air_drag": 3.0, "relaxation_time": 2.0}
NOISE_SHARE = 0.1  # of the noise, or a residual, that the simulation's own error may be
FINEST = 1e-5  # of the length: no finer simulation is asked for
OPEN = 1e3  # standard deviation of a logarithm of which nothing at all is known
RIDGE = 1e-8  # keeps flat directions finite: standard deviation 1e4 of a logarithm
COMBINATIONS = {
    "specific_modulus": np.array([1.0, -1.0, 0.0, 0.0]),
    "young_modulus": np.array([1.0, 0.0, 0.0, 0.0]),
    "density": np.array([0.0, 1.0, 0.0, 0.0]),
    "specific_drag": np.array([0.0, -1.0, 1.0, 0.0]),
    "air_drag": np.array([0.0, 0.0, 1.0, 0.0]),
    "relaxation_time": np.array([0.0, 0.0, 0.0, 1.0]),
}
"""Combinations of the logarithms of `MATERIAL` that are spoken of."""
ESTIMATED = ("young_modulus", "density", "specific_modulus")


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters.

    Args:
        settings: the parameter file with the estimated E, mu and, where fitted, damping.
        young_modulus, density, specific_modulus: Pa, kg/m^3, m^2/s^2.
        young_modulus_std, density_std, specific_modulus_std: None where unbounded.
        identifiable: whether the recordings together with known forces determine a parameter, by
            its name, leaving density_std aside.
        covariance: covariance of the logarithms of `MATERIAL`, known prior information included,
            shape (4, 4).
        significant: whether it differs enough from what was last reported as significant to be
            passed on to a running simulation (online only).
        delay: time by which the DLO moves later than commanded, and its std [s]; None: not known
            (online only).
    """

    settings: Settings
    young_modulus: float
    density: float
    specific_modulus: float
    young_modulus_std: float | None
    density_std: float | None
    specific_modulus_std: float | None
    identifiable: dict[str, bool]
    covariance: FloatArray
    significant: bool = False
    delay: tuple[float, float] | None = None

    @property
    def traded(self) -> tuple[tuple[str, str], ...]:
        """Pairs of parameters of which the data determine a combination far better than each."""
        variance = dict(zip(MATERIAL, np.diag(self.covariance), strict=True))
        pairs = correlations(self.covariance).items()
        return tuple(
            (a, b)
            for (a, b), value in pairs
            if abs(value) > 1.0 - SMALL_SHARE and max(variance[a], variance[b]) < OPEN**2
        )


def searchable(settings: Settings) -> Settings:
    """The settings with a positive damping where the file guesses zero.

    A search for the logarithm could never leave zero, and the effect of the missing damping would
    be attributed to E/mu. Known dampings (std above zero) stay as they are.
    """
    flat = settings.flat()
    for name in ("damping.air_drag", "damping.relaxation_time"):
        if flat[name] == 0.0 and flat[f"{name}_std"] == 0.0:
            default = TABLE[name].default
            assert default is not None
            flat[name] = default
            LOG.warning("%s is guessed to be 0; the search starts from %g instead", name, default)
    return Settings.from_mapping(flat)


def logarithms(settings: Settings) -> FloatArray:
    """Logarithms of (E, mu, c, t_r), shape (4,); a damping of zero gives -inf."""
    values = [value_of(settings, name) for name in MATERIAL]
    return np.array([math.log(v) if v > 0.0 else -math.inf for v in values])


def with_logarithms(settings: Settings, theta: FloatArray) -> Settings:
    """The settings with ln (E, mu, c, t_r) = theta."""
    values = {}
    for name, value in zip(MATERIAL, np.exp(theta).tolist(), strict=True):
        *_, lower, upper = MATERIAL_RANGES[name]
        values[name] = min(max(value, lower), upper) if value else 0.0
    return with_values(settings, values)


def within_noise(settings: Settings, rms: float) -> Settings:
    """Settings whose simulation error is a small part of a residual.

    Args:
        rms: root mean square distance between observed and predicted shapes [m].
    """
    simulation = settings.simulation
    wanted = max(NOISE_SHARE * rms / settings.rod.length, FINEST)
    tolerance = min(simulation.tolerance, wanted)
    return replace(settings, simulation=replace(simulation, tolerance=tolerance))


def _stated(settings: Settings) -> dict[str, float]:
    """Standard deviations that a parameter file states, over their values."""
    rod, damping = settings.rod, settings.damping
    pairs = {
        "specific_modulus": (rod.specific_modulus, rod.specific_modulus_std),
        "density": (rod.density, rod.density_std),
        "air_drag": (damping.air_drag, damping.air_drag_std),
        "relaxation_time": (damping.relaxation_time, damping.relaxation_time_std),
    }
    return {name: std / value for name, (value, std) in pairs.items() if std > 0.0 and value > 0.0}


def known_information(settings: Settings, *, weighed: bool) -> FloatArray:
    """Prior information (4, 4) on the logarithms.

    Args:
        weighed: whether density_std counts; `identifiable` leaves it aside.
    """
    known = _stated(settings)
    if not weighed:
        known.pop("density", None)
    return np.diag([known.get(name, np.inf) ** -2.0 for name in MATERIAL])


def stated_covariance(settings: Settings) -> FloatArray | None:
    """Covariance (4, 4) of the logarithms from the standard deviations that a file states.

    E/mu is known by itself, so an error of the density, at that E/mu, is one of E, too.

    Returns:
        None where the file states none.
    """
    directions = {
        "specific_modulus": np.array([1.0, 0.0, 0.0, 0.0]),
        "density": np.array([1.0, 1.0, 0.0, 0.0]),
        "air_drag": np.array([0.0, 0.0, 1.0, 0.0]),
        "relaxation_time": np.array([0.0, 0.0, 0.0, 1.0]),
    }
    rows = np.array([std * directions[name] for name, std in _stated(settings).items()])
    return rows.T @ rows if len(rows) else None


def estimate_covariance(settings: Settings, information: FloatArray) -> FloatArray:
    """Covariance (4, 4) of the logarithms after recordings, guesses included.

    Args:
        information: information from the recordings, shape (4, 4), as in estimate.json.
    """
    return inverse(information + search_information(settings))


def search_information(settings: Settings) -> FloatArray:
    """Information (4, 4) that guides the search: the prior, and weakly the guesses."""
    known = np.diag(known_information(settings, weighed=True))
    guess = np.array([SEARCH_STD[name] ** -2 for name in MATERIAL])
    # A parameter of value zero has no logarithm; it stays what it is.
    absent = ~np.isfinite(logarithms(settings))
    return np.diag(np.where(absent, 1e12, np.where(known > 0.0, known, guess)))


def summarise(initial: Settings, theta: FloatArray, data_information: FloatArray) -> Estimate:
    """Turn a fit into an estimate with standard deviations and identifiability.

    Args:
        initial: the settings before the fit, whose std fields are the prior knowledge.
        theta: estimated ln (E, mu, c, t_r).
        data_information: information of the data alone, correlation accounted for, shape (4, 4).
    """
    covariance = inverse(data_information + known_information(initial, weighed=True))
    unweighed = inverse(data_information + known_information(initial, weighed=False))
    settings = with_logarithms(initial, theta)
    rod = settings.rod
    values = (rod.young_modulus, rod.density, rod.specific_modulus)
    relative = [bounded(std) for std in stds(covariance).values()]
    young_modulus, density, ratio = (
        None if std is None else value * std for value, std in zip(values, relative, strict=True)
    )
    known = {name: std < IDENTIFIED for name, std in stds(unweighed).items()}
    return Estimate(settings, *values, young_modulus, density, ratio, known, covariance)


def std_along(covariance: FloatArray, direction: FloatArray) -> float:
    """Standard deviation of a combination (4,) of logarithms with a covariance (4, 4)."""
    return math.sqrt(max(float(direction @ covariance @ direction), 0.0))


def stds(covariance: FloatArray) -> dict[str, float]:
    """Standard deviations of the logarithms of what is `ESTIMATED`."""
    return {name: std_along(covariance, COMBINATIONS[name]) for name in ESTIMATED}


def bounded(std: float) -> float | None:
    """The standard deviation of a logarithm; None where that leaves it unknown."""
    return std if std < UNBOUNDED else None


def inverse(information: FloatArray) -> FloatArray:
    """Inverse of an information matrix that may have flat directions."""
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    # Rounding must not pretend to know a flat direction.
    floor = max(RIDGE, 1e-13 * float(values.max()))
    return np.asarray(vectors / np.maximum(values, floor) @ vectors.T)


def correlations(covariance: FloatArray) -> dict[tuple[str, str], float]:
    """Correlation of each pair of `MATERIAL`'s logarithms, from their covariance (4, 4)."""
    std = np.sqrt(np.diag(covariance))
    pairs = combinations(range(len(MATERIAL)), 2)
    return {(MATERIAL[i], MATERIAL[j]): float(covariance[i, j] / std[i] / std[j]) for i, j in pairs}
