"""Which manipulation would tell most, before it is made.

A planned manipulation is simulated with the sensitivities of every shape; with the observer's
noise they give the Fisher information on ln (E, mu, c, t_r). Its gain is how much the volume of
what is possible for (E, mu) shrinks by it, damping being a nuisance (D-optimality in what is still
unknown). Two models are told apart by what no choice of (E, mu, c, t_r) can make up for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import (
    COMBINATIONS,
    logarithms,
    search_information,
    with_logarithms,
)
from dlo_ros.identification.forecast import Forecast, Manipulation, forecast
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.tangents import MATERIAL
from dlo_ros.spline import FloatArray

# E/mu is not known when an experiment is planned: what it tells is averaged over these factors.
HYPOTHESES = (0.5, 1.0, 2.0)
UNKNOWN_RATIO = np.array([[1.0, 0.0], [0.0, 1.0]])


@dataclass(frozen=True)
class Noise:
    """How well the observer measures.

    Args:
        std: of a measured point across the DLO [m].
        spacing: distance between measured points along the DLO [m].
        common: error that is the same in all pictures of a recording, such as that of the
            calibration; root mean square along the DLO [m].
    """

    std: float = 3e-4
    spacing: float = 4e-3
    common: float = 1e-4


@dataclass(frozen=True)
class Plan:
    """A manipulation that might be made.

    Args:
        name: for people.
        command: what would be imposed; the recording starts with it.
        shape: near the equilibrium that it starts from, control points (n, 4).
        duration: of the recording [s].
        rate: of the camera [Hz].
    """

    name: str
    command: Command
    shape: FloatArray
    duration: float
    rate: float = 30.0

    def manipulation(self) -> Manipulation:
        """The plan as a recording of which only the stamps and the first shape count."""
        count = int(np.floor(self.duration * self.rate + 1e-6)) + 1
        stamps = [self.command.stamp + round(k / self.rate * NANOSECONDS) for k in range(count)]
        return Manipulation(
            self.name, (self.command,), tuple(Observation(s, self.shape) for s in stamps)
        )


@dataclass(frozen=True)
class Outlook:
    """What a plan would tell.

    Args:
        plan: the plan.
        gain: how much it would tell about (E, mu), in bits.
        std: predicted standard deviations of the logarithms of young_modulus, density and
            specific_modulus, what is known beforehand included.
        response: mean displacement for a unit change of ln(E/mu), over L.
        information: on the logarithms of `MATERIAL`, shape (4, 4).
        forecast: with the settings as they are.
    """

    plan: Plan
    gain: float
    std: dict[str, float]
    response: float
    information: FloatArray
    forecast: Forecast


def information(found: Forecast, settings: Settings, noise: Noise) -> FloatArray:
    """Information (4, 4) of a recording with white noise and an error common to its pictures.

    Args:
        found: with derivatives by `MATERIAL`.
        settings: of the rod, for the number of measured points.
        noise: of the observer.
    """
    j = _derivative(found)
    return np.asarray(_weighted(j, j, settings, noise))


def _derivative(found: Forecast) -> FloatArray:
    """Derivatives as columns for each picture, shape (F, 3n, P)."""
    assert found.derivative is not None
    frames, parameters = found.derivative.shape[:2]
    return found.derivative.reshape(frames, parameters, -1).transpose(0, 2, 1)


def _weighted(a: FloatArray, b: FloatArray, settings: Settings, noise: Noise) -> FloatArray:
    """A^T Sigma^-1 B for the noise's covariance Sigma; a, b of shape (F, 3n, P or Q)."""
    points = max(settings.rod.length / noise.spacing, 1.0) + 1.0
    white = noise.std**2 / points
    common = noise.common**2 / settings.rod.control_points
    # All pictures share one error: it is eliminated (Woodbury).
    shared = 1.0 / (len(a) / white + 1.0 / common) if common > 0.0 else 0.0
    single = np.einsum("fip,fiq->pq", a, b) / white
    return np.asarray(single - shared / white**2 * (a.sum(axis=0).T @ b.sum(axis=0)))


