# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many forecasts of one recording at once, and derivatives from them.

Where the rod stays in the plane, eight parameter sets are simulated at the price of little more
than one (`dlo_ros.rod.batch.parameter_sets`). Their differences are the derivatives: all eight
share their time steps, so that the error of these cancels. Elsewhere the forecasts are made one by
one.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.effects import effects
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.cooperative_tasks import exhausted
from dlo_ros.identification.estimate import logarithms, with_logarithms
from dlo_ros.inference.forecast import (
    Forecast,
    Manipulation,
    compared,
    forecast,
    motion_of,
    seen_until,
    unit_of,
)
from dlo_ros.parameters import Settings
from dlo_ros.rod.batch.parameter_sets import ParameterSets
from dlo_ros.rod.dynamics import in_lanes, with_consistent_acceleration
from dlo_ros.rod.packing import nothing_varies, true_command
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.sensitivity.sensitivity_state import SensitivityState
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.state import State
from dlo_ros.rod.statics import settle
from dlo_ros.spline import FloatArray

DIFFERENCE = (0.02, 0.02, 0.1, 0.1)  # of the logarithms of MATERIAL, to either side
DENSITY = MATERIAL.index("density")


def forecast_varied(
    manipulation: Manipulation,
    settings: Settings,
    *,
    spans: int | None = None,
    last_stamp: int | None = None,
) -> Forecast:
    """As `forecast` with derivatives by `MATERIAL`.

    Raises:
        InputError, SimulationError: as `forecast`.
    """
    together = exhausted(varied_in_pieces(manipulation, settings, spans, last_stamp))
    if together is not None:
        return together.forecast
    return forecast(manipulation, settings, parameters=MATERIAL, spans=spans, last_stamp=last_stamp)


def varied_in_pieces(
    manipulation: Manipulation,
    settings: Settings,
    spans: int | None = None,
    last_stamp: int | None = None,
    frames: int | None = None,
) -> Generator[None, None, Varied | None]:
    """As `forecast_varied`, piece by piece; None where several sets cannot be simulated at once.

    Args:
        frames: observations of a piece; None: all.
    """
    theta = logarithms(settings)
    usable = np.isfinite(theta)
    if not usable[:2].all():
        return None
    # Without forces of their own (weights, draughts) every force is proportional to E, mu or c, so
    # that scaling all three changes nothing: what mu does follows from the others.
    follows = not settings.effects
    vary = [k for k in range(len(MATERIAL)) if usable[k] and not (follows and k == DENSITY)]
    sets = [settings]
    for k in vary:
        for side in (1.0, -1.0):
            moved = theta.copy()
            moved[k] += side * DIFFERENCE[k]
            sets.append(with_logarithms(settings, moved))
    together = yield from _together(manipulation, sets, spans, last_stamp, frames)
    if together is None or any(f is None for f in together.forecasts):
        return None
    here, *sides = (f for f in together.forecasts if f is not None)
    state, *states = together.states
    derivative = np.zeros((len(here.stamps), len(MATERIAL), *here.residual.shape[1:]))
    for i, k in enumerate(vary):
        above, below = sides[2 * i], sides[2 * i + 1]
        derivative[:, k] = (below.residual - above.residual) / (2.0 * DIFFERENCE[k])
    if follows:
        derivative[:, DENSITY] = -derivative[:, 0] - derivative[:, 2]
    pairs = {k: (states[2 * i], states[2 * i + 1]) for i, k in enumerate(vary)}
    varying = _varying(state, pairs, follows=follows)
    end = together.first.carrying(replace(state, sensitivity=varying), MATERIAL)
    return Varied(replace(here, derivative=derivative), end)


@dataclass(frozen=True)
class Varied:
    """A forecast with derivatives by `MATERIAL`, and the simulation at its end, which has them."""

    forecast: Forecast
    simulation: Simulation


def _varying(
    state: State, pairs: Mapping[int, tuple[State, State]], *, follows: bool
) -> SensitivityState:
    """Derivatives of a planar state by `MATERIAL`, from the states above and below."""
    result = nothing_varies(state, len(MATERIAL))
    parts: dict[str, Callable[[State], FloatArray]] = {
        "q": lambda s: s.q,
        "velocity": lambda s: s.velocity,
        "acceleration": lambda s: s.acceleration,
        "auxiliary": lambda s: s.auxiliary,
        "stretch": lambda s: s.strains.stretch,
        "stretch_before": lambda s: s.previous.stretch,
        "other": lambda s: s.strains.other,
        "other_before": lambda s: s.previous.other,
    }
    for name, part in parts.items():
        rate = getattr(result, name)
        for k, (above, below) in pairs.items():
            rate[k] = (part(above) - part(below)) / (2.0 * DIFFERENCE[k])
        if follows:
            rate[DENSITY] = -rate[0] - rate[2]
    return result


def forecast_each(
    manipulation: Manipulation,
    settings: Sequence[Settings],
    *,
    spans: int | None = None,
    last_stamp: int | None = None,
) -> list[Forecast | None]:
    """Forecasts with several settings of one DLO; None where the simulation fails.

    Raises:
        InputError: as `forecast`.
    """
    return exhausted(forecast_in_pieces(manipulation, settings, spans, last_stamp))


