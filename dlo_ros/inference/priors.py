# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Priors of the joint model: a set-up as careful people build it, and the wider ones of causes.

A fit of the material alone begins further away: `dlo_ros.identification.estimate.SEARCH_STD`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from dlo_ros.effects import Quantity, Scene, Start, effects, quantities
from dlo_ros.inference.parameter import SLAB, Parameter, ParametricModel, split_name
from dlo_ros.inference.thresholds import BELIEVED
from dlo_ros.parameters import Settings, tolerance
from dlo_ros.rod.sensitivity_parameters import effect_names

WIDE = 1.5
"""Prior standard deviation of a cause's logarithm without a tolerance: a factor of 4.5."""
UNIFORM = 12.0**-0.5
"""Standard deviation of a uniform prior, over its range."""
DIAMETER_STD = 0.02
"""Standard deviation over the diameter of a set-up as people build it, where `rod.diameter_std`
states none; shapes tell E D^2 / mu."""
MATERIAL_RANGES: dict[str, tuple[str, float, float, float]] = {
    "young_modulus": ("Pa", 50.0, 1e3, 1e12),
    "density": ("kg/m^3", 2.0, 1.0, 1e5),
    "air_drag": ("N s/m^2", 3.0, 1e-9, 1e3),
    "relaxation_time": ("s", 3.0, 1e-8, 10.0),
}
"""Unit, factor within which the parameter file's value is guessed where it states no std, range."""


def material_priors(given: Settings) -> tuple[Parameter, ...]:
    """E, mu and damping, known or guessed; a damping of zero stays what it is.

    Args:
        given: the parameter file.
    """
    result = []
    for name, (unit, factor, lower, upper) in MATERIAL_RANGES.items():
        block: Any = given.rod if name in ("young_modulus", "density") else given.damping
        value = float(getattr(block, name))
        if value <= 0.0:
            continue
        std = float(getattr(block, f"{name}_std", 0.0)) / value
        width = std or math.log(factor)
        result.append(
            Parameter(name, unit, True, lower, upper, math.log(value), width, guessed=not std)
        )
    return tuple(result)


def believed(model: ParametricModel) -> ParametricModel:
    """The model with a material that was measured beforehand kept near its value: `BELIEVED`."""

    def near(p: Parameter) -> Parameter:
        low, high = (p.outer(p.centre + sign * BELIEVED * p.std) for sign in (-1, 1))
        return replace(p, lower=low, upper=high)

    return model.with_prior([near(p) for p in model.parameters if not p.effect and not p.guessed])


def joint_model(start: Settings, given: Settings, scene: Scene) -> ParametricModel:
    """The plain model with all of its set-up open within tolerance.

    Args:
        start: values of the material from where a fit begins; effects given beforehand stay, but
            for numbers of which the parameter file states a std, which are open about its value.
        given: the parameter file.
        scene: properties of the recordings on which the priors depend.
    """
    model = ParametricModel(start, (*material_priors(given), *uncertain(given)))
    for name, effect in effects().items():
        block = effect.setup(scene)
        if name in start.effects:
            continue
        open_ = {
            key: value for key, value in block.items() if tolerance(given, f"{name}.{key}") != 0.0
        }
        found = [
            _tolerated(given, full)
            for key, value in open_.items() for full in effect_names(name, key, value)
        ]  # fmt: skip
        if found:
            model = model.extended(name, open_, found)
    return model


def uncertain(given: Settings) -> list[Parameter]:
    """Numbers of effects that the parameter file states with a std: known, and no better."""
    result = []
    for effect, block in given.effects.items():
        for key, value in block.items():
            width = given.tolerances.get(f"{effect}.{key}", 0.0)
            if not width > 0.0:
                continue
            q = quantities(effect)[key]
            values = value if isinstance(value, tuple) else (value,)
            for name, here in zip(effect_names(effect, key, value), values, strict=True):
                std = _seen(q, width, float(here))
                result.append(_parameter(name, q, float(here), std, given, tolerated=True))
    return result


def with_tails(model: ParametricModel, given: Settings) -> ParametricModel:
    """The model whose set-up may also be far beyond tolerances where their effects say so.

    Args:
        given: the parameter file; a tolerance that it states holds.
    """

    def common(p: Parameter) -> Parameter:
        effect, key, _ = split_name(p.name)
        stated = f"{effect}.{key}" in given.tolerances
        return replace(p, beyond=0.0 if stated else quantities(effect)[key].beyond)

    return model.with_prior([common(p) for p in model.parameters if p.tolerated])


def _tolerated(given: Settings, name: str) -> Parameter:
    """A number of the set-up with its tolerance."""
    effect, key, _ = split_name(name)
    q = quantities(effect)[key]
    width = tolerance(given, f"{effect}.{key}")
    if width is None:
        raise ValueError(f"{name} is part of every set-up but has no tolerance")
    return _parameter(name, q, q.neutral, width, given, tolerated=True)


def _parameter(
    name: str, q: Quantity, centre: float, width: float, given: Settings, *, tolerated: bool = False
) -> Parameter:
    lower, upper = q.search_for(given.scale)
    return Parameter(
        name, q.unit, q.logarithmic, lower, upper, q.transformed(centre), width,
        tolerated=tolerated,
    )  # fmt: skip


def cause_priors(given: Settings, start: Start) -> tuple[tuple[Parameter, ...], tuple[str, ...]]:
    """Parameters of an added effect, and names of those in which it is linear at first."""
    result = []
    for key in start.fitted:
        q = quantities(start.effect)[key]
        value = start.block[key]
        for k, name in enumerate(effect_names(start.effect, key, value)):
            here = value[k] if isinstance(value, tuple) else value
            result.append(_of_cause(name, q, here, start, given))
    columns = tuple(
        n for key in start.screened for n in effect_names(start.effect, key, start.block[key])
    )
    return tuple(result), columns


def _seen(q: Quantity, std: float, value: float) -> float:
    """A stated std as a fit sees it; that of a ratio is stated as one of its logarithm."""
    return std / abs(value) if q.logarithmic and q.unit else std


def _of_cause(name: str, q: Quantity, value: float, start: Start, given: Settings) -> Parameter:
    """A number of an added effect: places anywhere, sizes as large as causes may be."""
    if q.geometric:
        low, high = (q.transformed(x) for x in q.search_for(given.scale))
        centre, width = q.restored(0.5 * (low + high)), UNIFORM * (high - low)
        result = _parameter(name, q, centre, width, given)
        if q.role != "point":
            return result
        # It may lie anywhere in a room, and yet it is the DLO's size by which its moves count.
        return replace(result, matters=0.1 * UNIFORM * given.rod.length)
    known = tolerance(given, f"{start.effect}.{q.name}")
    if known:
        return _parameter(name, q, q.neutral, SLAB * _seen(q, known, q.neutral), given)
    if q.logarithmic:
        return _parameter(name, q, value, WIDE, given)
    return _parameter(name, q, q.neutral, q.natural_for(given.scale), given)
