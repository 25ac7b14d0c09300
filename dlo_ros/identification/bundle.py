"""Many forecasts of one recording at once, and derivatives from them.

Where the rod stays in the plane, eight parameter sets are simulated at the price of little more
than one (`dlo_ros.rod.lanes`). Their differences are the derivatives: all eight share their time
steps, so that the error of these cancels. Elsewhere the forecasts are made one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import logarithms, with_logarithms
from dlo_ros.identification.forecast import (
    Forecast,
    Manipulation,
    compared,
    forecast,
    motion_of,
    seen_until,
)
from dlo_ros.parameters import Settings
from dlo_ros.rod.dynamics import in_lanes, with_consistent_acceleration
from dlo_ros.rod.lanes import ParameterSets
from dlo_ros.rod.packing import true_command
from dlo_ros.rod.planar import in_plane
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.state import State
from dlo_ros.rod.statics import settle
from dlo_ros.rod.tangents import MATERIAL
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
    theta = logarithms(settings)
    usable = np.isfinite(theta)
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
    together = _together(manipulation, sets, spans, last_stamp) if usable[:2].all() else None
    if together is None or any(f is None for f in together):
        return forecast(
            manipulation, settings, parameters=MATERIAL, spans=spans, last_stamp=last_stamp
        )
    here, *sides = (f for f in together if f is not None)
    derivative = np.zeros((len(here.stamps), len(MATERIAL), *here.residual.shape[1:]))
    for i, k in enumerate(vary):
        above, below = sides[2 * i], sides[2 * i + 1]
        derivative[:, k] = (below.residual - above.residual) / (2.0 * DIFFERENCE[k])
    if follows:
        derivative[:, DENSITY] = -derivative[:, 0] - derivative[:, 2]
    return replace(here, derivative=derivative)


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
    together = _together(manipulation, settings, spans, last_stamp)
    if together is not None:
        return together
    result: list[Forecast | None] = []
    for one in settings:
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
) -> list[Forecast | None] | None:
    """Forecasts from one run of all sets; None where that cannot be done."""
    observations = seen_until(manipulation, last_stamp)
    motion = motion_of(manipulation)
    first = Simulation(sets[0], motion, spans=spans)
    try:
        first.start(observations[:2], observations[-1].stamp)
    except SimulationError:
        return None
    assert first.state is not None
    begin, last = first.stamp, observations[-1].stamp
    if any(begin < c.stamp < last for c in motion.commands):
        return None
    command = motion.at(begin)
    assert command is not None
    model, boundary, state = first.model, first.boundary, first.state
    measured = any(name in _MEASUREMENT for name in sets[0].effects)
    if measured or not in_lanes(model, boundary):
        return None
    if not in_plane(model, state, true_command(model, command)):
        return None
    if sets[0].simulation.start == "moving":
        observations = observations[1:]
    simulations, failed = [first], {}
    for k, settings in enumerate(sets[1:], start=1):
        try:
            simulations.append(_started(first, settings))
        except SimulationError as err:
            failed[k] = str(err)
    stamps = [o.stamp for o in observations]
    later = [s for s in stamps if s > begin]
    states = [s.state for s in simulations if s.state is not None]
    moved: Sequence[FloatArray] = [s.q[None, :0] for s in states]
    lost: dict[int, str] = {}
    if later:
        try:
            parameter_sets = ParameterSets([s.model for s in simulations], boundary)
            tracks = parameter_sets.follow(states, command, later)
        except InputError:
            return None
        moved, lost = list(tracks.shapes), tracks.failures
    published = first.published
    down = published.projection(model.basis)
    error = first.resolution.error if first.resolution else np.nan
    result: list[Forecast | None] = []
    row = iter(range(len(simulations)))
    for k in range(len(sets)):
        if k in failed:
            result.append(None)
            continue
        i = next(row)
        if i in lost:
            result.append(None)
            continue
        shapes = moved[i]
        if len(later) < len(stamps):
            first_shape = states[i].q[None]
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
            )
        )
    return result


_MEASUREMENT = ("camera_scale", "camera_rotation", "command_delay", "length_error", "clamp_slip")


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