def forecast_together(
    manipulation: Manipulation, settings: Sequence[Settings], spans: int | None = None
) -> list[Forecast | None] | None:
    """As `forecast_each`, but None altogether where the sets cannot share their simulation."""
    together = exhausted(_together(manipulation, settings, spans, None, None))
    return together.forecasts if together is not None else None


def forecast_in_pieces(
    manipulation: Manipulation,
    settings: Sequence[Settings],
    spans: int | None = None,
    last_stamp: int | None = None,
    frames: int | None = None,
) -> Generator[None, None, list[Forecast | None]]:
    """As `forecast_each`, piece by piece for who must not wait.

    Args:
        frames: observations of a piece; None: all.
    """
    together = yield from _together(manipulation, settings, spans, last_stamp, frames)
    if together is not None:
        return together.forecasts
    result: list[Forecast | None] = []
    for one in settings:
        yield
        try:
            result.append(forecast(manipulation, one, spans=spans, last_stamp=last_stamp))
        except SimulationError:
            result.append(None)
    return result


def _together(
    manipulation: Manipulation,
    sets: Sequence[Settings],
    spans: int | None,
    last_stamp: int | None,
    frames: int | None = None,
) -> Generator[None, None, _Together | None]:
    """Forecasts from one run of all sets; None where that cannot be done."""
    observations = seen_until(manipulation, last_stamp)
    motion = motion_of(manipulation)
    first = Simulation(sets[0], motion, spans=spans)
    try:
        yield from first.starting(observations[:2], observations[-1].stamp)
    except SimulationError:
        return None
    first.warn_of_instability()
    assert first.state is not None
    begin, last = first.stamp, observations[-1].stamp
    if any(begin < c.stamp < last for c in motion.commands):
        return None
    command = motion.at(begin)
    assert command is not None
    model, boundary, state = first.model, first.boundary, first.state
    alone = not all(effects()[name].batched for one in sets for name in one.effects)
    if alone or not in_lanes(model, boundary):
        return None
    if not in_plane(model, state, true_command(model, command)):
        return None
    if sets[0].simulation.start == "moving":
        observations = observations[1:]
    simulations, failed = [first], {}
    for k, settings in enumerate(sets[1:], start=1):
        yield
        try:
            simulations.append(_started(first, settings))
        except SimulationError as err:
            failed[k] = str(err)
    stamps = [o.stamp for o in observations]
    later = [s for s in stamps if s > begin]
    states = [s.state for s in simulations if s.state is not None]
    begun, moved = states, [s.q[None, :0] for s in states]
    lost: dict[int, str] = {}
    if later:
        yield
        try:
            parameter_sets = ParameterSets([s.model for s in simulations], boundary)
            pieces: list[FloatArray] = []
            for leg in _legs(later, frames):
                tracks = parameter_sets.follow(states, command, leg)
                pieces.append(tracks.shapes)
                lost |= tracks.failures
                # What has failed stands still from here on.
                states = [s if k in lost else tracks.state(k) for k, s in enumerate(states)]
                states = [replace(s, stamp=leg[-1]) for s in states]
                yield
        except InputError:
            return None
        moved = list(np.concatenate(pieces, axis=1))
    published = first.published
    down = published.projection(model.basis)
    error = first.resolution.error if first.resolution else np.nan
    result: list[Forecast | None] = []
    row = iter(range(len(simulations)))
    for k in range(len(sets)):
        yield
        if k in failed:
            result.append(None)
            continue
        i = next(row)
        if i in lost:
            result.append(None)
            continue
        shapes = moved[i]
        if len(later) < len(stamps):
            first_shape = begun[i].q[None]
            shapes = np.concatenate([first_shape, shapes]) if later else first_shape
        result.append(
            compared(
                observations,
                _projected(down, shapes),
                None,
                published,
                model.basis.spans,
                error,
                stable=simulations[i].stable,
                unit=unit_of(manipulation),
            )
        )
    return _Together(result, states, first)


@dataclass(frozen=True)
class _Together:
    """Forecasts of all sets, None where one has failed, and the states of the others at the end.

    `first` is the simulation of the first set at its start.
    """

    forecasts: list[Forecast | None]
    states: list[State]
    first: Simulation


def _legs(stamps: list[int], frames: int | None) -> list[list[int]]:
    """Stamps in pieces."""
    size = frames or len(stamps)
    return [stamps[k : k + size] for k in range(0, len(stamps), size)]


def _projected(down: FloatArray, shapes: FloatArray) -> FloatArray:
    """Shapes (F, m, 4) in the published basis, free of twist as in the plane."""
    result = np.asarray(down @ shapes)
    result[:, :, 3] = 0.0
    return result


def _started(first: Simulation, settings: Settings) -> Simulation:
    """A simulation with other parameters, started as another one was."""
    assert first.state is not None
    twin = copy(first)
    twin.settings = settings
    twin.model = first.model.with_settings(settings)
    command = twin.motion.at(first.state.stamp)
    assert command is not None
    state: State
    if settings.simulation.start == "equilibrium":
        found = settle(
            twin.model, twin.boundary, first.state, command, first.state.stamp, fresh=True
        )
        state, twin.stable = found.state, found.stable
    else:
        state = with_consistent_acceleration(twin.model, twin.boundary, first.state, command)
    twin.state = state
    return twin
