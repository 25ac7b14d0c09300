# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The plain rod of a model, and the effects that it may stand for.

A DLO that creeps is fitted by a much softer one that is damped strongly, one whose strands rub on
one another by a stiffer one, a drag of the square of speed by a linear one: minima of their own,
from which no derivative leads to the creep, the friction or that drag. Where the one is the other
in a limit, both lie near one another, and a fit goes on from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from dlo_ros.effects import Effect, PlainRod, Start, effects
from dlo_ros.inference.parameter import Parameter, ParametricModel, value_of
from dlo_ros.inference.priors import cause_priors
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod_settings import STANDARD_GRAVITY


def instead_of_plain(
    model: ParametricModel, begun: Sequence[Start]
) -> list[tuple[Start, ParametricModel]]:
    """Models with an effect each that the plain rod of a model may stand for, in its place.

    Args:
        begun: starts of effects that might be added.
    """
    guessed = _plain(model.centred([p.name for p in model.parameters if not p.effect]))
    fitted = _plain(model)
    return _begun_with(model, begun, lambda e, own: e.instead_of(fitted, guessed, own))


def instead_of_law(
    model: ParametricModel, name: str, begun: Sequence[Start]
) -> list[tuple[Start, ParametricModel]]:
    """Models with another law each, by which as much of the stiffness gives way, in its place.

    Args:
        name: of the effect.
        begun: starts of effects that might be added.
    """
    given = effects()[name](**model.settings.effects[name]).giving_way(_plain(model))
    if given is None:
        return []
    bare = model.without([p.name for p in model.parameters if p.effect == name])
    others = [s for s in begun if s.effect != name and s.effect not in bare.settings.effects]
    return _begun_with(bare, others, lambda e, own: e.that_gives_way(*given, own))


def _begun_with(
    model: ParametricModel, begun: Sequence[Start],
    instead: Callable[[type[Effect], Sequence[Start]], tuple[Effect, PlainRod] | None],
) -> list[tuple[Start, ParametricModel]]:  # fmt: skip
    """Models with an effect each, at the values that a function gives, and the plain rod beside it.

    Args:
        instead: that function, of an effect and its starts; None: it does not begin there.
    """
    found = []
    for start in {s.effect: s for s in begun}.values():
        values = instead(effects()[start.effect], [s for s in begun if s.effect == start.effect])
        if values is None:
            continue
        effect, rod = values
        parameters, _ = cause_priors(model.settings, start)
        if _looked_for(effect, parameters):
            begins = _with_plain(model, rod)
            found.append((start, begins.extended(effect.name, dict(vars(effect)), parameters)))
    return found


def taken_for_plain(model: ParametricModel, name: str) -> ParametricModel:
    """The model with the plain rod that may stand for that with an effect, the effect left in."""
    effect = effects()[name](**model.settings.effects[name])
    return _with_plain(model, effect.taken_for(_plain(model)))


def _looked_for(effect: Effect, parameters: Sequence[Parameter]) -> bool:
    """Whether the values of an effect lie within the ranges in which it is looked for."""
    return all(p.lower <= getattr(effect, p.key) <= p.upper for p in parameters)


def _plain(model: ParametricModel) -> PlainRod:
    """The plain rod of a model."""
    names = (name for name in PlainRod._fields if name in MATERIAL)
    values = {name: value_of(model.settings, name) for name in names}
    rod = model.settings.rod
    speed = math.sqrt(STANDARD_GRAVITY * rod.length)
    return PlainRod(**values, second_moment=rod.second_moment, speed=speed)


def _with_plain(model: ParametricModel, rod: PlainRod) -> ParametricModel:
    """The model with another plain rod, as far as its numbers are parameters."""
    theta = model.theta()
    for k, p in enumerate(model.parameters):
        if p.name in rod._fields:
            theta[k] = p.inner(getattr(rod, p.name))
    return model.at(theta)
