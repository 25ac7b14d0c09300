# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters that have sensitivities, and the variants of the rod that these need.

A parameter is named as in the parameter file: `young_modulus`, `density`, `air_drag`,
`relaxation_time`, `gravity`, `length`, `twist_rest`; the pose of a clamp, `start.x`, `start.z`,
`start.angle`, `end.x` ...; and any number of an effect that the settings contain,
`effects.NAME.KEY` or, where it has several values, `effects.NAME.KEY[i]`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dlo_ros.command import Command
from dlo_ros.effects import effects, quantities
from dlo_ros.effects.base import ROD
from dlo_ros.effects.measurement.length_error import LengthError
from dlo_ros.effects.physics.clamp_angle import ClampAngle
from dlo_ros.effects.physics.clamp_offset import ClampOffset
from dlo_ros.errors import InputError
from dlo_ros.rod.boundary import conditions
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.elements.rod_tables import ConstitutiveLaw, Stiffness, Surroundings
from dlo_ros.rod.model import CONTACT_PENETRATION, RodModel
from dlo_ros.rod.packing import imposed_of, parts_of, stacked, stacked_imposed, true_command
from dlo_ros.rod.parameter_names import acts_on, acts_on_measurement, parsed
from dlo_ros.rod.sensitivity.prepared_rod import PreparedRod, prepare
from dlo_ros.rod.sensitivity.sensitivity_state import (
    INELASTIC,
    LINEAR,
    SLIPPING,
    Rates,
    SensitivityState,
)
from dlo_ros.rod.solve.equation_system import System
from dlo_ros.rod_settings import EFFECTS_PREFIX, RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

MATERIAL = ("young_modulus", "density", "air_drag", "relaxation_time")
# By their natural logarithm.
LOGARITHMIC = (*MATERIAL, "gravity", "length")
POSES = tuple(f"{end}.{what}" for end in ("start", "end") for what in ("x", "z", "angle"))
KEPT = 8  # compiled rods of one model
STEP = 1e-5  # in the logarithm, or of a parameter's natural size
CONTACT_STEP = 1e-3 * CONTACT_PENETRATION
"""Step of the place of a body that the DLO may touch, over L. A wider step would leave a contact,
or enter it from afar, with a force that the sensitivities of the shape do not feel."""


@dataclass(frozen=True)
class ParameterVariation:
    """One parameter whose sensitivities are wanted, and how it is varied.

    Args:
        name: see above.
        step: half the distance of its two variants, in its own unit (or of the logarithm).
        vary: settings and command with the parameter changed by an amount in that unit.
        natural: natural size of the parameter, in that unit.
    """

    name: str
    step: float
    vary: Callable[[RodSettings, Command, float], tuple[RodSettings, Command]]
    natural: float = 1.0


def known(settings: RodSettings) -> tuple[str, ...]:
    """All names of parameters that have sensitivities with these settings."""
    names = [*LOGARITHMIC, *POSES]
    for effect, keys in settings.effects.items():
        for key, value in keys.items():
            names += effect_names(effect, key, value)
    return tuple(names)


def is_known(settings: RodSettings, name: str) -> bool:
    """Whether a name is one of `known`."""
    if not name.startswith(EFFECTS_PREFIX):
        return name in LOGARITHMIC or name in POSES
    effect, _, key = name.removeprefix(EFFECTS_PREFIX).partition(".")
    key = key.partition("[")[0]
    value = settings.effects.get(effect, {}).get(key)
    return value is not None and name in effect_names(effect, key, value)


def effect_names(effect: str, key: str, value: float | tuple[float, ...]) -> list[str]:
    """Names of an effect's parameter, one for each number of its value."""
    name = f"{EFFECTS_PREFIX}{effect}.{key}"
    return [f"{name}[{i}]" for i in range(len(value))] if isinstance(value, tuple) else [name]


def variation_of(settings: RodSettings, name: str) -> ParameterVariation:
    """The variation of a parameter.

    Raises:
        InputError: there is no such parameter; the message lists those that there are.
    """
    if not is_known(settings, name):
        raise InputError(f"no sensitivity to '{name}'; known are {', '.join(known(settings))}")
    if name in LOGARITHMIC:
        return ParameterVariation(
            name, STEP, lambda s, c, d: (_scaled(s, name, float(np.exp(d))), c)
        )
    if name in POSES:
        end, what = name.split(".")
        size = 1.0 if what == "angle" else settings.rod.length
        return ParameterVariation(
            name, STEP * size, lambda s, c, d: (s, _displaced(c, end, what, d)), size
        )
    return _effect_variation(settings, name)


