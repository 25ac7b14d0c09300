# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Reactions of the grips, tension and tightest bend of a simulated rod, at rest and in motion.

The rod's equations M a + C v + elastic and viscous forces = loads + reactions hold with reactions
in what is held only. Shape, velocity and the acceleration of what is held give the acceleration of
all the rest and with it the reactions. A clamp holds two control points and the twist angle. By the
principle of virtual work the sum of the two reactions is its force; that in the second control
point, at its lever, and that in the twist angle are its torque.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.elements.rod_tables import DOF, InternalVariables
from dlo_ros.rod.integration import Track
from dlo_ros.rod.loads.external_forces import ExternalForces
from dlo_ros.rod.loads.stress_resultants import Instants, Stresses, cross, dot
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import growth_at
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray

PLACES = 4
"""Places in a knot span at which the bend is judged."""
STRAIGHT = 1e6
"""Radius over length beyond which a DLO counts as straight; this radius is stated instead."""
DENSE = 0.021
"""Longest time [s] between instants of which velocities give the accelerations of what is held: a
motion of 1 Hz is then known to 0.3 %. At 50 Hz, the usual rate, it is 0.02 s."""
MOMENT = 1e-4
"""Time before an instant [s] over which the rate of the free length is taken; it may jump there."""


@dataclass(frozen=True)
class Wrench:
    """Force [N] and torque [N m] that a grip exerts on the DLO, about that end, shape (3,) each."""

    force: FloatArray
    torque: FloatArray


@dataclass(frozen=True)
class MotionForces:
    """Acceleration of a DLO and the forces on it at S instants.

    Args:
        acceleration: accelerations of the control points [m/s^2], shape (S, n, 3).
        forces: external forces, inertia included, at the points of `ExternalForces` and at the pins
            [N], shape (S, m, 3); they are in balance with the forces of the grips.
    """

    acceleration: FloatArray
    forces: FloatArray


@dataclass(frozen=True)
class Loading:
    """The loads on a DLO and its grips at one instant.

    Args:
        start, end: wrenches of the grips at u = 0 and u = L; None where that end is free.
        tension: largest along the DLO [N]; negative where all of it is pushed.
        tension_at: material coordinate of the largest tension [m].
        bend_radius: smallest of the axis [m], at most `STRAIGHT` times the length.
        bend_at: material coordinate of the smallest bend radius [m].
    """

    start: Wrench | None
    end: Wrench | None
    tension: float
    tension_at: float
    bend_radius: float
    bend_at: float

    @property
    def wrenches(self) -> list[tuple[FloatArray, FloatArray] | None]:
        """Force and torque of the grips at start and end; None where that end is free."""
        return [None if w is None else (w.force, w.torque) for w in (self.start, self.end)]


def loadings(
    model: RodModel, boundary: Boundary, states: Sequence[State], command: Command
) -> list[Loading]:
    """The loads on a rod and its grips in given states.

    Args:
        states: states of the rod, at least one.
        command: command that the rod follows, effects not applied.
    """
    if model.body.slip and len(states) > 1:
        return [loadings(model, boundary, [state], command)[0] for state in states]
    now = instants_of(states, growth_of(model, boundary, command, states[0].stamp))
    return balance_of(model, boundary).loadings(now)


def instants_of(states: Sequence[State], growth: tuple[float, float] = (1.0, 0.0)) -> Instants:
    """States, at least one, as one array of instants."""

    def stack(values: Iterable[FloatArray]) -> FloatArray:
        return np.array(list(values))

    return Instants(
        stack(s.q for s in states), stack(s.velocity for s in states),
        stack(s.acceleration for s in states), stack(s.reference.director for s in states),
        stack(s.reference.twist for s in states),
        InternalVariables(
            *(stack(parts) for parts in zip(*(s.internal for s in states), strict=True))
        ),
        growth,
    )  # fmt: skip


def loadings_along(
    model: RodModel, boundary: Boundary, before: State, stamps: Sequence[int], track: Track
) -> list[Loading]:
    """The loads on a plain rod in the plane y = 0 at dense instants of its motion.

    Args:
        model: a rod that is `plain`.
        before: the state in which the track began.
        stamps: stamps of the track [ns], S of them.
        track: shapes and speeds at the stamps.
    """
    times = (np.array([before.stamp, *stamps]) - before.stamp) / NANOSECONDS
    speeds = np.concatenate([before.velocity[None], track.speeds])
    acceleration = np.gradient(speeds, times, axis=0)[1:]
    count, nb = len(stamps), len(model.points)
    director = np.broadcast_to(np.array([0.0, 1.0, 0.0]), (count, nb, 3))
    nothing = InternalVariables(
        np.zeros((count, 0, 2)), np.zeros((count, 0, 2)), np.zeros((count, 0, 6))
    )
    now = Instants(
        track.shapes, track.speeds, acceleration, director, np.zeros((count, nb)), nothing,
        (1.0, 0.0),
    )  # fmt: skip
    return balance_of(model, boundary).loadings(now)


