# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters with their priors, and a model: settings of which some numbers are parameters."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.special import expit

from dlo_ros.parameters import EFFECTS_PREFIX, Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

SLAB = 10.0
"""Prior standard deviation of what is no matter of tolerance, in tolerances."""
HELD = 1e-6
"""Prior standard deviation of a number that is held, over the one that it had."""
OWN = "@"
"""Stands in a name between that of the number and the recording in which alone it has its value."""


@dataclass(frozen=True)
class Parameter:
    """One unknown number.

    Args:
        name: name as in `dlo_ros.rod.sensitivity_parameters`, followed by `OWN` and a recording's
            where it is the number of that recording alone.
        unit: SI unit of its value.
        logarithmic: whether inference works on its logarithm.
        lower, upper: hard range of the value.
        centre, std: prior mean and standard deviation, of the logarithm where it is logarithmic.
        guessed: whether the prior only keeps the search in bounds and is no knowledge.
        tolerated: whether the prior is the tolerance of a set-up.
        matters: change that matters; None: told by the prior, see `step`.
        tightness: prior standard deviation over the tolerance while it is a part of the set-up.
        beyond: probability that the tolerance says nothing of it, and its prior is `SLAB` times as
            wide: the prior is a mixture then.
    """

    name: str
    unit: str
    logarithmic: bool
    lower: float
    upper: float
    centre: float
    std: float
    guessed: bool = False
    tolerated: bool = False
    matters: float | None = None
    tightness: float = 1.0
    beyond: float = 0.0

    @property
    def effect(self) -> str:
        """Name of the effect that it belongs to; empty for the material."""
        return "" if self.name in MATERIAL else self.name.split(".")[1]

    @property
    def key(self) -> str:
        """Its key in the effect, index included."""
        return number_of(self.name).rpartition(".")[2]

    def inner(self, value: float) -> float:
        """A value as inference sees it."""
        return math.log(value) if self.logarithmic else value

    def outer(self, inner: float) -> float:
        """The value, within its range."""
        value = math.exp(min(max(inner, -100.0), 100.0)) if self.logarithmic else inner
        return min(max(value, self.lower), self.upper)

    def outer_std(self, inner: float, std: float) -> float:
        """Standard deviation of the value, from that which inference has."""
        return std * self.outer(inner) if self.logarithmic else std

    def precision(self, inner: float) -> float:
        """Inverse variance of the Gaussian that has the slope of the prior at a value."""
        within, wide = self._densities(inner)
        return float(1.0 - expit(wide - within) * (1.0 - SLAB**-2)) / self.std**2

    def surprise(self, inner: float) -> float:
        """Minus the logarithm of the prior at a value, over the prior at its centre."""
        here, centre = self._densities(inner), self._densities(self.centre)
        return float(np.logaddexp(*centre) - np.logaddexp(*here))

    def _densities(self, inner: float) -> tuple[float, float]:
        """Logarithms of both parts of the prior, up to a constant."""
        square = 0.5 * ((inner - self.centre) / self.std) ** 2
        if not self.beyond:
            return -square, -math.inf
        wide = math.log(self.beyond / SLAB) - square / SLAB**2
        return math.log1p(-self.beyond) - square, wide

    @property
    def step(self) -> float:
        """A step that matters: the tolerance of a set-up, a tenth of a wider prior's std."""
        if self.matters is not None:
            return self.matters
        return self.std / self.tightness if self.tolerated else 0.1 * self.std

    def freed(self, factor: float) -> Parameter:
        """The parameter freed from its tolerance: a cause.

        Args:
            factor: its prior standard deviation, in tolerances.
        """
        return replace(self, std=factor * self.std / self.tightness, tolerated=False)

    def returned(self, factor: float) -> Parameter:
        """A freed parameter as a part of the set-up again; see `freed`."""
        return replace(self, std=self.std / factor * self.tightness, tolerated=bool(self.effect))

    def held(self, inner: float | None = None) -> Parameter:
        """The parameter, held at a value as inference sees it; None: at the centre of its prior."""
        centre = self.centre if inner is None else inner
        return replace(self, centre=centre, std=HELD * self.std)

    def widened(self) -> Parameter:
        """The parameter with the wide part of its prior alone, see `beyond`."""
        return replace(self, std=SLAB * self.std, beyond=0.0) if self.beyond else self

    def tightened(self, tightness: float) -> Parameter:
        """A part of the set-up with another prior standard deviation, see `tightness`."""
        return replace(self, std=self.std / self.tightness * tightness, tightness=tightness)


