# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
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

from dlo_ros.command import END, NANOSECONDS, START, Command
from dlo_ros.effects.physics.gravity_tilt import GravityTilt
from dlo_ros.effects.physics.intrinsic_curvature import IntrinsicCurvature
from dlo_ros.errors import SimulationError
from dlo_ros.identification.batched_forecast import forecast_each, forecast_varied
from dlo_ros.identification.estimate import (
    COMBINATIONS,
    logarithms,
    search_information,
    with_logarithms,
)
from dlo_ros.identification.force_scale import grip_wrenches
from dlo_ros.identification.residual_information import STRETCH_STIFFNESS, strain
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast, whitening
from dlo_ros.inference.wrench import expected, wrench_field
from dlo_ros.observation import Observation, Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray, SplineBasis

# E/mu is not known when an experiment is planned: what it tells is averaged over these factors.
HYPOTHESES = (0.5, 1.0, 2.0)
REFITS = 6  # rounds in which the second model is fitted to the first
POINTS = 81  # along the DLO, where displacements are told
# Of the logarithms of E, c and t_r, to either side; what mu does follows from E and c.
DIFFERENCES = ((0, 0.02), (2, 0.1), (3, 0.1))


@dataclass(frozen=True)
class Noise:
    """How well the observer measures.

    Args:
        std: of a measured point across the DLO [m].
        spacing: distance between measured points along the DLO [m].
        common: error that is the same in all pictures of a recording, such as that of the
            calibration; root mean square along the DLO [m].
        tilt: standard deviation of the board's and the clamps' angles [rad].
        bend: standard deviation of the angle by which the DLO is curved at rest, from its start to
            its end [rad].
    """

    std: float = 3e-4
    spacing: float = 4e-3
    common: float = 1e-4
    tilt: float = 5e-3
    bend: float = 0.03


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


def information(derivative: FloatArray, settings: Settings, noise: Noise) -> FloatArray:
    """Information of a recording with white noise, a common error and small imperfections.

    Args:
        derivative: of the shapes with respect to P parameters and then to the imperfections that
            `imperfect` makes, in the coefficients of `Forecast`, shape (F, P + 2, n, 3).
        settings: of the rod.
        noise: of the observer.

    Returns:
        Shape (P, P).
    """
    j = _columns(derivative)
    full = _weighted(j, j, settings, noise)
    full[-2:, -2:] += np.eye(2)  # imperfections are in units of their standard deviation
    kept = full[:-2, :-2] - full[:-2, -2:] @ np.linalg.solve(full[-2:, -2:], full[-2:, :-2])
    return np.asarray(kept)


def _columns(derivative: FloatArray) -> FloatArray:
    """Derivatives as columns for each picture, shape (F, 3n, P)."""
    frames, parameters = derivative.shape[:2]
    return derivative.reshape(frames, parameters, -1).transpose(0, 2, 1)