def outlook(
    plan: Plan,
    settings: Settings,
    noise: Noise = Noise(),
    *,
    known: FloatArray | None = None,
    hypotheses: Sequence[float] = HYPOTHESES,
    spans: int | None = None,
) -> Outlook:
    """What a plan would tell.

    Args:
        plan: the plan.
        settings: what is known and guessed beforehand.
        noise: of the observer.
        known: information (4, 4) on the logarithms of `MATERIAL`, such as that of recordings that
            have been made; default: what the settings say is known, and weakly the guesses.
        hypotheses: factors of E/mu over which the gain is averaged.
        spans: knot spans of the simulation; default: as simulation.tolerance asks.

    Raises:
        SimulationError: the manipulation cannot be simulated with the settings as they are.
    """
    before = search_information(settings) if known is None else known
    recording = plan.manipulation()
    here = forecast(recording, settings, parameters=MATERIAL, spans=spans)
    gains = []
    for factor in hypotheses:
        found = here
        if factor != 1.0:
            theta = logarithms(settings)
            theta[0] += math.log(factor)
            try:
                found = forecast(
                    recording, with_logarithms(settings, theta), parameters=MATERIAL, spans=spans
                )
            except SimulationError:
                gains.append(0.0)
                continue
        gains.append(_gain(before, information(found, settings, noise)))
    told = information(here, settings, noise)
    covariance = np.linalg.inv(before + told)
    std = {k: math.sqrt(float(c @ covariance @ c)) for k, c in COMBINATIONS.items()}
    j = _derivative(here)
    shift = np.sqrt((j[:, :, 0] ** 2).sum(axis=1))  # root mean square along u
    return Outlook(
        plan, float(np.mean(gains)), std, float(shift.mean()) / settings.rod.length, told, here
    )


def _gain(before: FloatArray, told: FloatArray) -> float:
    """Bits told about (E, mu), the other parameters being unknown."""
    first, then = (np.linalg.inv(m)[:2, :2] for m in (before, before + told))
    return float(np.linalg.slogdet(first)[1] - np.linalg.slogdet(then)[1]) / (2.0 * math.log(2.0))


def rank(
    plans: Sequence[Plan],
    settings: Settings,
    noise: Noise = Noise(),
    *,
    known: FloatArray | None = None,
) -> list[Outlook]:
    """Plans by what they would tell, the best first; see `outlook`.

    Raises:
        SimulationError: a plan cannot be simulated; the message names it.
    """
    found = [outlook(plan, settings, noise, known=known) for plan in plans]
    return sorted(found, key=lambda o: -o.gain)


@dataclass(frozen=True)
class Separation:
    """How well a plan would tell two models apart.

    Args:
        plan: the plan.
        sigmas: distance between the shapes that they predict, in standard deviations, after the
            second has been fitted to the first as well as (E, mu, c, t_r) allow.
        distance: mean distance of the shapes before that [m].
    """

    plan: Plan
    sigmas: float
    distance: float


def separation(
    plan: Plan,
    first: Settings,
    second: Settings,
    noise: Noise = Noise(),
) -> Separation:
    """How well a plan would tell two models apart, such as two with different effects.

    Raises:
        SimulationError: one of them cannot be simulated.
    """
    recording = plan.manipulation()
    a = forecast(recording, first)
    b = forecast(recording, second, parameters=MATERIAL)
    gap = _whitened_gap(a, b, second)
    j = _derivative(b)
    across = gap[:, :, None]
    total = float(_weighted(across, across, second, noise)[0, 0])
    pull = _weighted(j, across, second, noise)[:, 0]
    free = _weighted(j, j, second, noise) + search_information(second)
    left = total - float(pull @ np.linalg.solve(free, pull))
    distance = float(np.sqrt((gap**2).sum(axis=1)).mean())
    return Separation(plan, math.sqrt(max(left, 0.0)), distance)


def _whitened_gap(a: Forecast, b: Forecast, settings: Settings) -> FloatArray:
    # The residuals have the same (made up) shapes in common.
    frames = min(len(a.residual), len(b.residual))
    return np.asarray((b.residual[:frames] - a.residual[:frames]).reshape(frames, -1))


def rank_separation(
    plans: Sequence[Plan],
    first: Settings,
    second: Settings,
    noise: Noise = Noise(),
) -> list[Separation]:
    """Plans by how well they tell two models apart, the best first; see `separation`.

    Plans that one of the models cannot follow are left out.
    """
    found = []
    for plan in plans:
        try:
            found.append(separation(plan, first, second, noise))
        except SimulationError:
            continue
    return sorted(found, key=lambda s: -s.sigmas)


def at_equilibrium(settings: Settings) -> Settings:
    """The settings for a plan, which starts at rest."""
    return replace(settings, simulation=replace(settings.simulation, start="equilibrium"))
