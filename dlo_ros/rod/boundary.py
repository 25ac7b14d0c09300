"""Imposed motion in the simulation's own basis: which degrees of freedom are held, and where."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dlo_ros.command import CONTROL_POINT, END, START, Command
from dlo_ros.errors import CommandError
from dlo_ros.rod.frames import rotation_matrix
from dlo_ros.rod.kernels import DOF
from dlo_ros.spline import FloatArray, SplineBasis


@dataclass(frozen=True)
class Held:
    """What is held at one instant.

    Args:
        values: values of the fixed degrees of freedom, zero elsewhere, shape (n, 4); theta is left
            to the clamps' rotations.
        pin_positions: positions of the pinned points [m], shape (k, 3).
        rotations: matrices of the clamps by end, `start` and `end`.
        directions: tangents by end where a direction is imposed, shape (3,).
    """

    values: FloatArray
    pin_positions: FloatArray
    rotations: dict[str, FloatArray]
    directions: dict[str, FloatArray]


@dataclass(frozen=True)
class Boundary:
    """Which degrees of freedom a command holds (interface.md, end).

    Args:
        names: what the command imposes.
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
        """Which degrees of freedom are imposed, shape (4 n,)."""
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

    @cached_property
    def pins(self) -> FloatArray:
        """Constraint rows of the pins in the free degrees of freedom, shape (3 k, 4 n)."""
        rows = self._pin_rows.copy()
        rows[:, self.fixed] = 0.0
        return rows

    @cached_property
    def _pin_rows(self) -> FloatArray:
        n, count = self.basis.control_points, len(self._pins)
        rows = np.zeros((count, 3, n, DOF))
        if count:
            b = self.basis.matrix(self.pin_abscissae)
            for c in range(3):
                rows[:, c, :, c] = b
        return rows.reshape(3 * count, n * DOF)

    def pin_values(self, held: Held, target: FloatArray) -> FloatArray:
        """What `pins @ q` must be, given the fixed values in target (n, 4); shape (3 k,)."""
        share = np.where(self.fixed, target.ravel(), 0.0)
        result: FloatArray = held.pin_positions.ravel() - self._pin_rows @ share
        return result

    def held(self, command: Command, stamp: int) -> Held:
        """Imposed values at a stamp [ns].

        Raises:
            CommandError: the two control points of an end coincide, so that it has no direction.
        """
        positions, quaternions = command.sample(stamp)
        at = dict(zip(self.names, positions, strict=True))
        n, last = self.basis.control_points, self.published.control_points
        values = np.zeros((n, DOF))
        rotations: dict[str, FloatArray] = {}
        directions: dict[str, FloatArray] = {}
        reach = self.basis.span_length / 3.0  # |r'| = 1 at a clamp
        ends = (
            (START, 0, 1, 1.0, f"{CONTROL_POINT}1", f"{CONTROL_POINT}2"),
            (END, n - 1, n - 2, -1.0, f"{CONTROL_POINT}{last}", f"{CONTROL_POINT}{last - 1}"),
        )
        for name, outer, inner, sign, tip, second in ends:
            if name in at:
                rotations[name] = rotation_matrix(quaternions[self.names.index(name)])
                values[outer, :3] = at[name]
                directions[name] = rotations[name][:, 0]
            elif tip in at:
                values[outer, :3] = at[tip]
                if second in at:
                    chord = sign * (at[second] - at[tip])
                    size = float(np.linalg.norm(chord))
                    if size < 1e-9 * self.basis.length:
                        raise CommandError(
                            f"dlo/command: {tip} and {second} coincide; they must give a direction"
                        )
                    directions[name] = chord / size
            if name in directions:
                values[inner, :3] = values[outer, :3] + sign * reach * directions[name]
        pins = np.array([at[name] for name in self._pins]).reshape(-1, 3)
        return Held(values, pins, rotations, directions)