def dense(stamps: Sequence[int]) -> bool:
    """Whether stamps [ns] are near enough for `loadings_along`."""
    return len(stamps) > 1 and bool(np.diff(stamps).max() <= DENSE * NANOSECONDS)


def growth_of(
    model: RodModel, boundary: Boundary, command: Command, stamp: int
) -> tuple[float, float]:
    """Free length over the model's and its rate [1/s], see `equation_system.growth`."""
    times = (stamp - command.stamp) / NANOSECONDS + MOMENT * np.array([-1.0, 0.0])
    grown = growth_at(model, boundary, command, times)
    return float(grown[1]), float(grown[1] - grown[0]) / MOMENT


def balance_of(model: RodModel, boundary: Boundary) -> Balance:
    """The equations of a rod, kept with the model."""
    cache: dict[Boundary, Balance] = model.__dict__.setdefault("_balances", {})
    if boundary not in cache:
        cache[boundary] = Balance(model, boundary)
    return cache[boundary]


class Balance:
    """Balance of forces of one rod with its boundary conditions."""

    def __init__(self, model: RodModel, boundary: Boundary) -> None:
        self._model, self._boundary = model, boundary
        basis = model.basis
        self._stresses, self._external = Stresses(model), ExternalForces(model)
        held = boundary.fixed.reshape(-1, DOF)
        self._held, self._turned = held[:, 0], held[:, 3]
        self._pins = basis.matrix(boundary.pin_abscissae)
        pinned = basis.span_of(boundary.pin_abscissae)
        # Which points and pins lie before a knot.
        span = np.concatenate([self._external.span, pinned])
        self._before = (span < np.arange(basis.spans + 1)[:, None]).astype(float)
        self._places = np.linspace(0.0, basis.length, PLACES * basis.spans + 1)
        self._slope, self._curvature = (basis.matrix(self._places, d) for d in (1, 2))
        # Where a grip gives, the DLO turns beside it, and is not bent so.
        hinged = model.body.hinged.reshape(basis.spans, -1)
        self._bent = ~np.asarray(hinged.any(axis=1))[basis.span_of(self._places)]
        knots = basis.breaks
        self._between = np.array(
            [np.interp(self._places, knots, row) for row in np.eye(len(knots))]
        ).T

    def solve(self, now: Instants) -> tuple[MotionForces, FloatArray]:
        """Motion and reactions at S instants; the reactions have shape (S, n, 4) [N; N m]."""
        longer = now.growth[0]
        gradient, tangent = self._stresses.at(now)
        force = self._external.at(now, tangent, longer)
        positions, theta = self._unchanged if longer == 1.0 else self._balances(longer)
        lack = gradient[..., :3] - self._external.matrix.T @ force
        imposed, turned = now.acceleration[..., :3], now.acceleration[..., 3:]
        reaction = np.zeros_like(now.q)
        reaction[..., :3] = positions.reaction(lack, imposed)
        reaction[..., 3:] = theta.reaction(gradient[..., 3:], turned)
        acceleration, pull = positions.free(lack, imposed)
        force -= self._external.mass(longer)[:, None] * (self._external.matrix @ acceleration)
        return MotionForces(acceleration, np.concatenate([force, pull], axis=1)), reaction

    def loadings(self, now: Instants) -> list[Loading]:
        """The loads on the rod at S instants."""
        q, n = now.q, now.q.shape[1]
        motion, reaction = self.solve(now)
        ends = [
            self._wrenches(q, reaction, 0, 1, clamped=self._boundary.clamped_start),
            self._wrenches(q, reaction, n - 1, n - 2, clamped=self._boundary.clamped_end),
        ]
        # Force that the part before a place exerts on the part behind it, by the balance of the
        # former: it is right where the direction of the DLO changes within a span, too.
        inner = self._before @ motion.forces
        inner += 0.0 if ends[0] is None else ends[0][0][:, None]
        p, s = self._slope @ q[..., :3], self._curvature @ q[..., :3]
        speed = np.linalg.norm(p, axis=-1)
        tension = -dot(self._between @ inner, p) / speed
        bend = self._bent * np.linalg.norm(cross(p, s), axis=-1) / speed**3
        result = []
        for k in range(len(q)):
            start, end = (None if e is None else Wrench(e[0][k], e[1][k]) for e in ends)
            most, tight = int(tension[k].argmax()), int(bend[k].argmax())
            radius = 1.0 / max(float(bend[k, tight]), 1.0 / (STRAIGHT * self._model.basis.length))
            result.append(
                Loading(
                    start, end, float(tension[k, most]), float(self._places[most]), radius,
                    float(self._places[tight]),
                )
            )  # fmt: skip
        return result

    @cached_property
    def _unchanged(self) -> tuple[_Held, _Held]:
        return self._balances(1.0)

    def _balances(self, longer: float) -> tuple[_Held, _Held]:
        """Balances of positions and of theta, for a free length over the model's."""
        matrix = self._external.matrix
        mass = matrix.T @ (self._external.mass(longer)[:, None] * matrix)
        none = np.zeros((0, len(mass)))
        return (
            _Held.of(mass, self._held, self._pins),
            _Held.of(longer * _full(self._model.spin), self._turned, none),
        )

    def _wrenches(
        self, q: FloatArray, reaction: FloatArray, tip: int, second: int, *, clamped: bool
    ) -> tuple[FloatArray, FloatArray] | None:
        """Forces and torques (S, 3) of the grip at an end; None where it is free.

        Args:
            tip, second: the control points of that end.
            clamped: whether it gives the DLO a direction.
        """
        if not self._held[tip]:
            return None
        force = reaction[:, tip, :3]
        if not clamped:
            return force, np.zeros_like(force)
        lever = q[:, second, :3] - q[:, tip, :3]
        axis = lever / np.linalg.norm(lever, axis=-1, keepdims=True) * np.sign(second - tip)
        torque = cross(lever, reaction[:, second, :3]) + reaction[:, tip, 3:] * axis
        return force + reaction[:, second, :3], torque


