# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rod and its command for compiled code, with the variants of parameters that derivatives need.

The rods with a parameter above and below its value depend on nothing that a recording commands:
recordings that one model predicts have them in common.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from dlo_ros.command import Command
from dlo_ros.effects.base import COMMAND, ROD
from dlo_ros.rod.boundary import conditions
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.discretisation import Discretisation
from dlo_ros.rod.elements.rod_tables import ConstitutiveLaw, Stiffness, Surroundings
from dlo_ros.rod.held_tables import held_tables
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import (
    held,
    imposed_of,
    parts_of,
    stacked,
    stacked_imposed,
    true_command,
)
from dlo_ros.rod.parameter_names import acts_on, acts_on_measurement
from dlo_ros.rod.sensitivity.prepared_rod import PreparedRod, prepare
from dlo_ros.rod.sensitivity.sensitivity_state import (
    INELASTIC,
    LINEAR,
    SLIPPING,
    Rates,
    SensitivityState,
)
from dlo_ros.rod.sensitivity_parameters import POSES, changed, displaced, variation_of
from dlo_ros.rod.solve.equation_system import System
from dlo_ros.rod.solve.newton_in_lanes import PlanarLanes, planar_lanes
from dlo_ros.rod_settings import EFFECTS_PREFIX, RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

KEPT = 8
"""Compiled rods of one model, and rods whose variants are kept."""
PAIRS_KEPT = 256
"""Pairs of varied rods that are kept: one for each parameter of those rods."""


@dataclass(frozen=True)
class Compiled:
    """A rod and its command for compiled code, with the variants of some parameters.

    Args:
        system, imposed: see there.
        step, moves, rates, kind: fields of the parameters, see `SensitivityState`.
        boundary: what the command holds.
        discretisation: tables of the basis.
    """

    system: System
    imposed: conditions.Imposed
    step: FloatArray
    moves: FloatArray
    rates: Rates
    kind: float
    boundary: Boundary
    discretisation: Discretisation

    @cached_property
    def coupled(self) -> bool:
        """Whether a parameter couples the two directions of bending."""
        return bool(self.rates.stiffness.bend[:, :, 2].any())

    @cached_property
    def prepared(self) -> PreparedRod:
        """All of it as one object for compiled code."""
        found: PreparedRod = prepare(
            self.system, self.imposed, self.step, self.moves, self.rates, self.kind,
            self.boundary.fixed, self.boundary.pins, self._planar_lanes(),
        )  # fmt: skip
        return found

    def _planar_lanes(self) -> PlanarLanes:
        """The rod in lanes; nothing where it leaves the plane, or has pins."""
        flat = len(self.system.fixed) < len(self.boundary.fixed)
        tables = held_tables(self.discretisation, self.boundary, flat=True, alone=True)
        return planar_lanes(tables, usable=flat and not len(self.boundary.pins))

    def mark(self, varying: SensitivityState) -> SensitivityState:
        """Sensitivities that contain the names of their parameters."""
        return varying._replace(step=self.step, moves=self.moves, rates=self.rates, kind=self.kind)


@dataclass(frozen=True)
class Rod:
    """A rod that equals others with the same properties, whatever their time steps are."""

    properties: tuple[Hashable, ...]
    model: RodModel = field(compare=False)

    @classmethod
    def of(cls, model: RodModel) -> Rod:
        """The rod of a model."""
        s = model.settings
        effects = tuple((name, tuple(keys.items())) for name, keys in s.effects.items())
        given = s.rod, s.gravity, s.damping, effects, s.simulation.start
        own = model.basis, model.full_start, model.full_end, model.rest, model.point_forces
        return cls((*given, *own, model.section), model)


@dataclass(frozen=True)
class RodVariants:
    """A rod that nothing holds, with the variants of P parameters.

    Args:
        models: the rods with each parameter above and below its value.
        slipping: whether each of them may slip otherwise than the rod itself.
        amounts: amounts by which the parameters differ in them.
        system: numbers of the rod, then those of the variants.
        step, rates, kind: fields of the parameters, see `SensitivityState`.
    """

    models: tuple[tuple[RodModel, RodModel], ...]
    slipping: tuple[tuple[bool, bool], ...]
    amounts: tuple[tuple[float, float], ...]
    system: System
    step: FloatArray
    rates: Rates
    kind: float


