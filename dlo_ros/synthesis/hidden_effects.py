# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that a simulated experiment hides: their names and values, checked.

They are given as in a parameter file: `effects.NAME.KEY`, by the names and units of the interface.
`hidden_rod` puts those that act on the rope into the discrete rod, `true_motion` those that act on
its motion; those of the camera are here. Nothing is shared with the model that is to find them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.parameters import CameraPose
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.experiment_block import ExperimentBlock

Values = Mapping[str, float | tuple[float, ...]]
Effects = Mapping[str, Values]

PI = float(np.pi)
ENDS = ("start", "end")
NORMAL = np.array([0.0, 1.0, 0.0])  # of the board's plane


@dataclass(frozen=True)
class Key:
    """One number of an effect.

    Args:
        unit: SI unit.
        lower, upper: range, both ends allowed.
        default: value where the file gives none; None means that it must be given.
        listed: whether a list of numbers is allowed as well.
        counts: allowed numbers of values in a list, zeros by default; 1 stands for a number by
            itself; empty: one number.
    """

    unit: str
    lower: float
    upper: float
    default: float | None = None
    listed: bool = False
    counts: tuple[int, ...] = ()


ONE_OR_TURN = (1, 3)
"""An angle about +y, or a rotation vector about x, y and z."""

EFFECTS: Mapping[str, Mapping[str, Key]] = {
    "intrinsic_curvature": {
        "curvature": Key("1/m", -1e3, 1e3, 0.0, listed=True),
        "kink": Key("rad", -PI, PI, 0.0),
        "position": Key("m", 0.0, 1e2, 0.0),
        "across": Key("1/m", -1e3, 1e3, 0.0, listed=True),
    },
    "anisotropy": {"ratio": Key("", 1e-3, 1e3), "angle": Key("rad", -PI, PI, 0.0)},
    "twisting_stiffness": {"ratio": Key("", 1e-3, 1e3)},
    "clamp_angle": {
        "start": Key("rad", -PI, PI, 0.0, counts=ONE_OR_TURN),
        "end": Key("rad", -PI, PI, 0.0, counts=ONE_OR_TURN),
    },
    "clamp_offset": {
        "start": Key("m", -1e2, 1e2, 0.0, counts=(2, 3)),
        "end": Key("m", -1e2, 1e2, 0.0, counts=(2, 3)),
    },
    "grip_offset": {
        "start": Key("m", -1e2, 1e2, 0.0, counts=(2, 3)),
        "end": Key("m", -1e2, 1e2, 0.0, counts=(2, 3)),
    },
    "grip_angle": {
        "start": Key("rad", -PI, PI, 0.0, counts=(2,)),
        "end": Key("rad", -PI, PI, 0.0, counts=(2,)),
    },
    "clamp_compliance": {
        "start": Key("rad/(N m)", 0.0, 1e6, 0.0),
        "end": Key("rad/(N m)", 0.0, 1e6, 0.0),
    },
    "gravity_tilt": {"angle": Key("rad", -PI, PI, 0.0), "across": Key("rad", -PI, PI, 0.0)},
    "point_mass": {"mass": Key("kg", 0.0, 1e3), "position": Key("m", 0.0, 1e2)},
    "connector": {"mass": Key("kg", 0.0, 1e3), "extent": Key("m", 0.0, 1e2)},
    "stiff_segment": {
        "centre": Key("m", 0.0, 1e2),
        "extent": Key("m", 0.0, 1e2),
        "ratio": Key("", 1e-2, 1e3),
        "taper": Key("", 0.0, 1.0, 0.0),
    },
    "stiffness_gradient": {"change": Key("", -1.99, 1.99)},
    "nonlinear_stiffness": {"half_curvature": Key("1/m", 1e-2, 1e6)},
    "plasticity": {
        "yield_curvature": Key("1/m", 0.0, 1e6),
        "hardening": Key("", 0.0, 1.0),
    },
    "hysteresis": {"moment": Key("N m", 0.0, 1e3), "curvature": Key("1/m", 1e-6, 1e6)},
    "viscoelasticity": {"share": Key("", 0.0, 0.95), "time": Key("s", 1e-4, 1e6)},
    "surface_friction": {"force": Key("N/m", 0.0, 1e3)},
    "air_drag": {"coefficient": Key("N s/m^2", -1e3, 1e3)},
    "quadratic_drag": {"coefficient": Key("N s^2/m^3", 0.0, 1e4)},
    "internal_damping": {"relaxation_time": Key("s", -10.0, 10.0)},
    "command_delay": {"delay": Key("s", -10.0, 10.0)},
    "clamp_slip": {
        "length": Key("m", -1e2, 1e2),
        "onset": Key("s", -1.0, 1e4, -1.0),
        "duration": Key("s", 1e-2, 1e4, 0.1),
    },
    "length_error": {"difference": Key("m", -1e2, 1e2)},
    "camera_scale": {"ratio": Key("", 0.1, 10.0)},
    "camera_rotation": {"angle": Key("rad", -PI, PI, counts=ONE_OR_TURN)},
    "camera_shift": {axis: Key("m", -1e2, 1e2, 0.0) for axis in "xyz"},
    "obstacle": {
        "x": Key("m", -1e2, 1e2),
        "z": Key("m", -1e2, 1e2),
        "radius": Key("m", 1e-4, 1e2),
    },
    "wall": {"offset": Key("m", -1e2, 1e2), "angle": Key("rad", -PI, PI, 0.0)},
    "constant_force": {axis: Key("N/m", -1e3, 1e3, 0.0) for axis in "xyz"},
}
"""The table "Names of effects" of the interface."""