@dataclass(frozen=True)
class _Held:
    """One coordinate of all control points, of which some are held or pinned, as linear functions.

    They are functions of all other forces against the motion (n) and of the imposed acceleration
    (n); what is free accelerates by itself.

    Args:
        reactions: reaction forces at held and pinned control points, zero elsewhere, shape (n, 2
            n).
        motion: acceleration, and the forces of the m pins, shape (n + m, 2 n).
    """

    reactions: FloatArray
    motion: FloatArray

    @classmethod
    def of(cls, mass: FloatArray, held: np.ndarray, pins: FloatArray) -> _Held:
        """Linear functions for a mass matrix (n, n), the rows that are held (n,) and those of the
        pins (m, n).
        """
        free, n, m = ~held, len(mass), len(pins)
        one, rows = np.eye(n), int(free.sum())
        matrix = np.zeros((rows + m, rows + m))
        matrix[:rows, :rows] = mass[np.ix_(free, free)]
        matrix[:rows, rows:], matrix[rows:, :rows] = -pins[:, free].T, pins[:, free]
        right = np.zeros((rows + m, 2 * n))
        right[:rows, :n] = -one[free]
        right[:rows, n:] = -mass[np.ix_(free, held)] @ one[held]
        right[rows:, n:] = pins - pins[:, held] @ one[held]
        try:
            solved = np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:  # pins that hold the same twice; any sharing is right
            solved = np.linalg.lstsq(matrix, right, rcond=None)[0]
        motion = np.zeros((n + m, 2 * n))
        motion[:n][free], motion[n:] = solved[:rows], solved[rows:]
        motion[:n, n:][held] = one[held]
        reactions = mass @ motion[:n] - pins.T @ motion[n:]
        reactions[:, :n] += one
        reactions[free] = 0.0
        return cls(reactions, motion)

    def reaction(self, lack: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Reactions (S, n, c) for forces and accelerations of that shape."""
        n = len(self.reactions)
        return self.reactions[:, :n] @ lack + self.reactions[:, n:] @ acceleration

    def free(self, lack: FloatArray, acceleration: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Accelerations (S, n, c) and forces of the pins (S, m, c)."""
        n = len(self.reactions)
        result = self.motion[:, :n] @ lack + self.motion[:, n:] @ acceleration
        return result[:, :n], result[:, n:]


def _full(band: FloatArray) -> FloatArray:
    """A symmetric matrix (n, n) of its lower band (n, 4)."""
    n = len(band)
    result = np.zeros((n, n))
    for k in range(4):
        i = np.arange(3 - k, n)
        result[i, i - 3 + k] = result[i - 3 + k, i] = band[3 - k :, k]
    return result