def _scaled(settings: RodSettings, name: str, factor: float) -> RodSettings:
    """The settings with one of `LOGARITHMIC` multiplied."""
    if name == "gravity":
        x, y, z = settings.gravity
        return replace(settings, gravity=(factor * x, factor * y, factor * z))
    if name == "length":
        # The material coordinate stays: control points keep their meaning.
        given = {k: dict(v) for k, v in settings.effects.items()}
        error = given.setdefault(LengthError.name, {})
        before = settings.rod.length + float(np.sum(error.get("difference", 0.0)))
        error["difference"] = before * factor - settings.rod.length
        return settings.with_effects(given)
    if name in ("young_modulus", "density"):
        value = factor * getattr(settings.rod, name)
        return replace(settings, rod=replace(settings.rod, **{name: value}))
    changed: dict[str, Any] = {name: factor * getattr(settings.damping, name)}
    return replace(settings, damping=replace(settings.damping, **changed))


def _displaced(command: Command, end: str, what: str, amount: float) -> Command:
    """The command with a clamp (or an imposed tip) displaced, or turned about +y."""
    if what == "angle":
        return ClampAngle(**{end: amount}).impose(command)
    return ClampOffset(**{end: tuple(amount * (what == axis) for axis in "xyz")}).impose(command)


def changed(settings: RodSettings, name: str, amount: float) -> RodSettings:
    """The settings with one parameter changed by an amount, in the unit of its variation's step.

    The poses of clamps are no settings: they leave them as they are.
    """
    if name in LOGARITHMIC:
        return _scaled(settings, name, float(np.exp(amount)))
    return settings if name in POSES else varied(settings, name, amount)


def varied(settings: RodSettings, name: str, amount: float) -> RodSettings:
    """The settings with one number of an effect, `effects.NAME.KEY[i]`, changed by an amount."""
    effect, key, index = parsed(name)
    given = {k: dict(v) for k, v in settings.effects.items()}
    old: Any = given[effect][key]  # a number, or as many as there are indices
    if index is None:
        given[effect][key] = old + amount
    else:
        given[effect][key] = (*old[:index], old[index] + amount, *old[index + 1 :])
    return settings.with_effects(given)


def _effect_variation(settings: RodSettings, name: str) -> ParameterVariation:
    effect, key, index = parsed(name)
    value: Any = settings.effects[effect][key]  # a number, or as many as there are indices
    size = abs(value if index is None else value[index])
    quantity = quantities(effect)[key]
    natural = settings.scale.unit(quantity.unit) if quantity.unit in ("m", "1/m") else 1.0
    size = size if size > 0.0 else natural
    step = STEP * size if effects()[effect].differentiable else CONTACT_STEP * natural
    return ParameterVariation(name, step, lambda s, c, d: (varied(s, name, d), c), size)


@dataclass(frozen=True)
class Compiled:
    """A rod and its command for compiled code, with the variants of some parameters.

    Args:
        system, imposed: see there.
        step, moves, rates, kind: fields of the parameters, see `SensitivityState`.
        boundary: what the command holds.
    """

    system: System
    imposed: conditions.Imposed
    step: FloatArray
    moves: FloatArray
    rates: Rates
    kind: float
    boundary: Boundary

    @cached_property
    def coupled(self) -> bool:
        """Whether a parameter couples the two directions of bending."""
        return bool(self.rates.stiffness.bend[:, :, 2].any())

    @cached_property
    def prepared(self) -> PreparedRod:
        """All of it as one object for compiled code."""
        found: PreparedRod = prepare(
            self.system, self.imposed, self.step, self.moves, self.rates, self.kind,
            self.boundary.fixed, self.boundary.pins,
        )  # fmt: skip
        return found

    def mark(self, varying: SensitivityState) -> SensitivityState:
        """Sensitivities that contain the names of their parameters."""
        return varying._replace(step=self.step, moves=self.moves, rates=self.rates, kind=self.kind)


def compiled(
    model: RodModel, boundary: Boundary, command: Command, names: Sequence[str], *, flat: bool
) -> Compiled:
    """The rod and its command for compiled code, kept with the model.

    Args:
        command: command as it was given, effects not applied.
        names: names of the parameters whose sensitivities are wanted, see above.
        flat: whether the rod runs in its planar form.

    Raises:
        InputError: an unknown parameter.
    """
    cache: dict[Any, tuple[Command, Compiled]] = model.__dict__.setdefault("_compiled", {})
    key = (boundary, tuple(names), flat, id(command))
    if key not in cache:
        while len(cache) >= KEPT:
            cache.pop(next(iter(cache)))
        cache[key] = command, _compiled(model, boundary, command, names, flat)
    return cache[key][1]


