# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulation of a motion before it is made: shapes, their uncertainty, forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from dlo_ros.command import CONTROL_POINT, END, NANOSECONDS, START, Command, Motion
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.rod.loads.extreme_loads import Extremes
from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.rod.model_registry import simulation_of, with_sensitivities
from dlo_ros.rod.protocol import RodSimulation
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod_settings import LimitParameters, RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

PLACES = 21
"""Places along the DLO at which the band is given."""
LONGEST = 36_000
"""Instants of one rehearsal: twelve minutes at 50 Hz, some hundred megabytes."""
NO_LOADS = "loads: none, since the rod model computes no loads"
SLACK = 1e-3
"""Of the distance of two ends: a DLO that is longer by less lies straight between them."""


@dataclass(frozen=True)
class Rehearsal:
    """A simulated motion.

    Args:
        stamps: S instants [ns].
        shapes: control points x, y, z [m], theta [rad], shape (S, n, 4).
        std: standard deviation of the position that the parameters' gives [m], at equally spaced
            places from u = 0 to L, shape (S, `PLACES`); None where none is known.
        loadings: loads on the DLO and its grips, S of them; none where the rod model does not
            compute loads.
        length: L [m].
    """

    stamps: tuple[int, ...]
    shapes: FloatArray
    std: FloatArray | None
    loadings: tuple[Loading, ...]
    length: float

    @property
    def extremes(self) -> Extremes:
        """The largest loads, by seconds since the first instant."""
        return Extremes(self.loadings, self._times)

    @property
    def _times(self) -> list[float]:
        return [(stamp - self.stamps[0]) / NANOSECONDS for stamp in self.stamps]

    def sentences(self, limits: LimitParameters) -> list[str]:
        """The results, one line each, alarms last."""
        if self.std is None:
            band = "band: none, since no standard deviation of a parameter is stated"
        else:
            k, place = np.unravel_index(int(self.std.argmax()), self.std.shape)
            u = self.length * place / (PLACES - 1)
            band = (
                f"band: the parameters' standard deviations move the DLO by "
                f"{1e3 * self.std[k, place]:.3g} mm at most, at u = {u:.3g} m, "
                f"{self._times[k]:.2f} s; by {1e3 * self.std[-1].max():.3g} mm at the end"
            )
        return [band, *(self.extremes.sentences(limits) if self.loadings else [NO_LOADS])]


def rehearse(
    simulation: RodSimulation, stamps: Sequence[int], covariance: FloatArray | None
) -> Rehearsal:
    """Simulate through stamps.

    Args:
        simulation: simulation that has started, with `loads`, and sensitivities by
            `varied_by(covariance)`.
        stamps: [ns], growing, the first not before the simulation's instant; at least one.
        covariance: covariance of the logarithms of `MATERIAL`, shape (4, 4); None where it is not
            known.

    Raises:
        InputError: there are more than `LONGEST` stamps.
        SimulationError: the motion cannot be followed.
    """
    if len(stamps) > LONGEST:
        raise InputError(
            f"a rehearsal of {len(stamps)} instants is too long; at most {LONGEST} are simulated"
        )
    try:
        first = [simulation.advance(stamps[0])]
        predictions = first + simulation.advance_through(list(stamps[1:]))
    except ZeroDivisionError as err:  # of compiled code: points that give a direction coincide
        raise SimulationError("the motion folds the DLO so sharply that it breaks") from err
    std = None
    if covariance is not None:
        rows = [MATERIAL.index(name) for name in simulation.parameters]
        basis = simulation.published
        along = basis.matrix(np.linspace(0.0, basis.length, PLACES))
        changes = np.array([p.sensitivity for p in predictions])  # (S, P, n, 3)
        known = covariance[np.ix_(rows, rows)]
        variance = _variance(along @ changes, known)
        std = np.sqrt(np.maximum(variance, 0.0))
    return Rehearsal(
        tuple(p.stamp for p in predictions),
        np.array([p.control_points for p in predictions]),
        std,
        tuple(p.loading for p in predictions if p.loading is not None),
        simulation.published.length,
    )


