# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Expected information of planned manipulations, before they are made.

A planned manipulation is simulated with the sensitivities of every shape; with the errors of the
observer they give the Fisher information on ln (E, mu, c, t_r) and on all numbers of the set-up.
The latter have their tolerances as priors and are integrated out, as in `identify`: where a rope
stands near a snap, small errors of the set-up decide which way it goes, and its shape says nothing
about E. A plan's gain is the reduction of the volume of the posterior of (E, mu), damping being a
nuisance (D-optimality in what is still unknown).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import END, NANOSECONDS, START, Command
from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import (
    logarithms,
    search_information,
    stds,
    with_logarithms,
)
from dlo_ros.identification.force_scale import grip_wrenches
from dlo_ros.identification.information import model_shift
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.inference.joint import field
from dlo_ros.inference.measured import Recording, measured
from dlo_ros.inference.observation_operator import ALONG_STD
from dlo_ros.inference.parallel import Threads
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.spectrum import spectrum
from dlo_ros.inference.thresholds import STEEPEST
from dlo_ros.inference.variances import Variances
from dlo_ros.inference.wrench import expected, wrench_field
from dlo_ros.observation import Observation, Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray, SplineBasis

# E/mu is not known when an experiment is planned: its information is averaged over these factors.
HYPOTHESES = (0.5, 1.0, 2.0)
NOTHING = 1e-30  # [m^2] of a variance: fits see its logarithm
POINTS = 81  # along the DLO, at which displacements are given


@dataclass(frozen=True)
class Noise:
    """The errors of the observer.

    Args:
        std: standard deviation of a measured point across the DLO [m].
        spacing: distance between measured points along the DLO [m].
        common: error that is the same in all pictures of a recording, such as that of the
            calibration; root mean square along the DLO [m].
        along: error of u that is the same all along the DLO in each picture, over L.
    """

    std: float = 3e-4
    spacing: float = 4e-3
    common: float = 1e-4
    along: float = ALONG_STD