FOREIGN: Mapping[str, Mapping[str, Key]] = {
    "gusts": {
        "force": Key("N/m", 0.0, 1e3),
        "correlation_time": Key("s", 1e-3, 1e3, 0.2),
        "seed": Key("", 0.0, 2.0**31, 0.0),
    },
    "stiffness_drift": {"rate": Key("1/s", -10.0, 10.0)},
    "camera_creep": {
        "x": Key("m/s", -10.0, 10.0, 0.0),
        "z": Key("m/s", -10.0, 10.0, 0.0),
        "angle": Key("rad/s", -10.0, 10.0, 0.0),
    },
}
"""Effects that the interface has no name for; the block `foreign` of an experiment holds them."""


def read_effects(
    tree: Any, where: str, table: Mapping[str, Mapping[str, Key]] = EFFECTS
) -> Effects:
    """Check a block of effects.

    Args:
        tree: content of the block as YAML gives it: effect, key, number.
        where: names of the file and the block, for error messages.
        table: allowed keys of each allowed effect.

    Returns:
        All keys of the effects that are named, those not given with their defaults.

    Raises:
        InputError: an unknown name or key, a missing or an unusable value.
    """
    section = ExperimentBlock(tree, where)
    result: dict[str, Values] = {}
    for name in section.names:
        if name not in table:
            raise InputError(f"{where}: '{name}' is no effect; known are {', '.join(table)}")
        block = section.block(name)
        values: dict[str, float | tuple[float, ...]] = {}
        for key, rule in table[name].items():
            if rule.default is None:
                block.required(key, f"a number [{rule.unit}]")
            value = block.raw(key, rule.default)
            if rule.counts and value == 0.0:
                values[key] = 0.0 if 1 in rule.counts else (0.0,) * rule.counts[0]
            elif rule.counts and not (1 in rule.counts and not isinstance(value, (list, tuple))):
                size = len(value) if isinstance(value, (list, tuple)) else 0
                if size not in rule.counts:
                    counts = " or ".join(str(n) for n in rule.counts)
                    raise InputError(f"{block.where}: {key} is {value}; give {counts} numbers")
                values[key] = block.check_all(value, key, size, rule.lower, rule.upper)
            elif rule.listed and isinstance(value, (list, tuple)):
                size = max(len(value), 1)
                values[key] = block.check_all(value, key, size, rule.lower, rule.upper)
            else:
                values[key] = block.check(value, key, rule.lower, rule.upper)
        if not block.names:
            raise InputError(f"{block.where} is empty; give {', '.join(table[name])}")
        block.finish()
        result[name] = values
    return result


