# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forecast a recording with a model, and compare: residuals and their derivatives."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.inference.err import shape_errors
from dlo_ros.inference.lost_time import Gap
from dlo_ros.inference.observation_operator import noise_unit, operator_of
from dlo_ros.inference.parameter import of_recording
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.observation import Observation, Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.protocol import RodSimulation, instability
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Manipulation:
    """A measured manipulation: what was imposed and what was seen.

    Args:
        name: name for messages and reports.
        commands: commands in the order of receipt.
        observations: observations by growing stamp, at least one.
        wrenches: measured forces and torques of the grips, for each end that has them.
        start: value of simulation.start for this recording; None: that of the settings.
        gaps: where it lost time, which has been put back, see `lost_pictures`.
    """

    name: str
    commands: tuple[Command, ...]
    observations: tuple[Observation, ...]
    wrenches: tuple[Wrenches, ...] = ()
    start: str | None = None
    gaps: tuple[Gap, ...] = ()


@dataclass(frozen=True)
class Window(Manipulation):
    """The present part of a manipulation that goes on.

    Args:
        noise_unit: see `observation_operator.noise_unit`, which stays while observations come;
            None: there are no measured points yet.
    """

    noise_unit: float | None = None


def unit_of(manipulation: Manipulation) -> float | None:
    """The unit of a window's residuals; None: that of the observations that are compared."""
    return manipulation.noise_unit if isinstance(manipulation, Window) else None


@dataclass(frozen=True)
class Forecast:
    """Predicted shapes beside the observed ones.

    Args:
        stamps: [ns], shape (F,), of the observations that the model could be compared with.
        predicted: control points, shape (F, n, 4).
        residual: observed minus predicted in coefficients of which the squares sum to the mean
            squared distance along u, and of which white noise along the DLO makes white numbers;
            shape (F, n, 3) [m]. Of pictures with measured points: see `observation_operator`.
        derivative: derivative of the prediction in these coefficients with respect to the
            logarithms of the P parameters, shape (F, P, n, 3); None where not requested.
        sensitivity: derivative of the predicted control points themselves, shape (F, P, n, 3) [m];
            None where not requested.
        err: eq. (10), shape (F,) [m].
        spans: knot spans of the simulation.
        resolution_error: the simulation's own error, over L; NaN where it was not judged.
        stable: whether the equilibrium that it starts from is stable.
        loadings: loads on the DLO and its grips, F of them; none where they were not requested.
    """

    stamps: np.ndarray
    predicted: FloatArray
    residual: FloatArray
    derivative: FloatArray | None
    err: FloatArray
    spans: int
    resolution_error: float
    stable: bool = True
    loadings: tuple[Loading, ...] = ()
    sensitivity: FloatArray | None = None


def forecast(
    manipulation: Manipulation,
    settings: Settings,
    *,
    parameters: Sequence[str] = (),
    spans: int | None = None,
    loads: bool = False,
) -> Forecast:
    """Simulate a manipulation from its first observed shape and compare at every observed stamp.

    Args:
        parameters: parameters of the wanted derivatives, see `dlo_ros.rod.sensitivity_parameters`.
        spans: knot spans; default: as simulation.tolerance asks.
        loads: whether forces, tension and bend radius are wanted.

    Raises:
        InputError: no observation, or observations that do not fit the settings.
        SimulationError: the motion cannot be simulated.
    """
    observations = observations_of(manipulation)
    settings = as_started(settings, manipulation)
    try:
        simulation = simulation_of(
            settings, motion_of(manipulation), parameters=parameters, spans=spans, loads=loads
        )
        for _ in simulation.starting(observations[:2], observations[-1].stamp):
            pass
        if settings.simulation.start == "moving":
            observations = observations[1:]
        predictions = predictions_at(simulation, [o.stamp for o in observations])
    except SimulationError as err:
        raise SimulationError(f"{manipulation.name}: {err}") from err
    changes = [p.sensitivity for p in predictions if p.sensitivity is not None]
    judged = simulation.resolution
    found = compared(
        observations,
        np.array([p.control_points for p in predictions]),
        np.array(changes) if changes else None,
        simulation.published,
        simulation.basis.even_spans,
        judged.error if judged else np.nan,
        stable=simulation.stable,
        unit=unit_of(manipulation),
    )
    return replace(found, loadings=tuple(p.loading for p in predictions if p.loading is not None))


