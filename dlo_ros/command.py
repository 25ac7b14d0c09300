# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Imposed motion: the contents of a `dlo/command`, checked and sampled (no ROS here).

Stamps are integer nanoseconds as in ROS; times within a command are seconds from its start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dlo_ros.errors import CommandError
from dlo_ros.interpolation import sample, sample_positions
from dlo_ros.spline import FloatArray

START = "start"
END = "end"
CONTROL_POINT = "control_point_"
NANOSECONDS = 1_000_000_000
NORM = 0.1
"""Largest difference of a quaternion's norm from 1: rounding, and no other representation."""
UNIT = "a unit quaternion x, y, z, w is needed, (0, 0, 0, 1) where nothing is turned"
CLOSEST = NANOSECONDS // 1000
"""Commands that lie closer [ns] to the one before the last replace the last."""


@dataclass(frozen=True, eq=False)
class Command:
    """A trajectory of imposed positions and clamp frames.

    Numbers may be given as lists, and as arrays of any type.

    Args:
        stamp: start of the trajectory [ns]; 0 must have been replaced by the moment of receipt.
        names: names of the K imposed positions and directions: `start`, `end`, `control_point_1`
            ... `control_point_n`.
        times: seconds from the start, growing, shape (T,).
        positions: [m], shape (T, K, 3).
        rotations: unit quaternions x y z w, shape (T, K, 4); used for `start` and `end` only.
        velocities: [m/s], shape (T, K, 3), NaN where a point carries none.
        control_points: n of the published basis, which the names count in.
        frame_id: frame of the positions.
        path_before: distance that imposed points have travelled under the commands before [m].
        whole_path: distance that they travel in the whole motion [m]; None: in this command alone.
        began: stamp of the first observed shape [ns]; None: the start of the trajectory.

    Raises:
        CommandError: the command is malformed; the message says what and where.
    """

    stamp: int
    names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    rotations: FloatArray
    velocities: FloatArray
    control_points: int
    frame_id: str = "board"
    path_before: float = 0.0
    whole_path: float | None = None
    began: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        for key in _ARRAYS:
            object.__setattr__(self, key, _numbers(key, getattr(self, key)))
        check_names(self.names, self.control_points)
        points, count = self.times.size, len(self.names)
        if points == 0:
            raise CommandError("dlo/command has no points; give at least one")
        shapes = {
            "times": (self.times.shape, (points,)),
            "transforms": (self.positions.shape, (points, count, 3)),
            "rotations": (self.rotations.shape, (points, count, 4)),
            "velocities": (self.velocities.shape, (points, count, 3)),
        }
        for what, (found, expected) in shapes.items():
            if found != expected:
                raise CommandError(
                    f"dlo/command has {what} of shape {found}; its names and points need {expected}"
                )
        if not np.all(np.isfinite(self.times)):
            raise CommandError("dlo/command has a time that is not finite")
        if np.any(np.diff(self.times) <= 0.0):
            at = int(np.argmax(np.diff(self.times) <= 0.0)) + 1
            raise CommandError(
                f"dlo/command: time_from_start of point {at} is {self.times[at]:g} s, not after "
                f"the one before ({self.times[at - 1]:g} s); times must grow"
            )
        if not np.all(np.isfinite(self.positions)):
            raise CommandError("dlo/command has a position that is not finite (NaN or infinite)")
        if np.any(np.isinf(self.velocities)):
            raise CommandError("dlo/command has a velocity that is infinite")
        for k, name in enumerate(self.names):
            if name in (START, END):
                norms = np.linalg.norm(self.rotations[:, k], axis=-1)
                wrong = ~(np.abs(norms - 1.0) < NORM)
                if wrong.any():
                    at = int(np.argmax(wrong))
                    raise CommandError(
                        f"dlo/command: the rotation of '{name}' at point {at} has norm "
                        f"{norms[at]:.3g}; {UNIT}"
                    )

    def sample(self, stamp: int) -> tuple[FloatArray, FloatArray]:
        """Imposed values at a stamp [ns].

        Returns:
            Positions [m], shape (K, 3), and unit quaternions x y z w, shape (K, 4).
        """
        position, rotation = np.empty((len(self.names), 3)), np.empty((len(self.names), 4))
        time = (stamp - self.stamp) / NANOSECONDS
        sample(
            self.times, self.positions, self.rotations, self.velocities, time, position, rotation
        )
        return position, rotation

    def positions_at(self, times: FloatArray) -> FloatArray:
        """Imposed positions [m] at times [s] from the start, shape (S, K, 3)."""
        result = np.empty((len(times), len(self.names), 3))
        sample_positions(self.times, self.positions, self.rotations, self.velocities, times, result)
        return result

    def led_through(
        self, *, positions: FloatArray | None = None, rotations: FloatArray | None = None
    ) -> Command:
        """The command with other poses, which are not checked: as many, finite, of unit norm.

        Args:
            positions, rotations: see the class; default: as they are.
        """
        given = {key: self.__dict__[key] for key in _FIELDS}
        twin = object.__new__(Command)
        twin.__dict__.update(given)
        for key, value in (("positions", positions), ("rotations", rotations)):
            if value is not None:
                twin.__dict__[key] = value
        return twin

    def turning_at_most(self, angle: float) -> Command:
        """The motion with so many points that no clamp turns further between two of them.

        Args:
            angle: [rad].
        """
        q = self.clamp_rotations
        cosine = np.einsum("tkc,tkc->tk", q[1:], q[:-1])
        turned = 2.0 * np.arccos(np.minimum(cosine, 1.0)).max(axis=1, initial=0.0)
        parts = np.maximum(np.ceil(turned / angle - 1e-6), 1.0).astype(int)
        if parts.sum() == len(parts):
            return self
        a = np.repeat(np.arange(len(parts)), parts)
        first = np.cumsum(parts) - parts
        s = (np.arange(len(a)) - first[a]) / parts[a]
        times = np.append(self.times[a] + s * np.diff(self.times)[a], self.times[-1])
        positions = np.empty((len(times), *self.positions.shape[1:]))
        rotations = np.empty((len(times), *self.rotations.shape[1:]))
        for k, time in enumerate(times):
            sample(
                self.times, self.positions, self.rotations, self.velocities, time, positions[k],
                rotations[k],
            )  # fmt: skip
        h, s = np.diff(self.times)[a, None, None], s[:, None, None]
        v0, v1 = self.velocities[a], self.velocities[a + 1]
        slope = 6.0 * s * (1.0 - s) * (self.positions[a + 1] - self.positions[a]) / h
        slope += (1.0 - s) * (1.0 - 3.0 * s) * v0 + s * (3.0 * s - 2.0) * v1
        velocities = np.concatenate([slope, self.velocities[-1:]])
        velocities[first] = self.velocities[:-1]
        return replace(
            self, times=times, positions=positions, rotations=rotations, velocities=velocities
        )

    def later(self, seconds: float) -> Command:
        """The command with a delay [s]."""
        if not seconds:
            return self
        return replace(self, stamp=self.stamp + round(seconds * NANOSECONDS))

    def held(self, end: str, control_points: int) -> int | None:
        """Index of what imposes the place of an end, `start` or `end`; None: it is free.

        Args:
            control_points: number of those of the DLO, the outer of which may be imposed instead.
        """
        tip = f"{CONTROL_POINT}{1 if end == START else control_points}"
        name = next((n for n in (end, tip) if n in self.names), None)
        return None if name is None else self.names.index(name)

    @cached_property
    def off_plane(self) -> float:
        """Largest distance of an imposed position from the plane y = 0 [m]."""
        return float(np.abs(self.positions[:, :, 1]).max(initial=0.0))

    @cached_property
    def turns_in_plane(self) -> bool:
        """Whether all clamps keep their y axis along that of the board frame."""
        turned = [k for k, name in enumerate(self.names) if name in (START, END)]
        return bool(np.abs(self.rotations[:, turned][:, :, [0, 2]]).max(initial=0.0) < 1e-9)

    @cached_property
    def path(self) -> FloatArray:
        """Distance that all imposed points together have travelled [m], shape (T,)."""
        moved = np.linalg.norm(np.diff(self.positions, axis=0), axis=2).sum(axis=1)
        return np.concatenate([[0.0], np.cumsum(moved)])

    def corners(self, size: float, reach: float, spreading: float | None = None) -> FloatArray:
        """Times [s] at which the motion bends so sharply that it is no smooth one.

        Args:
            size: distance of a polyline from the smooth curve through its points [m] up to which
                their kinks are no corners.
            reach: distance from a clamp at which its direction counts [m].
            spreading: a turn of a clamp bends the DLO within a time t no farther from it than the
                root of this times t [m^2/s]; None: at once all of it.
        """
        moved, turned, shorter = self._kinks
        near = reach if spreading is None else np.minimum(reach, np.sqrt(spreading * shorter))
        corners: FloatArray = self.times[(moved > size) | (near * turned > size)]
        return corners

    @cached_property
    def _kinks(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The kink at each point, shape (T,).

        That is its distances from a smooth motion, in m and rad, and the time to the nearer one of
        its neighbours [s].
        """
        h = np.diff(self.times)
        slope = np.diff(self.positions, axis=0) / h[:, None, None]
        given = np.isfinite(self.velocities[1:] + self.velocities[:-1])
        smooth = given.all(axis=2, keepdims=True)
        arriving = np.where(smooth, self.velocities[1:], slope)
        leaving = np.where(smooth, self.velocities[:-1], slope)
        turning = 2.0 * np.diff(self.clamp_rotations, axis=0) / h[:, None, None]
        shorter = np.minimum(np.append(h, np.inf), np.append(np.inf, h))
        shorter[np.isinf(shorter)] = 0.0  # there is one point alone
        moved, turned = _jumps(arriving, leaving), _jumps(turning, turning)
        return moved * shorter / 8.0, turned * shorter / 8.0, shorter

    @property
    def clamp_rotations(self) -> FloatArray:
        """Unit quaternions of the clamps without jumps of their signs, shape (T, C, 4)."""
        clamps = [k for k, name in enumerate(self.names) if name in (START, END)]
        q: FloatArray = self.rotations[:, clamps]
        q = q / np.linalg.norm(q, axis=2, keepdims=True)
        back = np.einsum("tkc,tkc->tk", q[1:], q[:-1]) < 0.0
        q[1:] *= np.cumprod(np.where(back, -1.0, 1.0), axis=0)[..., None]
        return q

    @property
    def progress(self) -> FloatArray:
        """Share of `whole_path`, and of the commands' before, that is travelled, shape (T,)."""
        whole = float(self.path[-1]) if self.whole_path is None else self.whole_path
        path: FloatArray = self.path_before + self.path
        return path / whole if whole > 0.0 else 0.0 * path

    @property
    def began_at(self) -> float:
        """Instant of the first observed shape [s] from the start of the trajectory."""
        return 0.0 if self.began is None else (self.began - self.stamp) / NANOSECONDS

    @property
    def end_stamp(self) -> int:
        """Stamp [ns] after which the values hold."""
        return self.stamp + round(float(self.times[-1]) * NANOSECONDS)


def _jumps(arriving: FloatArray, leaving: FloatArray) -> FloatArray:
    """Largest jump of a velocity at each of T points, before and after which all rests, shape (T,).

    Args:
        arriving, leaving: velocities at the end and the beginning of each of the ways between,
            shape (T - 1, K, ...).
    """
    none = np.zeros((1, *leaving.shape[1:]))
    jump = np.concatenate([leaving, none]) - np.concatenate([none, arriving])
    largest: FloatArray = np.linalg.norm(jump, axis=2).max(axis=1, initial=0.0)
    return largest


def _numbers(key: str, values: ArrayLike) -> FloatArray:
    """An array as compiled code takes it: for one of another type or layout it is compiled anew.

    Raises:
        CommandError: the values are no numbers, or rows of them have different lengths.
    """
    try:
        return np.require(values, np.float64, ("C", "W"))
    except (TypeError, ValueError) as err:
        raise CommandError(f"dlo/command has {key} that are no array of numbers") from err


_FIELDS = tuple(f.name for f in fields(Command))
_ARRAYS = ("times", "positions", "rotations", "velocities")


@dataclass
class Motion:
    """The commands received so far; a new one replaces the old from its start on."""

    commands: list[Command] = field(default_factory=list)

    def add(self, command: Command) -> None:
        """Take a command; those that would start at or after it are dropped.

        Of a storm of commands, one in a millisecond is kept: the others held for no time.
        """
        kept = self.commands
        if kept and kept[-1].stamp >= command.stamp:
            kept = [c for c in kept if c.stamp < command.stamp]
        if len(kept) > 1 and command.stamp - kept[-2].stamp < CLOSEST:
            kept = kept[:-1]
        self.commands = [*kept, command]

    def at(self, stamp: int) -> Command | None:
        """The command that holds at a stamp [ns]; before the first, the first."""
        if not self.commands:
            return None
        # From the end, where the present is: a robot may have sent thousands.
        return next((c for c in reversed(self.commands) if c.stamp <= stamp), self.commands[0])

    def paths(self) -> list[float]:
        """Distances that imposed points have travelled before each command, and in all [m]."""
        result = [0.0]
        for k, command in enumerate(self.commands):
            path = float(command.path[-1])
            if k + 1 < len(self.commands):  # until it is replaced
                after = (self.commands[k + 1].stamp - command.stamp) / NANOSECONDS
                path = float(np.interp(after, command.times, command.path))
            result.append(result[-1] + path)
        return result


def check_names(names: Sequence[str], control_points: int) -> None:
    """Check what a command imposes against the rules of the interface.

    Raises:
        CommandError: unknown or doubled names, two names for one control point, or a second
            control point without its end.
    """
    if not names:
        raise CommandError("dlo/command names nothing; give joint_names such as 'start'")
    n = control_points
    owner: dict[int, str] = {}
    for name in names:
        points: tuple[int, ...]
        if name == START:
            points = (1, 2)
        elif name == END:
            points = (n - 1, n)
        else:
            digits = name.removeprefix(CONTROL_POINT)
            known = name.startswith(CONTROL_POINT) and digits.isascii() and digits.isdigit()
            # A canonical number only: 'control_point_01' is no name of the interface.
            if not known or digits != str(int(digits[:9])) or not 1 <= int(digits) <= n:
                raise CommandError(
                    f"dlo/command names '{name[:60]}'; known are start, end and "
                    f"control_point_1 to control_point_{n}"
                )
            points = (int(digits),)
        for point in points:
            if point in owner:
                raise CommandError(
                    f"dlo/command: '{owner[point]}' and '{name}' both impose control point {point}"
                )
            owner[point] = name
    for inner, outer in ((2, 1), (n - 1, n)):
        if inner in owner and outer not in owner:
            raise CommandError(
                f"dlo/command imposes control_point_{inner} without control_point_{outer}; "
                "together they give the direction of the end"
            )