def _compiled(
    model: RodModel, boundary: Boundary, command: Command, names: Sequence[str], flat: bool
) -> Compiled:
    true = true_command(model, command)
    systems = [parts_of(model, boundary, flat=flat)]
    commands = [imposed_of(model, boundary, true)]
    moves, steps = [], []
    for name in names:
        chosen = variation_of(model.settings, name)
        pair = []
        alone = acts_on_measurement(name)
        sides = [(model, command)] * 2 if alone else both_sides(model, command, chosen)
        for other, asked in sides:
            there = true_command(other, asked)
            # An effect on the command or on the measurement alone leaves the rod as it is.
            rod = other if _acts_on_rod(name) else model
            systems.append(systems[0] if rod is model else parts_of(rod, boundary, flat=flat))
            slips = rod is not model and (rod.body.slip or model.body.slip)
            unmoved = there is true and not slips
            commands.append(commands[0] if unmoved else imposed_of(rod, boundary, there))
            pair.append(not unmoved and any(map(_differ, commands[-1], commands[0])))
        moves.append(any(pair) or systems[-1].reach != systems[-2].reach)
        steps.append(chosen.step)
    system, step = stacked(systems), np.array(steps, dtype=np.float64)
    return Compiled(
        system, stacked_imposed(commands), step, np.array(moves, dtype=np.float64),
        _rates(system, step), _kind(model), boundary,
    )  # fmt: skip


def _acts_on_rod(name: str) -> bool:
    """Whether a parameter may change the rod itself."""
    return not name.startswith(EFFECTS_PREFIX) or acts_on(name, ROD)


def is_linear(settings: RodSettings) -> bool:
    """Whether a rod's linear numbers describe it: its derivatives cost far less then."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    return _kind(RodModel(settings, basis)) == LINEAR


def _kind(model: RodModel) -> float:
    """Kind of a rod, see `sensitivity_state.LINEAR`."""
    body = model.body  # a slip or a drag of zero may be a parameter, too
    if body.slip is not None:
        return SLIPPING
    own = (body.quadratic_drag, body.relaxing, body.inner_friction)
    return LINEAR if model.plain and all(x is None for x in own) else INELASTIC


def _rates(system: System, step: FloatArray) -> Rates:
    """Derivatives of the rod's numbers, from the variants above and below."""

    def rate(numbers: FloatArray | float) -> FloatArray:
        x = np.asarray(numbers)
        width = 2.0 * step.reshape(-1, *([1] * (x.ndim - 1)))
        change = np.zeros_like(x[1::2])  # also of what is infinite in both
        np.subtract(x[1::2], x[2::2], out=change, where=x[1::2] != x[2::2])
        return np.ascontiguousarray(change / width)

    around = system.around
    return Rates(
        Stiffness(*(rate(x) for x in system.stiffness)), rate(system.mass), rate(system.spin),
        rate(system.drag), rate(system.load), rate(system.relaxation_time),
        ConstitutiveLaw._make(map(rate, system.law)), rate(around.friction), rate(around.brake),
        _body_changes(around, len(step)),
    )  # fmt: skip


def _body_changes(around: Surroundings, count: int) -> FloatArray:
    """1 for each of the parameters that changes what pegs or walls do to the rod, else 0."""
    if around.pegs.shape[1] + around.walls.shape[1] == 0:
        return np.zeros(count)
    tables = (around.pegs, around.walls, np.asarray(around.contact))
    flat = np.concatenate([x.reshape(len(x), -1) for x in tables], axis=1)
    return np.array(np.any(flat[1::2] != flat[2::2], axis=1), dtype=np.float64)


def _differ(a: Any, b: Any) -> bool:
    return not np.array_equal(a, b, equal_nan=True)


def both_sides(
    model: RodModel, command: Command, chosen: ParameterVariation
) -> list[tuple[RodModel, Command]]:
    """Rod and command with a parameter above and below its value, kept with the model."""
    cache: dict[str, tuple[Command, list[tuple[RodModel, Command]]]]
    cache = model.__dict__.setdefault("_sides", {})
    if chosen.name not in cache or cache[chosen.name][0] is not command:
        result = []
        for side in (1.0, -1.0):
            settings, asked = chosen.vary(model.settings, command, side * chosen.step)
            same = settings is model.settings  # a pose of a clamp is no property of the rod
            result.append((model if same else model.with_settings(settings), asked))
        cache[chosen.name] = command, result
    return cache[chosen.name][1]