def predictions_at(simulation: RodSimulation, stamps: Sequence[int]) -> list[Prediction]:
    """Predictions of a started simulation, which is advanced, at growing stamps [ns].

    Raises:
        SimulationError: the motion cannot be followed; the simulation stays as it was.
    """
    first = [simulation.prediction()] if stamps and stamps[0] == simulation.stamp else []
    return first + simulation.advance_through(stamps[len(first) :])


def warn_of_instability(found: Forecast, name: str) -> None:
    """Log a warning where a real DLO would leave the equilibrium that a forecast starts from.

    It is for results: of a hypothesis, such as a material or an effect that is tried, it is no
    news.

    Args:
        name: name of the recording.
    """
    if not found.stable:
        flat = not np.any(found.predicted[..., 1])
        LOG.warning("%s: %s", name, instability(flat=flat))


def observations_of(manipulation: Manipulation) -> Sequence[Observation]:
    """The observations.

    Raises:
        InputError: there is none.
    """
    if not manipulation.observations:
        raise InputError(f"{manipulation.name}: there is no observed shape to compare with")
    return manipulation.observations


def as_started(settings: Settings, manipulation: Manipulation) -> Settings:
    """The settings with the start and the numbers of a recording that has some of its own."""
    settings = of_recording(settings, manipulation.name)
    if manipulation.start is None:
        return settings
    return replace(settings, simulation=replace(settings.simulation, start=manipulation.start))


def borne_from(manipulation: Manipulation, settings: Settings) -> int:
    """Number of the first compared instant at which predicted loads are those of the DLO.

    A DLO that starts from an observed shape is accelerated in that instant by what the noise of the
    shape bends and stretches, with many times its weight; at the next one that has died out.
    """
    return 0 if as_started(settings, manipulation).simulation.start == "equilibrium" else 1


def motion_of(manipulation: Manipulation) -> Motion:
    """The commands of a manipulation as one motion."""
    motion = Motion()
    for command in manipulation.commands:
        motion.add(command)
    return motion


def compared(
    observations: Sequence[Observation],
    predicted: FloatArray,
    sensitivity: FloatArray | None,
    basis: SplineBasis,
    spans: int,
    resolution_error: float,
    *,
    stable: bool = True,
    unit: float | None = None,
) -> Forecast:
    """Predictions beside the observations.

    Args:
        observations: F of them.
        predicted: control points at their stamps, shape (F, n, 4).
        sensitivity: derivatives of x, y, z, shape (F, P, n, 3), or None.
        basis: the published one.
        spans, resolution_error, stable: see `Forecast`.
        unit: see `unit_of`.
    """
    white = whitening(basis.control_points, basis.length)
    observed = np.array([o.control_points for o in observations])
    residual = np.asarray(white @ (observed[:, :, :3] - predicted[:, :, :3]))
    derivative = None if sensitivity is None else np.asarray(white @ sensitivity)
    scale = noise_unit(observations, basis.length) if unit is None else unit
    for k, observation in enumerate(observations):
        points = operator_of(observation, basis.length)
        if points is None or scale is None:
            continue
        residual[k] = scale * points.in_space(points.residual(predicted[k, :, :3]))
        if derivative is not None and sensitivity is not None:
            derivative[k] = scale * points.in_space(points.moved(sensitivity[k]))
    return Forecast(
        np.array([o.stamp for o in observations], dtype=np.int64),
        predicted,
        residual,
        derivative,
        shape_errors(observed, predicted, basis),
        spans,
        resolution_error,
        stable,
        sensitivity=sensitivity,
    )
