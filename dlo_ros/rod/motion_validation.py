# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Validation of what is asked of a rod before it is simulated: motion without jumps, in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.command import END, NANOSECONDS, START, Command
from dlo_ros.errors import InputError, ParameterError, SimulationError
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.state import State
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray

JUMP = 0.25  # of L: what may be imposed at once, as by poses that are sent one by one
TURN = 1.0  # [rad] likewise
AT_ONCE = 1e-3  # [s]
MOST_STRAIN = 0.5  # under the own weight: beyond, Hooke's law says nothing of a real material


@dataclass(frozen=True)
class _Step:
    """An instantaneous change of an imposed pose: distance [m], angle and time [s]."""

    name: str
    moved: float
    turned: float
    time: float


def steady(
    boundary: Boundary, state: State, command: Command, until: int, held: Sequence[str]
) -> None:
    """Check imposed motion for jumps between the state's instant and another.

    Args:
        held: names of what was held before; a new grip may find the DLO elsewhere than simulated.
        command: command with all effects applied.
        until: stamp [ns].

    Raises:
        SimulationError: what jumps, when, how far and how far it may.
    """
    length = boundary.basis.length
    furthest = 1.001 * JUMP * length
    now = (state.stamp - command.stamp) / NANOSECONDS
    steps = [s for s in _from_here(boundary, state, command, now) if s.name in held]
    steps += _between_points(command, now, (until - command.stamp) / NANOSECONDS, furthest)
    for step in steps:
        if step.moved > furthest:
            raise SimulationError(
                f"dlo/command jumps: '{step.name}' moves {step.moved:.3g} m at once at "
                f"{step.time:.3f} s; at most {JUMP * length:.3g} m ({JUMP:g} of the length) within "
                f"{AT_ONCE:g} s can be followed"
            )
        if step.turned > TURN:
            raise SimulationError(
                f"dlo/command jumps: '{step.name}' turns by {step.turned:.3g} rad at once at "
                f"{step.time:.3f} s; at most {TURN:g} rad within {AT_ONCE:g} s can be followed"
            )


def _from_here(boundary: Boundary, state: State, command: Command, now: float) -> list[_Step]:
    """From where the DLO is to what is imposed on it now."""
    basis, last = boundary.basis, boundary.published.control_points
    places = dict(zip(boundary.pinned, boundary.pin_abscissae.tolist(), strict=True))
    position, rotation = command.sample(state.stamp)
    steps = []
    q = state.q[:, :3]
    for k, name in enumerate(command.names):
        # A clamped spline starts in its first control point towards the second.
        if name in (START, "control_point_1"):
            here, tangent = q[0], q[1] - q[0]
        elif name in (END, f"control_point_{last}"):
            here, tangent = q[-1], q[-1] - q[-2]
        elif name in places:
            here, tangent = basis.evaluate(q, np.array([places[name]]))[0], np.zeros(3)
        else:
            continue  # a second control point: it gives a direction
        moved = float(np.linalg.norm(here - position[k]))
        turned = 0.0
        if name in (START, END):
            cosine = tangent @ _direction(rotation[k]) / np.linalg.norm(tangent)
            turned = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        steps.append(_Step(name, moved, turned, now))
    return steps


def _between_points(command: Command, now: float, until: float, furthest: float) -> list[_Step]:
    """Steps between points of the command that are too fast, as imposed in `AT_ONCE`.

    Args:
        now, until: times from the command's start [s].
        furthest: distance up to which a motion is not too fast [m].
    """
    times = command.times
    first = max(int(np.searchsorted(times, now, side="right")) - 1, 0)
    stop = min(int(np.searchsorted(times, until, side="left")), len(times) - 1)
    if stop <= first:
        return []
    share = np.minimum(AT_ONCE / np.diff(times[first : stop + 1]), 1.0)[:, None]
    positions, rotations = (x[first : stop + 1] for x in (command.positions, command.rotations))
    moved = share * np.linalg.norm(np.diff(positions, axis=0), axis=2)
    dot = np.abs(np.sum(rotations[1:] * rotations[:-1], axis=2))
    turned = share * 2.0 * np.arccos(np.clip(dot, 0.0, 1.0))
    return [
        _Step(command.names[k], float(moved[a, k]), float(turned[a, k]), float(times[first + a]))
        for a, k in np.argwhere((moved > furthest) | (turned > TURN)).tolist()
    ]


def _direction(quaternion: FloatArray) -> FloatArray:
    """The x axis of a clamp."""
    x, y, z, w = quaternion
    return np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])


def in_order(now: int, stamps: Sequence[int]) -> None:
    """Check that a rod is led forwards only; the same instant twice in a row will do.

    Args:
        now: the present instant [ns].
        stamps: instants that are asked for [ns].

    Raises:
        InputError: a stamp lies before the present instant, or before the stamp ahead of it.
    """
    ways = np.diff(np.asarray(stamps, dtype=np.int64), prepend=now)
    back = np.flatnonzero(ways < 0)
    if not len(back):
        return
    k = int(back[0])
    if not k:
        raise InputError(
            f"the simulation is at {now / NANOSECONDS:.3f} s and cannot go back to "
            f"{stamps[0] / NANOSECONDS:.3f} s; reset it"
        )
    raise InputError(
        f"stamps must grow: {stamps[k] / NANOSECONDS:.3f} s comes after "
        f"{stamps[k - 1] / NANOSECONDS:.3f} s"
    )


def possible(settings: RodSettings) -> None:
    """Check that parameters describe a DLO; a search may propose others.

    Raises:
        SimulationError: effects leave no DLO, or it would be torn long by its own weight.
    """
    try:
        settings.check_effects()
    except ParameterError as err:
        raise SimulationError(str(err)) from err
    rod, gravity = settings.rod, float(np.linalg.norm(settings.gravity))
    # Of a bar that hangs from one end: mu g L / (2 E).
    strain = rod.density * gravity * rod.length / (2.0 * rod.young_modulus)
    if strain > MOST_STRAIN:
        raise SimulationError(
            f"a DLO of {rod.length:.3g} m with young_modulus {rod.young_modulus:.3g} Pa and "
            f"density {rod.density:.3g} kg/m^3 would hang {1.0 + strain:.3g} times as long as it "
            f"is; the model holds up to {1.0 + MOST_STRAIN:g} times"
        )
