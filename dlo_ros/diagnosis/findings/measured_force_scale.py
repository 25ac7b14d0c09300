# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""E and mu apart in a diagnosis: the common scale of all its forces, from measured ones.

Causes are sought in shapes. They say what the model lacks, but not how large all its forces are
together; the forces at the grips, predicted with the model that was found, say that.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.findings.diagnosis_outcome import (
    Diagnosis,
    Fitted,
    NamedEffect,
    Number,
    SetupNumber,
)
from dlo_ros.effects import added_to_damping
from dlo_ros.errors import SimulationError
from dlo_ros.identification.cooperative_tasks import exhausted
from dlo_ros.identification.force_scale import (
    POWERS,
    Scale,
    borne_along,
    scale_of,
    scaled_block,
    with_scale,
    words,
)
from dlo_ros.identification.information import diameter_error
from dlo_ros.inference.forecast import Manipulation, forecast
from dlo_ros.inference.smoothly_led import smoothly_led
from dlo_ros.inference.thresholds import UNBOUNDED
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

LEAST = 0.01
"""Least share of a standard deviation that is not the scale's: the rest may round to nothing."""


def with_forces(
    found: Diagnosis,
    recordings: Sequence[Manipulation],
    given: Settings,
) -> Diagnosis:
    """The diagnosis with E, mu and every force in it on the scale of the measured forces.

    Args:
        found: diagnosis from shapes.
        recordings: recordings that the diagnosis was learned from.
        given: the parameter file.
    """
    length = given.rod.length
    measured = [smoothly_led(r, length) for r in recordings if r.wrenches]
    if not measured:
        return found
    try:
        base, extended = (_scale(f, measured, given) for f in (found.baseline, found.extended))
    except SimulationError as err:
        LOG.warning("measured forces are not used: %s", err)
        return found
    if base is None or extended is None:
        LOG.warning("no measured force lies near an observed shape at a grip; none is used")
        return found
    count = sum(len(w.stamps) for r in measured for w in r.wrenches)
    effects, uncertain = (
        tuple(_effect(e, extended, found.extended.scale_std) for e in named)
        for named in (found.effects, found.uncertain)
    )
    return replace(
        found,
        baseline=_scaled(found.baseline, base),
        extended=_scaled(found.extended, extended),
        effects=effects,
        uncertain=uncertain,
        setup={
            name: _setup_number(name, n, extended, found.extended.scale_std, given)
            for name, n in found.setup.items()
        },
        remarks=(*found.remarks, words(extended.relative, count)),
    )


def _scale(model: Fitted, recordings: Sequence[Manipulation], given: Settings) -> Scale | None:
    """The scale of a model's forces."""
    borne = []
    for recording in recordings:
        at = forecast(recording, model.settings, loads=True)
        borne += borne_along(recording, at.loadings, at.stamps, model.settings)
    density, std = model.density
    if std is None and given.rod.density_std > 0.0:  # what is weighed holds for any model
        std = given.rod.density_std * density / given.rod.density
    known = 0.0 if std is None else (density / std) ** 2
    diameter = diameter_error(given.rod, usual=True)
    return exhausted(scale_of(borne, given, known=known, diameter_std=diameter))


def _scaled(model: Fitted, scale: Scale) -> Fitted:
    """A model with another scale of its forces, as well known as that."""
    factor, std = math.exp(scale.log), scale.std[0]
    ratio, ratio_std = model.specific_modulus
    modulus_std = None if ratio_std is None else math.hypot(std, ratio_std / ratio)

    def scaled(before: float, spread: float | None) -> tuple[float, float | None]:
        value = factor * before
        return value, value * spread if spread and spread < UNBOUNDED else None

    return replace(
        model, settings=with_scale(model.settings, scale.log),
        young_modulus=scaled(model.young_modulus[0], modulus_std),
        density=scaled(model.density[0], std), scale_std=min(std, model.scale_std),
    )  # fmt: skip


def _effect(effect: NamedEffect, scale: Scale, before: float) -> NamedEffect:
    """An effect whose forces have another scale.

    Args:
        before: relative standard deviation of the scale that its own contain, see
            `Fitted.scale_std`: shapes tell a mass over mu.
    """
    result = {}
    for key, number in effect.parameters.items():
        value, std = number.value, number.std
        power = POWERS.get(number.unit, 0.0)
        if std is not None and power:
            std = _plain(_std(np.array(value), np.array(std), power, scale, before))
        factor = math.exp(power * scale.log)
        own = {name: factor * x for name, x in number.own.items()}
        result[key] = Number(_plain(factor * np.array(value)), std, number.unit, own)
    rivals = {
        name: scaled_block(name, block, scale.log) for name, block in effect.rival_values.items()
    }
    return replace(effect, parameters=result, rival_values=rivals)


def _setup_number(
    name: str, number: SetupNumber, scale: Scale, before: float, given: Settings
) -> SetupNumber:
    """A number of the set-up whose forces have another scale; a damping's is told as what it adds
    to that of the parameter file.

    Args:
        name: effect and key.
        before: see `_effect`.
    """
    power = POWERS.get(number.unit, 0.0)
    if not power:
        return number
    damping = added_to_damping().get(name.partition(".")[0])
    there: float = getattr(given.damping, damping[0]) if damping else 0.0
    whole, factor = number.value + there, math.exp(power * scale.log)
    std, held = number.std, number.held_std
    if std is not None:
        std = float(_std(np.array(whole), np.array(std), power, scale, before))
    elif held is not None:  # what was known at the given density is known at the measured one
        std, held = factor * math.hypot(held, power * scale.std[0] * whole), None
    return replace(number, value=factor * whole - there, std=std, held_std=held)


def _std(
    value: FloatArray, std: FloatArray, power: float, scale: Scale, before: float
) -> FloatArray:
    """Standard deviations of forces, with that of the measured scale in the place of the former.

    Args:
        value, std: forces before, and their standard deviations.
        power: with which they go with the scale.
        before: relative standard deviation of the scale that theirs contain.
    """
    own = np.maximum(std**2 - (power * before * value) ** 2, (LEAST * std) ** 2)
    result = math.exp(power * scale.log) * np.sqrt(own + (power * scale.std[0] * value) ** 2)
    return np.asarray(result)


def _plain(values: FloatArray) -> float | tuple[float, ...]:
    return tuple(values.tolist()) if values.ndim else float(values)
