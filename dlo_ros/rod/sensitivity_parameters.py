# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters that have sensitivities, and how they are varied.

A parameter is named as in the parameter file: `young_modulus`, `density`, `air_drag`,
`relaxation_time`, `gravity`, `length`; the pose of a clamp, `start.x`, `start.z`, `start.angle`,
`end.x` ...; and any number of an effect that the settings contain, `effects.NAME.KEY` or, where it
has several values, `effects.NAME.KEY[i]`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dlo_ros.command import Command
from dlo_ros.effects import effects, quantities
from dlo_ros.effects.measurement.length_error import LengthError
from dlo_ros.effects.physics.clamp_angle import ClampAngle
from dlo_ros.effects.physics.clamp_offset import ClampOffset
from dlo_ros.errors import InputError
from dlo_ros.rod.model import CONTACT_PENETRATION
from dlo_ros.rod.parameter_names import parsed
from dlo_ros.rod_settings import EFFECTS_PREFIX, RodSettings

MATERIAL = ("young_modulus", "density", "air_drag", "relaxation_time")
# By their natural logarithm.
LOGARITHMIC = (*MATERIAL, "gravity", "length")
POSES = tuple(f"{end}.{what}" for end in ("start", "end") for what in ("x", "z", "angle"))
STEP = 1e-5  # in the logarithm, or of a parameter's natural size
CONTACT_STEP = 1e-3 * CONTACT_PENETRATION
"""Step of the place of a body that the DLO may touch, over L. A wider step would leave a contact,
or enter it from afar, with a force that the sensitivities of the shape do not feel."""


@dataclass(frozen=True)
class ParameterVariation:
    """One parameter whose sensitivities are wanted, and how it is varied.

    Args:
        name: see above.
        step: how far its two variants are from it where its range allows, in its own unit (or of
            the logarithm).
        vary: settings and command with the parameter changed by an amount in that unit.
        natural: natural size of the parameter, in that unit.
        room: how far it may grow and how far it may fall within its range, in that unit.
    """

    name: str
    step: float
    vary: Callable[[RodSettings, Command, float], tuple[RodSettings, Command]]
    natural: float = 1.0
    room: tuple[float, float] = (math.inf, math.inf)

    def amounts(self, step: float | None = None) -> tuple[float, float]:
        """Amounts by which the variants above and below differ from the parameter.

        At an end of the range one of them is 0, and the quotient a one-sided one: beyond it the
        variant would be another kind of rod, or the same.

        Args:
            step: how far they are from it where its range allows; None: `step`.
        """
        wanted = self.step if step is None else step
        up, down = self.room
        return min(wanted, up), -min(wanted, down)


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
        size = 1.0 if name.endswith(".angle") else settings.rod.length
        return ParameterVariation(
            name, STEP * size, lambda s, c, d: (s, displaced(c, name, d)), size
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


def displaced(command: Command, name: str, amount: float) -> Command:
    """The command with one of `POSES`, of a clamp or an imposed tip, changed by an amount."""
    end, what = name.split(".")
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
    given: Any = settings.effects[effect][key]  # a number, or as many as there are indices
    value = float(given if index is None else given[index])
    size = abs(value)
    quantity = quantities(effect)[key]
    natural = settings.scale.unit(quantity.unit) if quantity.unit in ("m", "1/m") else 1.0
    size = size if size > 0.0 else natural
    step = STEP * size if effects()[effect].differentiable else CONTACT_STEP * natural
    low, high = quantity.range_around(value, settings.scale)
    return ParameterVariation(
        name, step, lambda s, c, d: (varied(s, name, d), c), size,
        (max(high - value, 0.0), max(value - low, 0.0)),
    )  # fmt: skip