def _variance(changes: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variance of positions, shape (S, m), of their derivatives by P parameters (S, P, m, 3)."""
    result: FloatArray = np.einsum(
        "spmc,sqmc,pq->sm", changes, changes, covariance, optimize=True
    )  # fmt: skip
    return result


def varied_by(covariance: FloatArray | None) -> tuple[str, ...]:
    """Names of the parameters that have a variance (4, 4)."""
    if covariance is None:
        return ()
    return tuple(n for n, v in zip(MATERIAL, np.diag(covariance), strict=True) if v > 0.0)


def stamps_of(command: Command, begin: int, rate: float) -> list[int]:
    """Stamps of a motion [ns], at a rate [Hz] from `begin` to its end, which is among them."""
    last = max(command.end_stamp, begin)
    count = int(np.ceil((last - begin) * rate / NANOSECONDS - 1e-6))
    if count > LONGEST:
        raise InputError(
            f"a rehearsal of {(last - begin) / NANOSECONDS:.0f} s is too long at {rate:g} Hz; at "
            f"most {LONGEST / rate:.0f} s are simulated"
        )
    return [begin + round(k * NANOSECONDS / rate) for k in range(count)] + [last]


@dataclass(frozen=True)
class Fork:
    """An independent simulation that goes on from the present state of another one.

    It shares nothing that changes, so that it may run in another thread.

    Args:
        simulation: simulation that follows the command under trial.
        present: the command that holds now.
        parameters: parameters whose sensitivities are wanted.
        late: time [ns] by which the command under trial begins later than its stamp says, which has
            passed: it is tried whole.
    """

    simulation: RodSimulation
    present: Command
    parameters: tuple[str, ...]
    late: int

    @classmethod
    def of(
        cls, simulation: RodSimulation, command: Command, parameters: Sequence[str] = ()
    ) -> Fork:
        """From a simulation that has started, with `loads`.

        Args:
            command: replaces those that would begin at or after it.

        Raises:
            InputError: the simulation has not started.
        """
        present = simulation.motion.at(simulation.stamp)
        if present is None:
            raise InputError("the simulation has no command yet")
        late = max(simulation.stamp - command.stamp, 0)
        motion = Motion(list(simulation.motion.commands))
        motion.add(replace(command, stamp=command.stamp + late))
        return cls(simulation.fork(simulation.settings, motion), present, tuple(parameters), late)

    def prepared(self) -> RodSimulation:
        """The simulation, with its state's sensitivities to the parameters."""
        return with_sensitivities(self.simulation, self.parameters, self.present)


def at_rest(
    settings: RodSettings, command: Command, covariance: FloatArray | None, last: int | None = None
) -> RodSimulation:
    """A simulation of a DLO that hangs at rest where a command begins.

    Args:
        covariance: see `rehearse`.
        last: stamp until which the motion matters for the resolution [ns].

    Raises:
        InputError, SimulationError: see `RodSimulation.starting`.
    """
    settings = replace(settings, simulation=replace(settings.simulation, start="equilibrium"))
    result = simulation_of(
        settings, Motion([command]), parameters=varied_by(covariance), loads=True
    )  # fmt: skip
    result.start([Observation(command.stamp, slack(settings, command))], last)
    return result


def slack(settings: RodSettings, command: Command) -> FloatArray:
    """A shape from which a DLO finds its equilibrium where a command begins, shape (n, 4).

    Held at both ends it sags in an arc, else it lies straight in the direction of the clamp.
    """
    n, length = settings.rod.control_points, settings.rod.length
    u = SplineBasis(n, length).greville
    position, rotation = command.sample(command.stamp)
    places = {name: position[k] for k, name in enumerate(command.names)}
    first = places.get(START, places.get(f"{CONTROL_POINT}1"))
    last = places.get(END, places.get(f"{CONTROL_POINT}{n}"))
    shape = np.zeros((n, 4))
    down = np.array(settings.gravity)
    if first is not None and last is not None:
        chord = last - first
        apart = float(np.linalg.norm(chord))
        if apart > (1.0 - SLACK) * length:
            shape[:, :3] = first + np.outer(u / length, chord)
            return shape
        along = chord / apart if apart > SLACK * length else np.array([1.0, 0.0, 0.0])
        side = down - (down @ along) * along
        size = float(np.linalg.norm(side))
        # Where gravity decides for no side: any one within the board.
        side = side / size if size > 1e-6 else np.cross(along, [0.0, 1.0, 0.0])
        half = brentq(lambda x: np.sinc(x / np.pi) - apart / length, 1e-9, 1.01 * np.pi)
        angle, radius = half * (2.0 * u / length - 1.0), 0.5 * length / half
        shape[:, :3] = first + radius * (
            np.outer(np.sin(angle) + np.sin(half), along)
            + np.outer(np.cos(angle) - np.cos(half), side)
        )
        return shape
    direction = _held_direction(command, places, rotation)
    if first is not None:
        from_there, anchor = u, first
    elif last is not None:
        from_there, anchor = u - length, last
    else:  # pins alone
        name = command.names[0]
        from_there, anchor = u - u[int(name.rpartition("_")[2]) - 1], places[name]
    shape[:, :3] = anchor + np.outer(from_there, direction)
    return shape


def _held_direction(
    command: Command, places: Mapping[str, FloatArray], rotations: FloatArray
) -> FloatArray:
    """Unit vector along growing u in which a command holds an end, shape (3,); x where it is free.

    Args:
        places: imposed positions by name [m].
        rotations: imposed rotations, shape (K, 4).
    """
    direction, last = np.array([1.0, 0.0, 0.0]), command.control_points
    for first, second in ((1, 2), (last - 1, last)):
        pair = [places.get(f"{CONTROL_POINT}{k}") for k in (first, second)]
        if pair[0] is not None and pair[1] is not None:
            along = pair[1] - pair[0]
            size = float(np.linalg.norm(along))
            direction = along / size if size > 0.0 else direction
    for name in (START, END):
        if name in command.names:
            turned = Rotation.from_quat(rotations[command.names.index(name)])
            direction = turned.apply([1.0, 0.0, 0.0])
    return direction
