# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The plain model, perhaps with a peg: settings, which of their numbers are fitted, priors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dlo_ros.effects import Quantity, quantities
from dlo_ros.effects.start import Block
from dlo_ros.identification.estimate import SEARCH_STD
from dlo_ros.inference.parameter import split_name, value_of, with_value
from dlo_ros.inference.priors import believed, material_priors
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL, effect_names
from dlo_ros.spline import FloatArray

LOOSE = 3.0
"""Standard deviations of what is not known, in natural units of a parameter."""


@dataclass(frozen=True)
class PlainModel:
    """Settings, and which of their numbers are fitted.

    Args:
        settings: settings with the values of the numbers.
        free: names as in `dlo_ros.rod.sensitivity_parameters`.
        bounds: lowest and highest value of parameters that were measured beforehand.
    """

    settings: Settings
    free: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that the model contains."""
        return tuple(self.settings.effects)

    def theta(self) -> FloatArray:
        """The open parameters in the units of the fit, shape (P,)."""
        return np.array([_inner(name, value_of(self.settings, name)) for name in self.free])

    def at(self, theta: FloatArray) -> PlainModel:
        """The model with other values; a value beyond its range is set to the border."""
        settings = self.settings
        for name, value in zip(self.free, theta, strict=True):
            low, high = self.bounds.get(name) or _range(name, settings)
            settings = with_value(settings, name, _outer(name, float(value), low, high))
        return replace(self, settings=settings)

    def natural(self) -> FloatArray:
        """A plausible size of each parameter in the units of the fit, shape (P,)."""
        return np.array([_natural(name, self.settings) for name in self.free])

    def extended(self, effect: str, block: Block, keys: tuple[str, ...]) -> PlainModel:
        """The model with one more effect, of which some keys are fitted."""
        effects = {**self.settings.effects, effect: dict(block)}
        free = (*self.free, *names(effect, block, keys))
        return replace(self, settings=self.settings.with_effects(effects), free=free)


def baseline(settings: Settings) -> PlainModel:
    """The plain model: E, mu and damping are open; given effects stay.

    Parameters that were measured beforehand stay near their value: a fit that pushes them further
    does the work of a cause that nobody names.
    """
    damping = settings.damping
    free = ["young_modulus", "density"]
    free += [n for n in ("air_drag", "relaxation_time") if getattr(damping, n) > 0.0]
    known = (p for p in material_priors(settings) if p.name in free and not p.guessed)
    bounds = {p.name: believed(p) for p in known}
    return PlainModel(settings, tuple(free), bounds)


def names(effect: str, block: Block, keys: tuple[str, ...]) -> tuple[str, ...]:
    """Full names of an effect's parameters, one for each number."""
    return tuple(name for key in keys for name in effect_names(effect, key, block[key]))


def prior(model: PlainModel, given: Settings) -> tuple[FloatArray, FloatArray]:
    """The prior of the open parameters.

    Args:
        model: the model with the open parameters.
        given: the parameter file, whose material is the prior's centre.

    Returns:
        Centre and information (inverse variance), each of shape (P,).
    """
    centre, information = [], []
    for name in model.free:
        if name in MATERIAL:
            block: Any = given.rod if name in ("young_modulus", "density") else given.damping
            value = getattr(block, name)
            std = getattr(block, f"{name}_std", 0.0) / value
            centre.append(math.log(value))
            information.append((std or SEARCH_STD[name]) ** -2)
        else:
            quantity, natural = _quantity(name), _natural(name, model.settings)
            log = logarithmic(name)
            place = quantity.geometric
            here = value_of(model.settings, name)
            centre.append(_inner(name, here) if log or place else quantity.neutral)
            # What is only a place needs no centre; a little keeps the equations regular.
            information.append(1e-4 if log or place else (LOOSE * natural) ** -2)
    return np.array(centre), np.array(information)


def logarithmic(name: str) -> bool:
    """Whether a parameter is fitted by its logarithm."""
    return name in MATERIAL or _quantity(name).logarithmic


def _quantity(name: str) -> Quantity:
    effect, key, _ = split_name(name)
    return quantities(effect)[key]


def _inner(name: str, value: float) -> float:
    return math.log(value) if logarithmic(name) else value


def _outer(name: str, value: float, low: float, high: float) -> float:
    if logarithmic(name):
        value = math.exp(min(max(value, -100.0), 100.0))
    return min(max(value, low), high)


def _range(name: str, settings: Settings) -> tuple[float, float]:
    """Lowest and highest value that a parameter may take, in its own unit."""
    if name in MATERIAL:
        return {
            "young_modulus": (1e3, 1e12), "density": (1.0, 1e5), "air_drag": (1e-9, 1e3),
            "relaxation_time": (1e-8, 10.0),
        }[name]  # fmt: skip
    return _quantity(name).search_for(settings.scale)


def _natural(name: str, settings: Settings) -> float:
    return 1.0 if name in MATERIAL else _quantity(name).natural_for(settings.scale)
