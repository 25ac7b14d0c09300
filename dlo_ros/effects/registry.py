# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The registry of effects, and their construction from the values of a parameter file."""

from __future__ import annotations

import importlib
import inspect
import logging
import math
import pkgutil
from collections.abc import Mapping
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any

from dlo_ros.effects import measurement, physics
from dlo_ros.effects.base import Effect, Quantity, Scene, Start
from dlo_ros.errors import ParameterError
from dlo_ros.plugins import loaded

LOG = logging.getLogger(__name__)

GROUP = "dlo_ros.effects"  # of entry points
STD = "_std"  # behind a key: the tolerance within which it is taken to be right
EFFECTS_KEPT = 1024
"""Effects that are kept: those of a model's variants by some 50 parameters, several times over."""
Values = Mapping[str, Mapping[str, "float | tuple[float, ...]"]]


@lru_cache(maxsize=1)
def effects() -> Mapping[str, type[Effect]]:
    """All effects by name: those of this package, each part of it by the alphabet, then others."""
    found: dict[str, type[Effect]] = {}
    for package in (physics, measurement):
        for module in pkgutil.iter_modules(package.__path__):
            code = importlib.import_module(f"{package.__name__}.{module.name}")
            for _, member in inspect.getmembers(code, inspect.isclass):
                if issubclass(member, Effect) and member is not Effect:
                    found[member.name] = member
    for point, member in loaded(GROUP, "effect"):
        if not (inspect.isclass(member) and issubclass(member, Effect)):
            LOG.warning("effect %s: %s is no subclass of Effect", point.name, point.value)
        elif member.name in found:
            LOG.warning("effect %s of %s: there is one already", member.name, point.value)
        else:
            found[member.name] = member
    return found


def starts(scene: Scene) -> list[Start]:
    """The values with which every effect is tried as a cause in some recordings.

    Each effect names its own: one whose derivative at its neutral value is useful starts there, at
    several places where it has a place; others (yield, friction) start with a few plausible sizes.
    """
    return [start for effect in effects().values() for start in effect.starts(scene)]


def quantities(name: str) -> Mapping[str, Quantity]:
    """The parameters of an effect by key.

    Raises:
        ParameterError: there is no such effect; the message lists those that there are.
    """
    known = effects()
    if name not in known:
        raise ParameterError(
            f"effects.{name}: there is no effect '{name}'; known are {', '.join(sorted(known))}"
        )
    return _by_key(known[name])  # type: ignore[arg-type]  # classes are hashable


@cache
def _by_key(effect: type[Effect]) -> Mapping[str, Quantity]:
    return MappingProxyType({q.name: q for q in effect.quantities()})


def check(name: str, key: str, value: Any) -> float | tuple[float, ...]:
    """A value of the parameter `effects.NAME.KEY` in its proper type.

    Raises:
        ParameterError: unknown name or key, no number, or outside the range.
    """
    where, known = f"effects.{name}.{key}", quantities(name)
    if key not in known:
        raise ParameterError(
            f"{where}: '{name}' has no parameter '{key}'; it has {', '.join(known)}"
        )
    q = known[key]
    several = isinstance(value, (list, tuple))
    if q.counts and (len(value) if several else 1) not in q.counts:
        counts = " or ".join(str(n) for n in q.counts)
        raise ParameterError(f"{where} is {value!r}; it must be {counts} numbers{q.bracketed}")
    if several:
        if not (q.array or q.counts) or not value:
            raise ParameterError(f"{where} is {list(value)}; it must be one number{q.bracketed}")
        numbers = tuple(_number(where, q, v) for v in value)
        return numbers if len(numbers) > 1 else numbers[0]
    return _number(where, q, value)


def tolerance_of(name: str, part: str) -> str | None:
    """The key of which `effects.NAME.PART` states the tolerance; None where it states none.

    Raises:
        ParameterError: there is no such effect.
    """
    key, known = part.removesuffix(STD), quantities(name)
    return key if part.endswith(STD) and part not in known and key in known else None


def check_tolerance(name: str, key: str, value: Any) -> float:
    """A tolerance given as `effects.NAME.KEY_std`, in the unit of the key; 0: exact.

    Raises:
        ParameterError: negative, or no number.
    """
    try:
        number = math.nan if isinstance(value, (bool, list, tuple)) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number >= 0.0):
        unit = quantities(name)[key].bracketed
        raise ParameterError(
            f"effects.{name}.{key}{STD} is {value!r}; it must be a number from 0 on{unit}"
        )
    return number


def added_to_damping() -> Mapping[str, tuple[str, str]]:
    """Effects that add to a damping of the parameter file: its name and the effect's key."""
    return {
        name: (q.adds_to, q.name)
        for name, effect in effects().items()
        for q in effect.quantities()
        if q.adds_to
    }


def damping_effect(name: str) -> str:
    """Name of the effect that adds to a damping of the parameter file; empty where there is none.

    Args:
        name: name of the damping, such as "air_drag".
    """
    return next((effect for effect, (n, _) in added_to_damping().items() if n == name), "")


def _number(where: str, q: Quantity, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not q.lower <= number <= q.upper:  # false for NaN, too
        raise ParameterError(
            f"{where} is {value}; it must be a number from {q.lower:g} to {q.upper:g}{q.bracketed}"
        )
    return number


def build(values: Values) -> tuple[Effect, ...]:
    """The effects with the given values; keys that are not given are neutral.

    The values are used as they are: `check` has seen those of a file. Their order means nothing:
    what needs commanded frames comes first, all else as `effects` lists it, so that a camera's
    rotation, scale and shift, which do not commute, follow each other as the bags of `synthesize`
    have them.
    """
    known = effects()
    place = {
        name: (not kind.of_commanded_frames, k) for k, (name, kind) in enumerate(known.items())
    }
    return tuple(
        _made(known[name], tuple(values[name].items()))  # type: ignore[arg-type]  # hashable
        for name in sorted(values, key=place.__getitem__)
    )


@lru_cache(maxsize=EFFECTS_KEPT)
def _made(effect: type[Effect], keys: tuple[tuple[str, float | tuple[float, ...]], ...]) -> Effect:
    """An effect with the given values. The variants of a model share all effects but one."""
    return effect(**dict(keys))