@dataclass(frozen=True)
class ParametricModel:
    """Settings, of which some numbers are parameters."""

    settings: Settings
    parameters: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def theta(self) -> FloatArray:
        """Their values as inference sees them, shape (P,)."""
        return np.array([p.inner(value_of(self.settings, p.name)) for p in self.parameters])

    def axis(self, name: str) -> FloatArray:
        """Unit vector of one parameter, shape (P,)."""
        return np.asarray(np.eye(len(self.parameters))[self.index(name)])

    def at(self, theta: FloatArray) -> ParametricModel:
        """The model with other values; what leaves its range stays at the border."""
        pairs = zip(self.parameters, theta, strict=True)
        values = {p.name: p.outer(float(x)) for p, x in pairs}
        return replace(self, settings=with_values(self.settings, values))

    def stiffened(self, factor: float) -> ParametricModel:
        """The model with a multiple of its Young's modulus."""
        return self.at(self.theta() + np.log(factor) * self.axis("young_modulus"))

    def centred(self, names: Collection[str]) -> ParametricModel:
        """The model with some of its parameters at the centres of their priors."""
        pairs = zip(self.parameters, self.theta(), strict=True)
        return self.at(np.array([p.centre if p.name in names else x for p, x in pairs]))

    def at_centres(self, names: Collection[str]) -> ParametricModel:
        """The model with some numbers at the centres of their priors, as parameters no more."""
        kept = tuple(p for p in self.parameters if p.name not in names)
        return replace(self.centred(names), parameters=kept)

    def chain(self) -> FloatArray:
        """Derivative of a simulation's parameter by that of the inference, shape (P,)."""
        return np.array(
            [
                value_of(self.settings, p.name) if p.logarithmic and p.effect else 1.0
                for p in self.parameters
            ]
        )

    def offset(self) -> FloatArray:
        """Prior means minus the values, shape (P,)."""
        return np.array([p.centre for p in self.parameters]) - self.theta()

    def precision(self) -> FloatArray:
        """Inverse prior variances at the values, shape (P,)."""
        pairs = zip(self.parameters, self.theta(), strict=True)
        return np.array([p.precision(float(x)) for p, x in pairs])

    def surprise(self) -> float:
        """Minus the log prior of the values, over that of the priors' centres."""
        pairs = zip(self.parameters, self.theta(), strict=True)
        return sum(p.surprise(float(x)) for p, x in pairs)

    def of_material(self, values: FloatArray, other: float) -> FloatArray:
        """Those of the parameters' values (P,) that belong to `MATERIAL`, shape (4,).

        Args:
            other: the value of what is no parameter.
        """
        known = dict(zip(self.names, values, strict=True))
        return np.array([known.get(name, other) for name in MATERIAL])

    def on_material(self, hessian: FloatArray) -> FloatArray:
        """Information of data on the logarithms of `MATERIAL`, shape (4, 4), of all parameters.

        All else is integrated out, with its priors.

        Args:
            hessian: information of the data on the parameters, shape (P, P).
        """
        own = np.array([not p.effect for p in self.parameters])
        others = hessian[~own][:, ~own] + np.diag(self.precision()[~own])
        cross = hessian[own][:, ~own]
        place = [MATERIAL.index(p.name) for p in self.parameters if not p.effect]
        result = np.zeros((len(MATERIAL), len(MATERIAL)))
        kept = hessian[own][:, own] - cross @ np.linalg.solve(others, cross.T)
        result[np.ix_(place, place)] = kept
        return result

    def extended(
        self, effect: str, block: dict[str, Any], parameters: Sequence[Parameter]
    ) -> ParametricModel:
        """The model with an effect's values, and some of them as parameters."""
        effects = {k: dict(v) for k, v in self.settings.effects.items()}
        effects.setdefault(effect, {}).update(block)
        names = {p.name for p in parameters}
        kept = [p for p in self.parameters if p.name not in names]
        return ParametricModel(self.settings.with_effects(effects), (*kept, *parameters))

    def without(self, names: Sequence[str]) -> ParametricModel:
        """The model without some parameters; their keys are taken out of the settings.

        A number that goes in one recording goes in all.
        """
        effects = {k: dict(v) for k, v in self.settings.effects.items()}
        for name in names:
            effect, key, _ = split_name(name)
            effects.get(effect, {}).pop(key, None)
        left = {k: v for k, v in effects.items() if v}
        numbers = {number_of(name) for name in names}
        kept = tuple(p for p in self.parameters if number_of(p.name) not in numbers)
        own = {k: v for k, v in self.settings.own.items() if number_of(k) not in numbers}
        return ParametricModel(replace(self.settings, effects=left, own=own), kept)

    def with_prior(self, parameters: Sequence[Parameter]) -> ParametricModel:
        """The model with other priors of some parameters."""
        new = {p.name: p for p in parameters}
        return replace(self, parameters=tuple(new.get(p.name, p) for p in self.parameters))

    def index(self, name: str) -> int:
        """Place of a parameter."""
        return self.names.index(name)