@dataclass(frozen=True)
class Plan:
    """A manipulation that might be made.

    Args:
        name: name for the report.
        command: imposed motion, with which the recording starts.
        shape: control points near the equilibrium at the start, shape (n, 4).
        duration: duration of the recording [s].
        rate: frame rate of the camera [Hz].
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
    """The expected result of a plan.

    Args:
        plan: the plan.
        gain: expected information about (E, mu), in bits.
        std: predicted standard deviations of the logarithms of young_modulus, density and
            specific_modulus, what is known beforehand included.
        response: mean displacement for a unit change of ln(E/mu), over L.
        information: expected information on the logarithms of `MATERIAL`, shape (4, 4).
        forecast: forecast of the plan with the given settings.
    """

    plan: Plan
    gain: float
    std: dict[str, float]
    response: float
    information: FloatArray
    forecast: Forecast

    @property
    def reliable(self) -> bool:
        """See `is_reliable`."""
        return is_reliable(self.forecast, self.response)


def information(
    recording: Manipulation, model: ParametricModel, found: Forecast, noise: Noise
) -> FloatArray:
    """Expected information of a recording on ln (E, mu, c, t_r), the set-up integrated out.

    Args:
        recording: planned recording, whose shapes are still to come.
        model: the model with the set-up open within its tolerances.
        found: the model's forecast with derivatives by all of its parameters.
        noise: measurement noise of the observer.

    Returns:
        Shape (4, 4).
    """
    settings = model.settings
    shapes = recorded(recording, found, settings)
    residual, jacobian = field(shapes, found.predicted, found.sensitivity, model.chain())
    bins = spectrum(residual, jacobian, settings.rod.control_points)
    weight = 1.0 / observer_variances(settings, noise, bins.parts).of(bins)
    return model.on_material(np.einsum("b,bpq->pq", weight, bins.hessian))


def recorded(recording: Manipulation, found: Forecast, settings: Settings) -> Recording:
    """A forecast as if it had been observed, without noise."""
    seen = tuple(
        replace(o, control_points=q)
        for o, q in zip(recording.observations, found.predicted, strict=True)
    )
    return measured(replace(recording, observations=seen), settings)


def observer_variances(settings: Settings, noise: Noise, parts: int) -> Variances:
    """Variances of an observer's errors across the DLO, along it and, in space, out of the plane.

    Along the DLO each picture has a smooth error of u, as in `identify`.
    """
    rod = settings.rod
    points = max(rod.length / noise.spacing, 1.0) + 1.0
    white = np.full(parts, noise.std**2 * rod.control_points / points)
    none = np.full(parts, NOTHING)
    common = np.full(parts, noise.common**2 + NOTHING)
    sliding = none.copy()
    sliding[1] += (noise.along * rod.length) ** 2
    return Variances(white, none, sliding, common, none, none, none, none, 0.0, none)


def outlook(
    plan: Plan,
    settings: Settings,
    noise: Noise = Noise(),
    *,
    known: FloatArray | None = None,
    hypotheses: Sequence[float] = HYPOTHESES,
    spans: int | None = None,
) -> Outlook:
    """The expected result of a plan.

    Args:
        plan: the plan.
        settings: settings with the values that are known or guessed beforehand.
        noise: measurement noise of the observer.
        known: information (4, 4) on the logarithms of `MATERIAL`, such as that of recordings that
            have been made; default: what the settings say is known, and weakly the guesses.
        hypotheses: factors of E/mu over which the gain is averaged; 1 is among them.
        spans: knot spans of the simulation; default: as simulation.tolerance asks.

    Raises:
        SimulationError: the manipulation cannot be simulated with the settings as they are.
    """
    before = search_information(settings) if known is None else known
    recording = plan.manipulation()
    loads = settings.wrench.force_std > 0.0
    bare = forecast(recording, settings, spans=spans, loads=loads)
    view = scene(settings, imposed_names([recording]), [bare.predicted[:, :, :3]])
    forces = _force_information(plan, settings, bare)

    def informed_by(factor: float) -> tuple[Forecast, FloatArray] | None:
        theta = logarithms(settings)
        theta[0] += math.log(factor)
        here = with_logarithms(settings, theta)
        model = joint_model(here, here, view)
        try:
            found = forecast(recording, model.settings, parameters=model.names, spans=spans)
            return found, information(recording, model, found, noise) + forces
        except SimulationError:
            return None

    each = Threads().map(informed_by, list(hypotheses))
    gains = [0.0 if found is None else _gain(before, found[1]) for found in each]
    nominal = each[list(hypotheses).index(1.0)]
    if nominal is None:
        raise SimulationError(f"{plan.name}: the manipulation cannot be simulated")
    found, expected_data = nominal
    shift = model_shift(settings, usual=True)
    std = stds(np.linalg.inv(before + expected_data) + np.outer(shift, shift))
    response = mean_response(found, settings)
    return Outlook(plan, float(np.mean(gains)), std, response, expected_data, found)


def _force_information(plan: Plan, settings: Settings, found: Forecast) -> FloatArray:
    """Information (4, 4) on mu from a force sensor of known noise at one grip, where E/mu is known.

    The sensor is at the start, or at the end where the start is free, and sends one message with
    every picture.

    Args:
        found: forecast of the plan, with loads where there is a sensor.
    """
    result = np.zeros((len(MATERIAL), len(MATERIAL)))
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
            result[1, 1] = float(expected(field)[0, 0])
        return result
    return result


def displacement(found: Forecast, settings: Settings) -> FloatArray:
    """Displacement of the DLO for a unit change of ln(E/mu), shape (F, U) [m].

    The U (`POINTS`) points are spread evenly along it.

    Args:
        found: forecast with sensitivities, to young_modulus first.
    """
    assert found.sensitivity is not None
    n, length = settings.rod.control_points, settings.rod.length
    curve = SplineBasis(n, length).matrix(np.linspace(0.0, length, POINTS))
    curve = curve @ found.sensitivity[:, 0]
    return np.asarray(np.linalg.norm(curve, axis=2))


def mean_response(found: Forecast, settings: Settings) -> float:
    """Mean displacement for a unit change of ln(E/mu), over L."""
    return float(displacement(found, settings).mean()) / settings.rod.length


def is_reliable(found: Forecast, response: float) -> bool:
    """Whether a manipulation stays away from a snap-through.

    Args:
        found: forecast of the manipulation.
        response: see `mean_response`.
    """
    return found.stable and response < STEEPEST


def _gain(before: FloatArray, gained: FloatArray) -> float:
    """Expected information about (E, mu) in bits, the other parameters being unknown."""
    first, then = (np.linalg.inv(m)[:2, :2] for m in (before, before + gained))
    return float(np.linalg.slogdet(first)[1] - np.linalg.slogdet(then)[1]) / (2.0 * math.log(2.0))


def at_equilibrium(settings: Settings) -> Settings:
    """The settings for a plan, which starts at rest."""
    return replace(settings, simulation=replace(settings.simulation, start="equilibrium"))