@dataclass(frozen=True)
class HiddenEffects:
    """The effects that an experiment hides.

    Args:
        effects: hidden effects that the interface names.
        foreign: hidden effects that the interface does not name.
    """

    effects: Effects = field(default_factory=dict)
    foreign: Effects = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        return name in self.effects or name in self.foreign

    def number(self, name: str, key: str, neutral: float = 0.0) -> float:
        """A value, or the neutral one where the effect is absent."""
        value = (self.effects.get(name) or self.foreign.get(name) or {}).get(key, neutral)
        if isinstance(value, tuple):
            raise InputError(f"effects.{name}.{key} is a list; give one number")
        return value

    def vector(self, name: str, key: str) -> FloatArray:
        """An offset x, y, z, of which x and z may have been given alone, shape (3,)."""
        given = self.effects.get(name, {}).get(key, (0.0, 0.0))
        values = np.array(given, dtype=np.float64)
        return values if len(values) == 3 else np.array([values[0], 0.0, values[1]])

    def in_hand(self, name: str, key: str, hand: FloatArray) -> FloatArray:
        """An offset in a hand that holds the rope, in the board's frame [m], shape (3,).

        Three numbers are along the hand's x, y and z; two along the rope and across it in the
        board's plane, however the hand is rolled about the rope.

        Args:
            hand: rotation matrix of the hand, shape (3, 3).
        """
        given = np.array(self.effects.get(name, {}).get(key, (0.0, 0.0)), dtype=np.float64)
        if len(given) == 3:
            return np.asarray(hand @ given)
        return np.asarray(given[0] * hand[:, 0] + given[1] * np.cross(hand[:, 0], NORMAL))

    def turn(self, name: str, key: str) -> FloatArray:
        """A rotation vector about x, y, z [rad], of which y may have been given alone, (3,)."""
        given = np.atleast_1d(self.effects.get(name, {}).get(key, 0.0))
        return np.array(given) if len(given) == 3 else np.array([0.0, given[0], 0.0])

    def tilt(self, name: str, key: str) -> FloatArray:
        """A rotation vector [rad] of which y and z have been given, shape (3,)."""
        return np.array([0.0, *np.broadcast_to(self.effects.get(name, {}).get(key, 0.0), 2)])

    @property
    def sideways(self) -> bool:
        """Whether something makes a rope that moves in the plane y = 0 leave it."""
        turns = [self.turn("clamp_angle", end)[[0, 2]] for end in ENDS]
        turns += [self.tilt("grip_angle", end)[2:] for end in ENDS]
        offsets = [
            self.vector(name, end)[1:2] for name in ("clamp_offset", "grip_offset") for end in ENDS
        ]
        others = [
            np.atleast_1d(self.effects.get(name, {}).get(key, 0.0))
            for name, key in (
                ("constant_force", "y"),
                ("gravity_tilt", "across"),
                ("intrinsic_curvature", "across"),
                ("anisotropy", "angle"),
            )
        ]
        return bool(np.any(np.concatenate([*turns, *offsets, *others]) != 0.0))

    def gravity(self, gravity: FloatArray) -> FloatArray:
        """Gravity x, y, z [m/s^2], shape (3,), as it really is."""
        turn = np.array([self.number("gravity_tilt", "across"), 0.0, 0.0])
        turn[1] = self.number("gravity_tilt", "angle")
        return np.asarray(Rotation.from_rotvec(turn).apply(gravity))

    def measured(self, points: FloatArray, time: float = 0.0) -> FloatArray:
        """Positions of points as the camera measures them.

        Args:
            points: true ones in the board frame [m], shape (m, 3).
            time: time since the start of the recording [s].
        """
        rotation = Rotation.from_rotvec(self.turn("camera_rotation", "angle"))
        creep = time * self.number("camera_creep", "angle")
        result = (Rotation.from_rotvec([0.0, creep, 0.0]) * rotation).apply(points)
        result /= self.number("camera_scale", "ratio", 1.0)
        for axis, key in enumerate("xyz"):
            result[:, axis] += self.number("camera_shift", key)
            result[:, axis] += time * self.number("camera_creep", key)
        return np.asarray(result)

    def camera(self, stated: CameraPose) -> CameraPose:
        """The true pose of a camera that is believed to stand at another.

        A point X is taken for the point M X that projects to the same pixel under the stated pose
        (R, t). With M a rotation Q, the factor 1 / s and a shift d that is R (Q X / s + d) + t,
        which a camera at (R Q, s (R d + t)) sees at the same pixel.
        """
        turn = self.turn("camera_rotation", "angle")
        scale = self.number("camera_scale", "ratio", 1.0)
        shift = np.array([self.number("camera_shift", axis) for axis in "xyz"])
        if not turn.any() and scale == 1.0 and not shift.any():
            return stated
        pose = Rotation.from_quat(stated.rotation)
        rotation = pose * Rotation.from_rotvec(turn)
        x, y, z, w = (float(v) for v in rotation.as_quat())
        tx, ty, tz = (float(v) for v in scale * (pose.apply(shift) + stated.translation))
        return CameraPose(translation=(tx, ty, tz), rotation=(x, y, z, w))