@cache
def split_name(name: str) -> tuple[str, str, int | None]:
    """Effect, key and index of `effects.NAME.KEY[i]`."""
    effect, _, key = number_of(name).removeprefix(EFFECTS_PREFIX).partition(".")
    key, _, index = key.partition("[")
    return effect, key, int(index[:-1]) if index else None


def number_of(name: str) -> str:
    """Name of a parameter's number, without the recording of which it may be."""
    return name.partition(OWN)[0]


def acts_in(name: str, recording: str) -> bool:
    """Whether a parameter acts in a recording: it is a number of all, or of that one."""
    _, own, of = name.partition(OWN)
    return not own or of == recording


def of_recording(settings: Settings, recording: str) -> Settings:
    """The settings with the values that numbers have in a recording."""
    values = {}
    for name, value in settings.own.items():
        effect, key, _ = split_name(name)
        if acts_in(name, recording) and key in settings.effects.get(effect, {}):
            values[number_of(name)] = value
    return with_values(settings, values) if values else settings


def value_of(settings: Settings, name: str) -> float:
    """Value of a parameter."""
    if OWN in name:
        return settings.own[name]
    if name in MATERIAL:
        block: Any = settings.rod if name in ("young_modulus", "density") else settings.damping
        return float(getattr(block, name))
    effect, key, index = split_name(name)
    value: Any = settings.effects[effect][key]
    return float(value if index is None else value[index])


def with_values(settings: Settings, values: Mapping[str, float]) -> Settings:
    """Settings with other values of parameters.

    A number of which recordings have their own values is elsewhere the mean of these.
    """
    own = {**settings.own, **{name: x for name, x in values.items() if OWN in name}}
    numbers = {name: x for name, x in values.items() if OWN not in name}
    for number in {number_of(name) for name in values if OWN in name}:
        numbers[number] = float(np.mean([x for k, x in own.items() if number_of(k) == number]))
    rod: dict[str, Any] = {}
    damping: dict[str, Any] = {}
    effects: dict[str, Any] = dict(settings.effects)
    for name, value in numbers.items():
        if name in MATERIAL:
            (rod if name in ("young_modulus", "density") else damping)[name] = value
            continue
        effect, key, index = split_name(name)
        if effects[effect] is settings.effects[effect]:
            effects[effect] = dict(effects[effect])
        old: Any = effects[effect][key]
        effects[effect][key] = value if index is None else (*old[:index], value, *old[index + 1 :])
    return replace(
        settings, rod=replace(settings.rod, **rod), damping=replace(settings.damping, **damping),
        effects=effects, own=own,
    )  # fmt: skip