def compiled(
    model: RodModel, boundary: Boundary, command: Command, names: Sequence[str], *, flat: bool
) -> Compiled:
    """The rod and its command for compiled code, kept with the model.

    Args:
        command: command as it was given, effects not applied.
        names: names of the parameters whose sensitivities are wanted, see `sensitivity_parameters`.
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
    rods = _variants(Rod.of(model.clamped()), tuple(names), flat)
    system = held(rods.system, model, boundary, flat=flat)
    reaching = system.reach[1::2] != system.reach[2::2]
    true = true_command(model, command)
    own = imposed_of(model, boundary, command, true)
    commands, moves = [own], []
    for k, name in enumerate(names):
        pair = [own, own]
        if any(rods.slipping[k]) or _acts_on_command(name):
            both = zip(rods.amounts[k], rods.models[k], rods.slipping[k], strict=True)
            for j, (amount, rod, slipping) in enumerate(both):
                asked = _asked(command, name, amount)
                there = true_command(rod, asked)
                if slipping or there is not true:
                    own_slip = rod if slipping else model
                    pair[j] = imposed_of(own_slip, boundary, asked, there)
        commands += pair
        moves.append(reaching[k] or any(_differs(x, own) for x in pair))
    return Compiled(
        system, stacked_imposed(commands), rods.step, np.array(moves, dtype=np.float64),
        rods.rates, rods.kind, boundary, model.discretisation,
    )  # fmt: skip


@lru_cache(maxsize=KEPT)
def _variants(rod: Rod, names: tuple[str, ...], flat: bool) -> RodVariants:
    """The variants of a rod; `flat`: whether it runs in its planar form."""
    model = rod.model
    first = parts_of(model, flat=flat)
    systems, models, slipping = [first], [], []
    for name in names:
        pair = (model, model) if acts_on_measurement(name) else _varied(rod, name)
        # An effect on the command leaves the rod as it is, too.
        differs = [m is not model and _acts_on_rod(name) for m in pair]
        systems += [
            parts_of(m, flat=flat) if d else first for m, d in zip(pair, differs, strict=True)
        ]
        models.append(pair)
        above, below = (
            d and bool(m.body.slip or model.body.slip) for m, d in zip(pair, differs, strict=True)
        )
        slipping.append((above, below))
    system = stacked(systems)
    amounts = tuple(variation_of(model.settings, name).amounts() for name in names)
    step = np.array([0.5 * (above - below) for above, below in amounts], dtype=np.float64)
    return RodVariants(
        tuple(models), tuple(slipping), amounts, system, step, _rates(system, step), _kind(model)
    )


@lru_cache(maxsize=PAIRS_KEPT)
def _varied(rod: Rod, name: str) -> tuple[RodModel, RodModel]:
    """The rod with a parameter above and below its value, or itself where it has no such one."""
    model, settings = rod.model, rod.model.settings
    if name in POSES:
        return model, model
    above, below = (
        model if amount == 0.0 else model.with_settings(changed(settings, name, amount))
        for amount in variation_of(settings, name).amounts()
    )
    return above, below


def _asked(command: Command, name: str, amount: float) -> Command:
    """The command with a parameter changed by an amount, where it is a pose of a clamp."""
    return displaced(command, name, amount) if name in POSES else command


def _acts_on_command(name: str) -> bool:
    """Whether a parameter may change what is truly imposed."""
    return name in POSES or acts_on(name, COMMAND)


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
        if not len(step):
            return np.zeros((0, *x.shape[1:]))
        width = 2.0 * step.reshape(-1, *([1] * (x.ndim - 1)))
        change = np.zeros_like(x[1::2])  # also of what is infinite in both
        np.subtract(x[1::2], x[2::2], out=change, where=x[1::2] != x[2::2])
        # Nor what is infinite in one alone: a law that a grip has no more as soon as it gives.
        change[~np.isfinite(change)] = 0.0
        return np.ascontiguousarray(change / width)

    around = system.around
    return Rates(
        Stiffness(*(rate(x) for x in system.stiffness)), rate(system.mass), rate(system.spin),
        rate(system.drag), rate(system.load), rate(system.relaxation_time),
        ConstitutiveLaw._make(rate(np.asarray(x)) for x in system.law), rate(around.friction),
        rate(around.brake), _body_changes(around, len(step)), _changes(_inertia(system), len(step)),
    )  # fmt: skip


def _body_changes(around: Surroundings, count: int) -> FloatArray:
    """1 for each of the parameters that changes what pegs or walls do to the rod, else 0."""
    if around.pegs.shape[1] + around.walls.shape[1] == 0:
        return np.zeros(count)
    return _changes((around.pegs, around.walls, np.asarray(around.contact)), count)


def _inertia(system: System) -> tuple[FloatArray, ...]:
    """Mass and drag of the variants, with those that grow with the free length."""
    u = system.uniform
    return (system.mass, system.spin, system.drag, u.mass, u.spin, u.drag)


def _changes(tables: Sequence[FloatArray], count: int) -> FloatArray:
    """1 for each of the parameters whose two variants differ in a table (V, ...), else 0."""
    if not count:
        return np.zeros(0)
    flat = np.concatenate([x.reshape(len(x), -1) for x in tables], axis=1)
    return np.array(np.any(flat[1::2] != flat[2::2], axis=1), dtype=np.float64)


def _differs(imposed: conditions.Imposed, own: conditions.Imposed) -> bool:
    """Whether something is imposed otherwise than on the rod itself."""
    return imposed is not own and not all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(imposed, own, strict=True)
    )


def both_sides(model: RodModel, command: Command, name: str) -> list[tuple[RodModel, Command]]:
    """Rod and command with a parameter above and below its value."""
    amounts = variation_of(model.settings, name).amounts()
    pair = zip(amounts, _varied(Rod.of(model), name), strict=True)
    return [(rod, _asked(command, name, amount)) for amount, rod in pair]
