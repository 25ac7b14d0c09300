# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Imposed motion in the simulation's own basis: held degrees of freedom and their values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, NANOSECONDS, START, Command
from dlo_ros.errors import CommandError
from dlo_ros.rod.boundary import conditions
from dlo_ros.rod.elements.rod_tables import DOF
from dlo_ros.spline import FloatArray, SplineBasis

KEPT = 64
"""Boundary conditions that are kept: those of some recordings, each with several bases."""
NO_DIRECTION_TEXT = "dlo/command: two control points that give the direction of an end coincide"


@dataclass(frozen=True)
class Held:
    """Imposed values at one instant.

    Args:
        target: values of the fixed degrees of freedom, zero elsewhere, shape (n, 4).
        pins: positions of the pinned points [m], shape (k, 3).
        frames: frames of both ends, carried to that instant, shape (2, FRAME).
    """

    target: FloatArray
    pins: FloatArray
    frames: FloatArray


@dataclass(frozen=True)
class Boundary:
    """The degrees of freedom that a command holds (interface.md, end).

    Args:
        names: names of what the command imposes.
        basis: the simulation's basis.
        published: the basis that the names count in, same length.
    """

    names: tuple[str, ...]
    basis: SplineBasis
    published: SplineBasis

    @property
    def clamped_start(self) -> bool:
        """Whether the direction at u = 0 is imposed."""
        return START in self.names or f"{CONTROL_POINT}2" in self.names

    @property
    def clamped_end(self) -> bool:
        """Whether the direction at u = L is imposed."""
        last = self.published.control_points
        return END in self.names or f"{CONTROL_POINT}{last - 1}" in self.names

    @cached_property
    def fixed(self) -> np.ndarray:
        """Whether each degree of freedom is imposed, shape (4 n,)."""
        n = self.basis.control_points
        mask = np.zeros((n, DOF), dtype=np.bool_)
        last = self.published.control_points
        mask[0, :3] = START in self.names or f"{CONTROL_POINT}1" in self.names
        mask[n - 1, :3] = END in self.names or f"{CONTROL_POINT}{last}" in self.names
        mask[1, :3] |= self.clamped_start
        mask[n - 2, :3] |= self.clamped_end
        mask[0, 3] = self.clamped_start
        mask[n - 1, 3] = self.clamped_end
        if not mask[:, 3].any():
            mask[0, 3] = True  # nothing holds the twist: keep the rod from spinning about itself
        return mask.ravel()

    @cached_property
    def pin_abscissae(self) -> FloatArray:
        """Material coordinates of the pinned points [m], shape (k,)."""
        return np.array([self.published.greville[k] for k in self._pins.values()])

    @cached_property
    def _pins(self) -> dict[str, int]:
        last = self.published.control_points
        inner = {}
        for name in self.names:
            if name not in (START, END):
                number = int(name.removeprefix(CONTROL_POINT))
                if number not in (1, 2, last - 1, last):
                    inner[name] = number - 1
        return inner

    @property
    def pinned(self) -> tuple[str, ...]:
        """Names of the pinned points, in the order of `pin_abscissae`."""
        return tuple(self._pins)

    @cached_property
    def pins(self) -> FloatArray:
        """Constraint rows of the pins in the free degrees of freedom, shape (3 k, 4 n)."""
        rows = self.pin_rows.copy()
        rows[:, self.fixed] = 0.0
        return rows

    @cached_property
    def pin_rows(self) -> FloatArray:
        """Rows of the pinned coordinates in all degrees of freedom, shape (3 k, 4 n)."""
        n, count = self.basis.control_points, len(self._pins)
        rows = np.zeros((count, 3, n, DOF))
        if count:
            b = self.basis.matrix(self.pin_abscissae)
            for c in range(3):
                rows[:, c, :, c] = b
        return rows.reshape(3 * count, n * DOF)

    @cached_property
    def held_points(self) -> tuple[tuple[float, bool, int], ...]:
        """Places that are held: material coordinate [m], whether pinned, number of the pin or end.

        They are in the order of the DLO; ends have the numbers 0 and -1.
        """
        fixed = self.fixed.reshape(-1, DOF)
        points = [(float(self.basis.greville[k]), False, k) for k in (0, -1) if fixed[k, 0]]
        points += [(float(u), True, k) for k, u in enumerate(self.pin_abscissae)]
        return tuple(sorted(points))

    @cached_property
    def holding(self) -> tuple[str, ...]:
        """Names of what holds each of `held_points`."""
        last = self.published.control_points
        tips = {0: {START, f"{CONTROL_POINT}1"}, -1: {END, f"{CONTROL_POINT}{last}"}}
        return tuple(
            self.pinned[k] if pinned else next(n for n in self.names if n in tips[k])
            for _, pinned, k in self.held_points
        )

    def pins_of(self, q: FloatArray) -> FloatArray:
        """Positions of the pinned points of a configuration (n, 4) [m], shape (k, 3)."""
        if not len(self.pin_rows):
            return np.zeros((0, 3))
        return np.asarray(self.pin_rows @ q.ravel()).reshape(-1, 3)

    def pin_values(self, held: Held) -> FloatArray:
        """Values that `pins @ q` must have, given the fixed values, shape (3 k,)."""
        share = np.where(self.fixed, held.target.ravel(), 0.0)
        result: FloatArray = held.pins.ravel() - self.pin_rows @ share
        return result

    @cached_property
    def kinds(self) -> np.ndarray:
        """Kind of each imposed point, as numbered for compiled code in `boundary.conditions`."""
        last = self.published.control_points
        codes = {
            START: conditions.START_CLAMP,
            END: conditions.END_CLAMP,
            f"{CONTROL_POINT}1": conditions.START_TIP,
            f"{CONTROL_POINT}2": conditions.START_SECOND,
            f"{CONTROL_POINT}{last}": conditions.END_TIP,
            f"{CONTROL_POINT}{last - 1}": conditions.END_SECOND,
        }
        return np.array([codes.get(name, conditions.PIN) for name in self.names], dtype=np.int64)

    def imposed(self, command: Command) -> conditions.Imposed:
        """A command for compiled code."""
        return conditions.Imposed(
            command.times, command.positions, command.rotations, command.velocities, self.kinds,
            np.zeros(len(command.times)), conditions.NO_STEP.copy(),
        )  # fmt: skip

    @property
    def reach(self) -> float:
        """Distance of the second control point from a clamped end [m]: |r'| = 1 there."""
        return float(self.basis.breaks[1]) / 3.0

    def held(
        self, command: Command, stamp: int, theta: FloatArray, frames: FloatArray,
        lengthening: float = 1.0,
    ) -> Held:  # fmt: skip
        """Imposed values at a stamp [ns].

        Args:
            theta: twist angles at both ends now [rad], shape (2,).
            frames: frames of both ends now, shape (2, FRAME).
            lengthening: true length over that of the basis.

        Raises:
            CommandError: the two control points of an end coincide, so that it has no direction.
        """
        target = np.zeros((self.basis.control_points, DOF))
        pins = np.empty((len(self._pins), 3))
        frames = frames.copy()
        time = (stamp - command.stamp) / NANOSECONDS
        reach = self.reach * lengthening
        if not conditions.impose(self.imposed(command), time, theta, reach, frames, target, pins):
            raise CommandError(NO_DIRECTION_TEXT)
        return Held(np.where(self.fixed.reshape(-1, DOF), target, 0.0), pins, frames)


@lru_cache(maxsize=KEPT)
def boundary_of(names: tuple[str, ...], basis: SplineBasis, published: SplineBasis) -> Boundary:
    """The boundary conditions of what a command names, kept; see `Boundary`."""
    return Boundary(names, basis, published)