def imperfect(settings: Settings, noise: Noise) -> list[Settings]:
    """The rod with gravity tilted and with a curvature at rest, to either side of what it is.

    Where a rope stands near a snap such trifles decide, and it tells nothing about E.
    """
    result = []
    for name, key, size in (
        (GravityTilt.name, "angle", noise.tilt),
        (IntrinsicCurvature.name, "curvature", noise.bend / settings.rod.length),
    ):
        for side in (1.0, -1.0):
            effects = {k: dict(v) for k, v in settings.effects.items()}
            values = effects.setdefault(name, {})
            values[key] = float(np.mean(values.get(key, 0.0))) + side * size
            result.append(settings.with_effects(effects))
    return result


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
        hypotheses: factors of E/mu over which the gain is averaged; 1 is among them.
        spans: knot spans of the simulation; default: as simulation.tolerance asks.

    Raises:
        SimulationError: the manipulation cannot be simulated with the settings as they are.
    """
    before = search_information(settings) if known is None else known
    recording = plan.manipulation()
    sets: list[Settings] = []
    places: list[int] = []
    for factor in hypotheses:
        theta = logarithms(settings)
        theta[0] += math.log(factor)
        places.append(len(sets))
        sets += _around(with_logarithms(settings, theta), noise)
    found = forecast_each(recording, sets, spans=spans)
    forces = _felt(plan, settings, spans)
    gains, nominal, told = [], None, np.zeros((4, 4))
    for factor, at in zip(hypotheses, places, strict=True):
        group = [f for f in found[at : at + len(sets) // len(places)] if f is not None]
        if len(group) < len(sets) // len(places):
            gains.append(0.0)
            continue
        derivative = _differences(group)
        here = information(derivative, settings, noise) + forces
        gains.append(_gain(before, here))
        if factor == 1.0:
            nominal, told = replace(group[0], derivative=derivative[:, : len(MATERIAL)]), here
    if nominal is None:
        raise SimulationError(f"{plan.name}: the manipulation cannot be simulated")
    covariance = np.linalg.inv(before + told)
    std = {k: math.sqrt(max(float(c @ covariance @ c), 0.0)) for k, c in COMBINATIONS.items()}
    # Rod theories differ by that much (see `residual_information`).
    theory = STRETCH_STIFFNESS * strain(settings)
    for name in ("young_modulus", "specific_modulus"):
        std[name] = math.hypot(std[name], theory)
    shift = displacement(nominal, settings)
    response = float(shift.mean()) / settings.rod.length
    return Outlook(plan, float(np.mean(gains)), std, response, told, nominal)


def _felt(plan: Plan, settings: Settings, spans: int | None) -> FloatArray:
    """What a sensor of known noise at one grip would tell, (4, 4): of mu, where E/mu is known.

    It is that at the start, or at the end where the start is free. With every picture one message.
    """
    told = np.zeros((len(MATERIAL), len(MATERIAL)))
    if not settings.wrench.force_std > 0.0:
        return told
    recording = plan.manipulation()
    try:
        found = forecast(recording, settings, spans=spans, loads=True)
    except SimulationError:
        return told
    for end in (START, END):
        predicted = grip_wrenches(found.loadings, end)
        if predicted is None:
            continue
        stamps = np.array([int(s) for s in found.stamps])
        measured = Wrenches.along_axes(end, stamps, predicted)
        field = wrench_field(
            plan.name, measured, [int(s) for s in stamps], predicted, predicted[:, :, None],
            settings, [plan.command],
        )  # fmt: skip
        if field is not None:
            told[1, 1] = float(expected(field)[0, 0])
        return told
    return told


def _around(settings: Settings, noise: Noise) -> list[Settings]:
    """The settings, and to either side of them what derivatives are taken from."""
    theta = logarithms(settings)
    sets = [settings]
    for k, step in DIFFERENCES:
        for side in (1.0, -1.0):
            moved = theta.copy()
            moved[k] += side * step
            sets.append(with_logarithms(settings, moved))
    return sets + imperfect(settings, noise)


def _differences(group: Sequence[Forecast]) -> FloatArray:
    """Derivatives by `MATERIAL` and by both imperfections from the forecasts of `_around`."""
    here, *sides = group
    count = len(MATERIAL)
    result = np.zeros((len(here.stamps), count + 2, *here.residual.shape[1:]))
    for i, (k, step) in enumerate(DIFFERENCES):
        result[:, k] = (sides[2 * i + 1].residual - sides[2 * i].residual) / (2.0 * step)
    result[:, 1] = -result[:, 0] - result[:, 2]
    for i in range(2):
        above, below = sides[2 * len(DIFFERENCES) + 2 * i : 2 * len(DIFFERENCES) + 2 * i + 2]
        result[:, count + i] = (below.residual - above.residual) / 2.0
    return result


def displacement(found: Forecast, settings: Settings) -> FloatArray:
    """By how much a unit change of ln(E/mu) displaces the DLO, shape (F, U) [m].

    U points are spread evenly along it; `POINTS` of them.
    """
    assert found.derivative is not None
    n, length = settings.rod.control_points, settings.rod.length
    change = np.linalg.solve(whitening(n, length), found.derivative[:, 0])
    curve = SplineBasis(n, length).matrix(np.linspace(0.0, length, POINTS)) @ change
    return np.asarray(np.linalg.norm(curve, axis=2))


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
class ModelSeparation:
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
) -> ModelSeparation:
    """How well a plan would tell two models apart, such as two with different effects.

    Raises:
        SimulationError: one of them cannot be simulated.
    """
    recording = plan.manipulation()
    a = forecast(recording, first)
    guess = logarithms(second)
    theta, best, distance = guess.copy(), np.inf, 0.0
    prior = search_information(second)
    for iteration in range(REFITS):
        b = forecast_varied(recording, with_logarithms(second, theta))
        assert b.derivative is not None
        j, gap = _columns(b.derivative), _whitened_gap(a, b)
        if iteration == 0:
            distance = float(np.sqrt((gap**2).sum(axis=1)).mean())
        across = gap[:, :, None]
        off = np.where(np.isfinite(guess), theta - guess, 0.0)
        total = float(_weighted(across, across, second, noise)[0, 0] + off @ prior @ off)
        best = min(best, total)
        pull = _weighted(j, across, second, noise)[:, 0] - prior @ off
        step = np.linalg.solve(_weighted(j, j, second, noise) + prior, pull)
        if float(pull @ step) < 0.1 * best or iteration == REFITS - 1:
            best = min(best, total - float(pull @ step)) if iteration else best
            break
        theta = theta + np.clip(step, -1.0, 1.0)
    return ModelSeparation(plan, math.sqrt(max(best, 0.0)), distance)


def _whitened_gap(a: Forecast, b: Forecast) -> FloatArray:
    # The residuals have the same (made up) shapes in common.
    frames = min(len(a.residual), len(b.residual))
    return np.asarray((b.residual[:frames] - a.residual[:frames]).reshape(frames, -1))


def rank_separation(
    plans: Sequence[Plan],
    first: Settings,
    second: Settings,
    noise: Noise = Noise(),
) -> list[ModelSeparation]:
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
